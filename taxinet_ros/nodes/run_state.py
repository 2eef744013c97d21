"""Everything that belongs to the one run that the simulator is at."""

from __future__ import annotations

import time
from typing import Any

from rclpy.task import Future
from taxinet_msgs.action import RunScenario
from taxinet_msgs.msg import NodeStatus, RunStatus, Verdict

from taxinet_ros.bag.layout import is_run_name
from taxinet_ros.bag.message_values import scenario_of
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.errors import InfraError, UsageError
from taxinet_ros.core.free_run import FreeRun
from taxinet_ros.core.lockstep import Lockstep
from taxinet_ros.core.loop import LateCommands
from taxinet_ros.core.mtl import parse_assumptions, parse_spec
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.spec_check import check_specs
from taxinet_ros.core.stop_on import StopOn, parse_stop_on
from taxinet_ros.core.timing import Timing
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.core.world import World
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.convert import header
from taxinet_ros.nodes.names import check_participants
from taxinet_ros.nodes.participant import one_line


class ActiveRun:
    """The world, the lockstep's bookkeeping and the answer that a goal's client waits for."""

    def __init__(self, goal: Any, executor: Any, timing: Timing) -> None:
        """Build the world that the goal's scenario describes.

        Args:
            goal: of the action.
            executor: of the node.
            timing: when answers take effect.

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
        parse_assumptions(message.bounds, message.rates)
        scenario = scenario_of(message)
        check_specs([parse_spec(text) for text in message.specs], scenario.duration_s)
        self.world = World(scenario)
        self.commands = LateCommands(timing, message.seed, message.index)
        may_stop = parse_stop_on(message.stop_on) is not StopOn.NEVER
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

    def heard(self) -> None:
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
        run_id=run_id, state=RunStatus.ENDED, outcome=Outcome.INFRA_ERROR, kind='sim',
        who=interface.SIMULATOR, detail=one_line(error),
    )
    if isinstance(error, UsageError):
        status.outcome, status.kind, status.who = Outcome.REJECTED, '', ''
        status.detail = str(error)
    elif isinstance(error, InfraError):
        status.kind, status.who, status.detail = error.kind, error.who, error.detail
    return status
