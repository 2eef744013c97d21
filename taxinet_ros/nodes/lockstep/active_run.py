"""The run that the simulator is at: its world and bookkeeping, checks of answers, health."""

from __future__ import annotations

import math
import time
from collections import Counter
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.task import Future
from taxinet_msgs.action import RunScenario
from taxinet_msgs.msg import NodeStatus, RunStatus, Verdict

from taxinet_ros.bag.layout import is_run_name
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.judge import check_specs
from taxinet_ros.core.judging import Judging, StopOn
from taxinet_ros.core.loop import LateCommands
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.pacing.free_run import FreeRun
from taxinet_ros.core.pacing.lockstep import Lockstep
from taxinet_ros.core.pacing.timing import Timing, free_timing
from taxinet_ros.core.types import NS_PER_S, TaxiCommand
from taxinet_ros.core.world import SimulatedWorld, WorldMaker
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep.diagnostics import Health, Pace, too_long
from taxinet_ros.nodes.messages.convert import header, one_line
from taxinet_ros.nodes.messages.step import StepMessage
from taxinet_ros.nodes.names import check_participants


def check_answer(answer: StepMessage, who: str, seq: int) -> None:
    """See that an answer is to a frame that is out. A late or repeated one is nothing bad.

    Args:
        answer: an estimate or a command.
        who: node that gave it.
        seq: the newest frame.

    Raises:
        InfraError: it is to a frame still to come, or contradicts itself about which.
    """
    if answer.seq > seq:
        detail = f'answered frame {answer.seq}, which is not out yet'
        raise InfraError(InfraKind.PROTOCOL, who, seq, detail)
    if answer.stamp_ns != answer.seq * CONTROL_PERIOD_NS:
        detail = f'its answer to frame {answer.seq} is stamped {answer.stamp_ns / 1e9:g} s'
        raise InfraError(InfraKind.PROTOCOL, who, seq, detail)


def check_command(command: TaxiCommand, who: str, seq: int) -> None:
    """See that an aircraft can follow the command that a node gave as its answer to a frame.

    Raises:
        InfraError: the angle is not finite, or the speed is not, or is negative.
    """
    if not (math.isfinite(command.steering_rad) and 0 <= command.speed_mps < math.inf):
        detail = f'commanded {command.steering_rad:g} rad at {command.speed_mps:g} m/s'
        raise InfraError(InfraKind.PROTOCOL, who, seq, detail)


FREE_TICK_S = 0.001
"""How often it is looked whether the next frame is due [s]: a hundredth of a step in real time."""


def chosen_timing(timing: Timing, *, lockstep: bool, factor: float) -> Timing:
    """What the simulator's parameters ask for together.

    Args:
        timing: with the latency.
        lockstep: simulated time waits for every answer.
        factor: simulated seconds per second of the wall clock in a free run; 0: no limit.

    Raises:
        UsageError: one of them has no effect beside another.
    """
    if lockstep and factor != 1.0:
        raise UsageError('simulator: real_time_factor: no effect in lockstep; set lockstep false')
    if not lockstep and timing.laws:
        raise UsageError(
            f'simulator: latency {timing.latency}: has no effect in a free run, where answers are '
            'as late as they are'
        )
    return timing if lockstep else free_timing(f'{factor!r}')


class ActiveRun:
    """The world, the lockstep's bookkeeping and the answer that a goal's client waits for."""

    def __init__(
        self, goal: Any, executor: Any, timing: Timing, make_world: WorldMaker = SimulatedWorld
    ) -> None:
        """Build the world that the goal's scenario describes.

        Args:
            goal: of the action.
            executor: of the node.
            timing: when answers take effect.
            make_world: makes the world.

        Raises:
            UsageError: the scenario has a value out of range, no name that a folder can have, an
                unknown rule to stop, no formula, one that is none or that a run of this length
                cannot be judged by, an assumption that is none, or lacks a node that every run
                needs, or names one that no run has.
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
        _ = judging.assumptions  # refused if they are none
        scenario = scenario_of(message)
        check_specs(judging.parsed_specs, scenario.duration_s, runway=scenario.runway)
        self.world = make_world(scenario)
        self.commands = LateCommands(timing, message.seed, message.index)
        may_stop = judging.stop_on is not StopOn.NEVER
        if timing.free and may_stop:
            raise UsageError(
                f'stop_on {message.stop_on}: not in a free run, where nobody waits for the monitor'
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
        self.command: TaxiCommand | None = None
        self.suspect: tuple[InfraError, float] | None = None
        self.verdict: Verdict | None = None
        self.ending: RunStatus | None = None
        self.unwanted_s = 0.0  # When somebody asked for its end, by the monotonic clock.
        self.done = Future(executor=executor)
        self.created = self.last_heard = time.monotonic()

    def listeners(self, topic: str) -> set[str]:
        """Participants that have said that they subscribe to a topic."""
        return {node for node, topics in self.listens.items() if topic in topics}

    def reset_watchdog(self) -> None:
        """Somebody answered: the watchdog starts anew."""
        self.last_heard = time.monotonic()

    def finish(self) -> None:
        """Answer the client with the ending announced."""
        if not self.done.done():
            self.done.set_result(self.ending)

    def status(self, state: int, **what: Any) -> RunStatus:
        """A status message of this run at its present step."""
        seq = max(self.lockstep.seq, 0)
        return RunStatus(
            header=header(seq * CONTROL_PERIOD_NS), run_id=self.run_id, state=state, seq=seq,
            **self.perception, **what,
        )

    def feedback(self) -> RunScenario.Feedback:
        """How far the run has come."""
        seq = max(self.lockstep.seq, 0)
        return RunScenario.Feedback(seq=seq, elapsed=seq * CONTROL_PERIOD_NS / 1e9)


def not_begun(run_id: str, error: Exception) -> RunStatus:
    """How a run ends whose world could not be built: the scenario's fault, or the bench's."""
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
    """How the simulator is doing: the run at hand, its pace and whom it waits for.

    Attributes:
        frames: what making and publishing frames takes.
    """

    def __init__(self) -> None:
        """Begin without a run."""
        self.frames = Pace()
        self._ended: Counter[str] = Counter()
        self._broken = ''

    def ended(self, run_id: str, status: RunStatus) -> None:
        """A run has ended."""
        self._ended[status.outcome] += 1
        self._broken = ''
        if status.outcome == Outcome.INFRA_ERROR:
            self._broken = f'run {run_id} broke: {status.kind} {status.who}: {status.detail}'

    def look(self, run: ActiveRun | None, waits_for: str) -> Health:
        """What to tell.

        Args:
            run: the run at hand, if there is one.
            waits_for: names of the nodes that it waits for now; '' for none. Of a free run, which
                waits for nobody, of those that have been silent for too long.
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
        return Health(message=line if run.started else f'run {run.run_id}: gets ready',
                      values=values)
