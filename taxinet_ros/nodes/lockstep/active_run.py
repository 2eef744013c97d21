"""The simulator's current run: world, bookkeeping, checks of answers, health."""

from __future__ import annotations

import math
import time
from collections import Counter
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.task import Future
from taxinet_msgs.action import RunScenario
from taxinet_msgs.msg import NodeStatus, RunStatus, Verdict
from taxinet_msgs.msg import Timing as TimingMessage

from taxinet_ros.bag.layout import is_run_name
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, rolling_on
from taxinet_ros.core.faults import check_free
from taxinet_ros.core.loop import LateCommands
from taxinet_ros.core.pacing.free_run import FreeRun
from taxinet_ros.core.pacing.lockstep import Lockstep
from taxinet_ros.core.pacing.timing import Timing, free_timing
from taxinet_ros.core.types import NS_PER_S, TaxiCommand
from taxinet_ros.core.verdict.judge import check_specs
from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.core.world import SimulatedWorld, WorldMaker
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep.diagnostics import Health, Pace, too_long
from taxinet_ros.nodes.messages.convert import header, one_line
from taxinet_ros.nodes.messages.step import StepMessage, subnormal
from taxinet_ros.nodes.names import check_participants


def check_answer(answer: StepMessage, who: str, seq: int) -> None:
    """Check that an answer refers to a published frame, with numbers that can have been meant.

    Late or repeated answers are allowed.

    Raises:
        InfraError: it refers to a future frame, its stamp and frame number disagree, or a number
            of it is :func:`.subnormal`.
    """
    if answer.seq > seq:
        detail = f'answered frame {answer.seq}, which is not out yet'
        raise InfraError(InfraKind.PROTOCOL, who, seq, detail)
    if answer.stamp_ns != answer.seq * CONTROL_PERIOD_NS:
        detail = f'its answer to frame {answer.seq} is stamped {answer.stamp_ns / 1e9:g} s'
        raise InfraError(InfraKind.PROTOCOL, who, seq, detail)
    if detail := subnormal(answer.value):
        raise InfraError(InfraKind.PROTOCOL, who, seq, f'answered {detail}')


def check_command(command: TaxiCommand, who: str, seq: int) -> None:
    """Check that a command is physically valid.

    Raises:
        InfraError: the angle or speed is not finite, or the speed is negative.
    """
    if not (math.isfinite(command.steering_rad) and 0 <= command.speed_mps < math.inf):
        detail = f'commanded {command.steering_rad:g} rad at {command.speed_mps:g} m/s'
        raise InfraError(InfraKind.PROTOCOL, who, seq, detail)


FREE_TICK_S = 0.001
"""Polling period for the next frame [s]: a hundredth of a step in real time."""


def chosen_timing(timing: Timing, *, lockstep: bool, factor: float) -> Timing:
    """Timing from the simulator's parameters.

    Args:
        timing: timing with the latency.
        lockstep: simulated time waits for every answer.
        factor: simulated seconds per second of the wall clock in a free run; 0: no limit.

    Raises:
        UsageError: one of them has no effect with another.
    """
    if lockstep and factor != 1.0:
        raise UsageError('simulator: real_time_factor: no effect in lockstep; set lockstep false')
    if not lockstep and timing.laws:
        raise UsageError(
            f'simulator: latency {timing.latency}: no effect in a free run, which has real delays'
        )
    return timing if lockstep else free_timing(f'{factor!r}')


