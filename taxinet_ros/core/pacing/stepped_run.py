"""A run on a graph as a state machine: frames go out, answers come in, and it has one ending.

The simulator node owns one per run and brings it what the graph says. Wall-clock time comes from a
function that is passed in, and only detects silence: the same answers at any time give the same
run. It knows no ROS; what it needs of the graph is :class:`LiveGraph`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.pacing.free_run import FreeRun
from taxinet_ros.core.pacing.lockstep import Lockstep
from taxinet_ros.core.topics import (
    MTL_MONITOR,
    PERCEPTION,
    RECORDER,
    SIMULATOR,
    STEERING_CONTROLLER,
)
from taxinet_ros.core.types import TaxiCommand, TrackingError, step_stamp_ns
from taxinet_ros.core.verdict.outcome import NOT_JUDGED, Judged, Outcome, outcome_of
from taxinet_ros.errors import InfraError, InfraKind

_LAST_STEP_S = 1.0
"""Maximum wait [s] for the answers to the current frame when a run is aborted."""
_SUSPECTED_S = 1.0
"""Time [s] to wait for evidence that another node caused a node's protocol error."""
_CERTAIN = (InfraKind.INTRUDER, InfraKind.DIED)


class Ending(NamedTuple):
    """How a run ended.

    Attributes:
        outcome: one of the five.
        seq: last control step.
        kind, who, detail: of an infrastructure error, as in :class:`.RunResult`.
    """

    outcome: Outcome
    seq: int
    kind: str = ''
    who: str = ''
    detail: str = ''


class LiveGraph(Protocol):
    """What a run needs of the graph that it takes place on."""

    def advance(self, command: TaxiCommand) -> None:
        """Move the world by one step."""

    def observe(self) -> Any:
        """Look at the world; the frame has a number ``seq``."""

    def publish(self, frame: Any) -> None:
        """Publish a frame."""

    def settle(self, unestimated: Sequence[int], uncommanded: Sequence[int]) -> None:
        """Publish which earlier frames of a free run get no answer."""

    def start(self) -> None:
        """Say that the run begins."""

    def announce(self, ending: Ending) -> None:
        """Say how the run ended; the recorder then closes its bag."""

    def finish(self, ending: Ending) -> None:
        """Give the ending to the client; called once."""

    def held(self) -> None:
        """Nothing but the pause keeps the run from its next step; may be called repeatedly."""

    def unmatched(self) -> Sequence[str]:
        """Topics on which not all nodes of the run have found each other."""

    def intruder(self) -> tuple[str, str] | None:
        """A node too many on a topic of the run, and a line on it."""

    def why_not_ready(self) -> tuple[str, str, str]:
        """Kind, names and reason of what keeps the run from starting."""

    def why_silent(self, who: str) -> str:
        """Why nothing is heard of a node, as far as the graph shows it; or ''."""


def subnormal(value: TrackingError | TaxiCommand) -> str:
    """Say which numbers of a valid answer no node can have meant, or ''.

    rclpy copies a float field as a double from the memory of whatever object is in it, unless
    ``ROS_PYTHON_CHECK_FIELDS`` is 1. Of an int, a bool, a string, an array or another number of
    NumPy than float64, these bytes are a subnormal number.
    """
    if isinstance(value, TrackingError):
        numbers = (value.cte_m, value.he_rad) if value.valid else ()
        words = f'{value.cte_m:g} m, {value.he_rad:g} rad'
    else:
        numbers = value.steering_rad, value.speed_mps
        words = f'{value.steering_rad:g} rad at {value.speed_mps:g} m/s'
    if not any(0 < abs(number) < sys.float_info.min for number in numbers):
        return ''
    return f'{words}: subnormal, an int or array in a float field? see docs/own_nodes.md'