class ActiveRun:
    """World, lockstep bookkeeping and pending action result of a run."""

    def __init__(
        self, goal: Any, executor: Any, timing: Timing, make_world: WorldMaker = SimulatedWorld
    ) -> None:
        """Build the world of the goal's scenario.

        Raises:
            UsageError: the scenario has a value out of range, a name that is no valid folder name,
                an unknown stop rule, no formula, an invalid one or one that cannot be evaluated on
                a run of this length, an invalid assumption, a missing required node, or an unknown
                node.
            InfraError: the world cannot be built.
        """
        message = goal.request.scenario
        self.goal = goal
        self.run_id: str = message.run_id
        self.participants = tuple(message.participants)
        check_participants(self.participants)
        if not is_run_name(self.run_id):
            raise UsageError(f'run_id {self.run_id!r}: use letters, digits, _, - and . only')
        if not message.specs:
            raise UsageError('specs: a run needs a formula to be judged by')
        judging = Judging.from_message(message)
        _ = judging.assumptions  # refused if invalid
        scenario = scenario_of(message)
        check_specs(judging.parsed_specs, scenario)
        self.world = make_world(scenario)
        self.camera = scenario.camera_model
        self.first = rolling_on(scenario.speed_mps)
        self.commands = LateCommands(timing, message.seed, message.index, scenario)
        may_stop = judging.stop_on is not StopOn.NEVER
        if timing.free and may_stop:
            raise UsageError(
                f'stop_on {message.stop_on}: not in a free run, which does not wait for the monitor'
            )
        if timing.free:
            check_free(scenario)
            if beside := set(interface.BESIDE) & set(self.participants):
                raise UsageError(
                    f'participants: {min(beside)}: not in a free run, where frames may be lost'
                )
        roles: dict[str, Any] = {
            'participants': self.participants, 'chain': interface.CHAIN,
            'followers': interface.FOLLOWERS, 'last_seq': self.world.last_seq,
        }
        self.free = FreeRun(**roles, factor=timing.factor) if timing.free else None
        self.lockstep = self.free or Lockstep(
            **roles, enders=(interface.MTL_MONITOR,) if may_stop else (),
        )
        self.listens: dict[str, set[str]] = {}
        self.ready: dict[str, NodeStatus] = {}
        self.perception = {'perception': '', 'fingerprint': ''}
        self.started = False
        self.publishers: dict[str, int] = {}
        self.command: TaxiCommand | None = None
        self.suspect: tuple[InfraError, float] | None = None
        self.verdict: Verdict | None = None
        self.ending: RunStatus | None = None
        self.told_account: TimingMessage | None = None
        self.unwanted_s = 0.0  # Time of a cancel request, monotonic clock.
        self.done = Future(executor=executor)
        self.created = self.last_heard = time.monotonic()

    def listeners(self, topic: str) -> set[str]:
        """Participants that have declared a subscription to a topic.

        Only a free run publishes timing, and its followers must receive it.
        """
        if self.free is not None and topic == interface.TIMING.name:
            return set(interface.FOLLOWERS) & set(self.participants)
        return {node for node, topics in self.listens.items() if topic in topics}

    def reset_watchdog(self) -> None:
        """Restart the watchdog after an answer."""
        self.last_heard = time.monotonic()

    def finish(self) -> None:
        """Send the announced ending to the client."""
        if not self.done.done():
            self.done.set_result(self.ending)

    def status(self, state: int, **what: Any) -> RunStatus:
        """Status message of this run at its current step."""
        seq = max(self.lockstep.seq, 0)
        return RunStatus(
            header=header(seq * CONTROL_PERIOD_NS), run_id=self.run_id, state=state, seq=seq,
            **self.perception, **what,
        )

    def feedback(self) -> RunScenario.Feedback:
        """Progress of the run."""
        seq = max(self.lockstep.seq, 0)
        return RunScenario.Feedback(seq=seq, elapsed=seq * CONTROL_PERIOD_NS / 1e9)


def not_begun(run_id: str, error: Exception) -> RunStatus:
    """Ending of a run whose world could not be built: invalid scenario or infrastructure error."""
    status = RunStatus(
        run_id=run_id, state=RunStatus.ENDED, outcome=Outcome.INFRA_ERROR, kind=InfraKind.SIM,
        who=interface.SIMULATOR, detail=one_line(error),
    )
    if isinstance(error, UsageError):
        status.outcome, status.kind, status.who = Outcome.REJECTED, '', ''
        status.detail = str(error)
    elif isinstance(error, InfraError):
        status.kind, status.who, status.detail = error.kind, error.who, error.detail
    return status


_OF_FREE_RUNS = ('unanswered', 'late', 'stale', 'overruns')


class RunHealth:
    """Health of the simulator: current run, pace and the nodes it waits for.

    Attributes:
        frames: time to make and publish frames.
    """

    def __init__(self) -> None:
        """Start without a run."""
        self.frames = Pace()
        self._ended: Counter[str] = Counter()
        self._broken = ''

    def ended(self, run_id: str, status: RunStatus) -> None:
        """Record the end of a run."""
        self._ended[status.outcome] += 1
        self._broken = ''
        if status.outcome == Outcome.INFRA_ERROR:
            self._broken = f'run {run_id} broke: {status.kind} {status.who}: {status.detail}'

    def look(self, run: ActiveRun | None, waits_for: str) -> Health:
        """Health since the last look.

        Args:
            run: the current run, if any.
            waits_for: names of the nodes it waits for; '' for none. In a free run, names of nodes
                silent for too long.
        """
        rate, frames = self.frames.look('frame')
        values: dict[str, object] = {
            'step rate [1/s]': rate, 'real-time factor': rate * CONTROL_PERIOD_NS / NS_PER_S,
            **frames, 'runs ended': self._ended.total(),
            **{f'runs {outcome}': count for outcome, count in sorted(self._ended.items())},
        }
        if run is None:
            level = DiagnosticStatus.ERROR if self._broken else DiagnosticStatus.OK
            return Health(level=level, message=self._broken or 'no run', values=values)
        waited_s = time.monotonic() - run.last_heard
        values |= {
            'run': run.run_id, 'step': run.lockstep.seq, 'last step': run.world.last_seq,
            'waits for': waits_for, 'silent for [s]': waited_s, **run.perception,
        }
        free = run.free is not None and run.started and run.ending is None
        if run.free is not None:
            figures = run.free.account.figures()
            values |= {f'free run, {name}': figures[name] for name in _OF_FREE_RUNS}
        if waits_for and (free or too_long(waited_s)):
            since = '' if free else f' {waited_s:.1f} s'
            line = f'run {run.run_id} has waited{since} for {waits_for}'
            return Health(level=DiagnosticStatus.WARN, message=line, values=values)
        line = f'run {run.run_id}: step {run.lockstep.seq} of {run.world.last_seq}'
        return Health(message=line if run.started else f'run {run.run_id}: starting',
                      values=values)