def check_answer(
    who: str, newest: int, *, seq: int, stamp_ns: int, value: TrackingError | TaxiCommand,
    period_ns: int = CONTROL_PERIOD_NS,
) -> None:
    """Check that an answer refers to a published frame, with numbers that can have been meant.

    Late or repeated answers are allowed.

    Args:
        who: node that answers.
        newest: number of the newest frame.
        seq: number of the frame that is answered.
        stamp_ns: simulated time in the answer [ns].
        value: the answer.
        period_ns: control period [ns].

    Raises:
        InfraError: it refers to a future frame, its stamp and frame number disagree, or a number
            of it is :func:`subnormal`.
    """
    if seq > newest:
        detail = f'answered frame {seq}, which is not out yet'
        raise InfraError(InfraKind.PROTOCOL, who, newest, detail)
    if stamp_ns != step_stamp_ns(seq, period_ns):
        detail = f'its answer to frame {seq} is stamped {stamp_ns / 1e9:g} s'
        raise InfraError(InfraKind.PROTOCOL, who, newest, detail)
    if detail := subnormal(value):
        raise InfraError(InfraKind.PROTOCOL, who, newest, f'answered {detail}')


class SteppedRun:
    """One run, stepped by the answers of its graph.

    Attributes:
        lockstep: bookkeeping of the answers.
        free: the same object if it is a free run, else None.
        started: whether the first frame is out.
        ending: how it ended; the recorder may still be closing its bag.
        verdict: the monitor's judgement.
        heard_s: time of the last message that moved it on.
        allowed: number of steps until it pauses, 0 while it is paused; None: it does not pause.
    """

    def __init__(
        self, graph: LiveGraph, lockstep: Lockstep, *, participants: Sequence[str],
        first: TaxiCommand, late: Callable[[int, TaxiCommand], TaxiCommand],
        answer_timeout_s: float, ready_timeout_s: float, clock: Callable[[], float],
        period_ns: int = CONTROL_PERIOD_NS,
    ) -> None:
        """Begin to wait for the participants.

        Args:
            graph: the graph that it takes place on.
            lockstep: its bookkeeping, a :class:`.FreeRun` for a free run.
            participants: names of the nodes, without the simulator.
            first: command in effect before the first answer of a free run.
            late: the command that takes effect at a step, given the answer to that step.
            answer_timeout_s: silence of a node that ends the run [s].
            ready_timeout_s: time for all nodes to get ready [s].
            clock: steady wall clock [s].
            period_ns: control period [ns].
        """
        self.lockstep = lockstep
        self.free = lockstep if isinstance(lockstep, FreeRun) else None
        self.started = False
        self.ending: Ending | None = None
        self.verdict: Judged | None = None
        self.allowed: int | None = None
        self._graph, self._participants, self._late = graph, tuple(participants), late
        self._answer_timeout_s, self._ready_timeout_s = answer_timeout_s, ready_timeout_s
        self._clock, self._period_ns = clock, period_ns
        self._command: TaxiCommand | None = None
        self._first = self._held = first
        self._suspect: tuple[InfraError, float] | None = None
        self._unwanted_s: float | None = None
        self._finished = False
        self._begun_s = self.heard_s = clock()

    # What the graph says ------------------------------------------------------------------------

    def ready(self, node: str) -> None:
        """A participant is ready."""
        self.lockstep.ready(node)
        self._heard()
        self._start()

    def estimate(self, seq: int, stamp_ns: int, value: TrackingError) -> None:
        """The perception answers a frame.

        Raises:
            InfraError: as :func:`check_answer`; or its covariance is none.
        """
        self._check_answer(PERCEPTION, seq, stamp_ns, value)
        if flaw := value.covariance_flaw:
            raise InfraError(InfraKind.PROTOCOL, PERCEPTION, seq, f'estimated a {flaw}')
        if self.lockstep.answer(PERCEPTION, seq, self._clock()):
            self._heard()

    def command(self, seq: int, stamp_ns: int, value: TaxiCommand) -> None:
        """The controller answers a frame.

        Raises:
            InfraError: the angle or speed is not finite, or the speed is negative.
        """
        if self.ending is not None:
            return
        who = STEERING_CONTROLLER
        try:
            self._check_answer(who, seq, stamp_ns, value)
        except InfraError as error:
            # It may repeat an error of the perception, whose estimate has then not arrived yet.
            self._suspect = self._suspect or (error, self._clock())
            return
        if not (math.isfinite(value.steering_rad) and 0 <= value.speed_mps < math.inf):
            detail = f'commanded {value.steering_rad:g} rad at {value.speed_mps:g} m/s'
            raise InfraError(InfraKind.PROTOCOL, who, seq, detail)
        # The estimate travels on another topic and may be overtaken by the command made from it.
        if self.free is None:
            self.lockstep.answer(PERCEPTION, seq)
        if self.lockstep.answer(who, seq, self._clock()):
            self._command = value
            self._heard()
            self._go_on()

    def progress(self, node: str, seq: int, stamp_ns: int) -> None:
        """A follower has processed the frames up to ``seq``, and received those up to a time.

        Raises:
            InfraError: that frame is not out yet.
        """
        if seq > self.lockstep.seq:
            detail = f'has come to frame {seq}, which is not out yet'
            raise InfraError(InfraKind.PROTOCOL, node, self.lockstep.seq, detail)
        self.lockstep.progress(node, seq, stamp_ns // self._period_ns, self._clock())
        self._heard()
        self._go_on()

    def judged(self, verdict: Judged) -> None:
        """The monitor has judged the run."""
        self.verdict = verdict
        if verdict.stopped_early:
            self.lockstep.end(MTL_MONITOR)
        self._heard()
        self._go_on()

    def recorded(self, outcome: str, seq: int) -> None:
        """The recorder has closed its bag; a verdict counts only if the bag contains it."""
        ending = self.ending
        if ending is None:
            self.fail(InfraKind.BAG, RECORDER, f'closed its bag as {outcome} amid the run')
        elif ending.outcome.judged and (outcome, seq) != (ending.outcome, ending.seq):
            self.fail(InfraKind.BAG, RECORDER, f'closed its bag as {outcome} at step {seq}')
        else:
            self._finish()

    def cancel(self) -> None:
        """Nobody wants the run any more: it ends as INTERRUPTED, between two steps if possible."""
        if self._unwanted_s is None:
            self._unwanted_s = self._clock()

    def fail(self, kind: str, who: str, detail: str) -> None:
        """End the run as INFRA_ERROR; after its end, only a lost bag counts."""
        # The error may be caused by a node outside the run; but one that died may have been started
        # again.
        doubtful = self.started and self.ending is None and kind not in _CERTAIN
        if doubtful and (found := self._graph.intruder()) is not None:
            kind, (who, detail) = InfraKind.INTRUDER, found
        ending = Ending(Outcome.INFRA_ERROR, self._seq, kind, who, detail)
        recorder_lost = RECORDER in who.split(', ') and kind != InfraKind.INTRUDER
        before = self.ending
        if before is None or (before.outcome.judged and who == SIMULATOR):
            self._end(ending, recorder_lost)
        elif recorder_lost:
            # The bag could not be finished, so the evidence is incomplete and no verdict counts. An
            # earlier error remains the reason.
            if before.outcome is not Outcome.INFRA_ERROR:
                self.ending = ending
            self._finish()

    def allow(self, steps: int | None) -> None:
        """Pause after this many more steps, 0: before the next one; None: go on without a pause.

        The answers to the current frame still come in, and count. A free run cannot pause: its
        frames would come at other times.

        Raises:
            Exception: the world failed.
        """
        assert self.free is None
        self.allowed = steps
        self._heard()
        self._go_on()

    # Time ---------------------------------------------------------------------------------------

    def watch(self) -> None:
        """Look for silence; called several times a second.

        Raises:
            Exception: the world failed.
        """
        silence_s = self._clock() - self.heard_s
        if self.ending is not None:
            if silence_s > self._answer_timeout_s:
                self.fail(InfraKind.TIMEOUT, RECORDER, 'did not finish its bag')
        elif self.started:
            self._watch_steps(silence_s)
        elif not self._start():
            self._watch_start()

    def _watch_start(self) -> None:
        if self._unwanted_s is not None:
            self._end(Ending(Outcome.INTERRUPTED, self._seq))
        elif self._clock() - self._begun_s > self._ready_timeout_s:
            kind, who, why = self._graph.why_not_ready()
            within = f'not ready within {self._ready_timeout_s:g} s'
            intruded = kind == InfraKind.INTRUDER
            self.fail(kind, who, f'{why} ({within})' if intruded else f'{within}: {why}')

    def _watch_steps(self, silence_s: float) -> None:
        now_s = self._clock()
        if self._unwanted_s is not None:
            if now_s - self._unwanted_s > _LAST_STEP_S:
                self._end(Ending(Outcome.INTERRUPTED, self._seq))
            else:
                self._go_on()
        elif self._suspect is not None and now_s - self._suspect[1] > _SUSPECTED_S:
            error = self._suspect[0]
            self.fail(error.kind, error.who, error.detail)
        elif self.free is not None and (who := self.free.silent(now_s, self._answer_timeout_s)):
            self._fail_silent(who)
        elif silence_s > self._answer_timeout_s and not self._paused:
            self._fail_silent((self.lockstep.missing() or [MTL_MONITOR])[0])

    def _fail_silent(self, who: str) -> None:
        why = self._graph.why_silent(who)
        detail = f'silent for {self._answer_timeout_s:g} s' + (f': it {why}' if why else '')
        self.fail(InfraKind.TIMEOUT, who, detail)

    def tick(self) -> None:
        """Publish the next frame of a free run if it is due; called much more often than that.

        Raises:
            Exception: the world failed.
        """
        free = self.free
        if free is None or not self.started or self.ending is not None:
            return
        now_s = self._clock()
        if self._unwanted_s is not None:
            self._end(Ending(Outcome.INTERRUPTED, self._seq))
        elif free.seq < free.last_seq:
            if free.pace.due(now_s) and free.room:
                self._graph.advance(self._held)
                self._publish()
        elif free.closed:
            if any(settled := free.settle()):
                self._graph.settle(*settled)
            self._go_on()
        else:
            free.closed = free.pace.due(now_s)

    def awaited(self, patience_s: float) -> list[str]:
        """Names of the nodes that it waits for; in a free run, those overdue by a time [s]."""
        if self.ending is not None:
            return [RECORDER]
        if not self.started:
            return self._graph.why_not_ready()[1].split(', ')
        if self.free is not None:
            silent = self.free.silent(self._clock(), patience_s)
            return [silent] if silent else []
        return [MTL_MONITOR] if self.lockstep.complete else self.lockstep.missing()

    # Steps and the end --------------------------------------------------------------------------

    @property
    def _seq(self) -> int:
        return max(self.lockstep.seq, 0)

    @property
    def _paused(self) -> bool:
        """Whether nothing but a pause keeps the run from its next step."""
        return self.allowed == 0 and self.lockstep.may_advance and self._command is not None

    def _check_answer(
        self, who: str, seq: int, stamp_ns: int, value: TrackingError | TaxiCommand
    ) -> None:
        check_answer(
            who, self.lockstep.seq, seq=seq, stamp_ns=stamp_ns, value=value,
            period_ns=self._period_ns,
        )

    def _heard(self) -> None:
        self.heard_s = self._clock()

    def _start(self) -> bool:
        """Publish the first frame if nothing keeps the run from starting; whether it is out."""
        if not self.started and self.lockstep.all_ready and not self._graph.unmatched():
            self.started = True
            self._graph.start()
            self._publish()
        return self.started

    def _go_on(self) -> None:
        if self.ending is not None or not self.started:
            return
        over = self.lockstep.complete and self.verdict is not None
        if self._unwanted_s is not None and (over or self._command is not None):
            self._end(Ending(Outcome.INTERRUPTED, self._seq))
        elif self._paused:
            self._graph.held()
        elif self.lockstep.may_advance and self._command is not None:
            if self.allowed is not None:
                self.allowed -= 1
            command, self._command = self._command, None
            self._graph.advance(self._late(self.lockstep.seq, command))
            self._publish()
        elif over and self.verdict is not None:
            self._conclude(self.verdict)

    def _publish(self) -> None:
        frame = self._graph.observe()
        self.lockstep.begin(frame.seq, self._clock())
        self._graph.publish(frame)
        # A camera may take longer for a picture than the others may for their answers.
        self._heard()
        if self.free is not None:
            self._held = self._command or self._first
            self._graph.settle(*self.free.settle())

    def _conclude(self, verdict: Judged) -> None:
        outcome = outcome_of(verdict)
        if not outcome.judged:
            self.fail(**NOT_JUDGED)
        elif (found := self._graph.intruder()) is not None:
            self.fail(InfraKind.INTRUDER, *found)
        else:
            self._end(Ending(outcome, self._seq))

    def _end(self, ending: Ending, recorder_lost: bool = False) -> None:
        """Announce the end, then wait until the recorder, if any, has closed its bag."""
        self.ending = ending
        self._heard()
        self._graph.announce(ending)
        if recorder_lost or RECORDER not in self._participants:
            self._finish()

    def _finish(self) -> None:
        assert self.ending is not None
        if not self._finished:
            self._finished = True
            self._graph.finish(self.ending)
