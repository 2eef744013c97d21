"""The simulator's current run: its world, and what it says and asks of the graph; its health."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.task import Future
from taxinet_msgs.action import RunScenario
from taxinet_msgs.msg import NodeStatus, RunStatus
from taxinet_msgs.msg import Timing as TimingMessage

from taxinet_ros.bag.layout import is_run_name
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.bag.run.messages import camera_info_cdr, observation_messages
from taxinet_ros.bag.run.topics import CAMERA2_FRAME
from taxinet_ros.core import topics
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, Observation, rolling_on
from taxinet_ros.core.faults import check_free
from taxinet_ros.core.loop import LateCommands
from taxinet_ros.core.pacing.free_run import FreeRun
from taxinet_ros.core.pacing.lockstep import Lockstep
from taxinet_ros.core.pacing.stepped_run import Ending, LiveGraph, SteppedRun
from taxinet_ros.core.pacing.timing import Timing
from taxinet_ros.core.types import NS_PER_S, TaxiCommand, step_stamp_ns
from taxinet_ros.core.verdict.judge import check_specs
from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.core.world import check_picture, close_world
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep import diagnostics
from taxinet_ros.nodes.lockstep.diagnostics import Health, Pace, too_long
from taxinet_ros.nodes.messages.convert import (
    account_message,
    header,
    one_line,
    parse_blame,
    same_ready,
)
from taxinet_ros.nodes.names import check_participants
from taxinet_ros.nodes.running import domain


class ActiveRun(LiveGraph):
    """A run on the simulator's graph.

    Attributes:
        goal: the action's goal handle.
        scenario: that it takes place in.
        camera: model of its camera.
        frame: the newest one, once there is one.
        steps: the run itself.
        done: future of the final status.
        account: last message on the timing of a free run.
        verdict: message with the judgement.
        ready: READY message of each participant.
    """

    def __init__(self, goal: Any, node: Any) -> None:
        """Build the world of the goal's scenario.

        Args:
            goal: the action's goal handle.
            node: the :class:`.Simulator`.

        Raises:
            UsageError: the scenario has a value out of range, a name that is no valid folder name,
                an unknown stop rule, no formula, an invalid one or one that cannot be evaluated on
                a run of this length, an invalid assumption, a missing required node, or an unknown
                node.
            InfraError: the world cannot be built.
        """
        message = goal.request.scenario
        self.goal, self._node = goal, node
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
        self.scenario, self.camera = scenario, scenario.camera_model
        self.frame: Observation | None = None
        may_stop, timing = judging.stop_on is not StopOn.NEVER, node.timing
        if timing.free:
            if may_stop:
                raise UsageError(
                    f'stop_on {message.stop_on}: not in a free run, which does not wait for the '
                    'monitor'
                )
            check_free(scenario)
            if beside := set(interface.BESIDE) & set(self.participants):
                raise UsageError(
                    f'participants: {min(beside)}: not in a free run, where frames may be lost'
                )
        self.world = node.world.make(scenario)
        self.steps = SteppedRun(
            self, self._bookkeeping(timing, may_stop), participants=self.participants,
            first=rolling_on(scenario.speed_mps),
            late=LateCommands(timing, message.seed, message.index, scenario).at,
            answer_timeout_s=node.answer_timeout_s, ready_timeout_s=node.ready_timeout_s,
            clock=time.monotonic, period_ns=scenario.period_ns,
        )
        self.listens: dict[str, set[str]] = {}
        self.ready: dict[str, NodeStatus] = {}
        self.perception = {'perception': '', 'fingerprint': ''}
        self.verdict = interface.VERDICT.type()
        self.account = TimingMessage()
        self.done = Future(executor=node.executor)
        self._rest = Future(executor=node.executor)

    def _bookkeeping(self, timing: Timing, may_stop: bool) -> Lockstep:
        roles: dict[str, Any] = {
            'participants': self.participants, 'chain': interface.CHAIN,
            'followers': interface.FOLLOWERS, 'last_seq': self.world.last_seq,
        }
        if timing.free:
            return FreeRun(**roles, factor=timing.factor)
        return Lockstep(**roles, enders=(interface.MTL_MONITOR,) if may_stop else ())

    @property
    def seq(self) -> int:
        """Current control step."""
        return max(self.steps.lockstep.seq, 0)

    @property
    def stamp_ns(self) -> int:
        """Simulated time of the current control step [ns]."""
        return step_stamp_ns(self.seq, self.scenario.period_ns)

    def listeners(self, topic: topics.Topic) -> set[str]:
        """Nodes that subscribe to a topic, as participants declare for themselves or for others.

        Only a free run publishes timing, and its followers must receive it.
        """
        if self.steps.free is not None and topic.name == interface.TIMING.name:
            return set(interface.FOLLOWERS) & set(self.participants)
        heard = [
            (*name.split('@', 1), node) for node, names in self.listens.items() for name in names
        ]
        return {node for name, node, *_ in heard if name == topic.name}

    def status(self, state: int, **what: Any) -> RunStatus:
        """Status message of this run at its current step."""
        return RunStatus(
            header=header(self.stamp_ns), run_id=self.run_id, state=state,
            seq=self.seq, **self.perception, **what,
        )

    def close(self) -> None:
        """Release the world, which is large, at once, and those who wait for the run."""
        self.held()
        close_world(self.world)
        del self.world

    def feedback(self) -> RunScenario.Feedback:
        """Progress of the run."""
        return RunScenario.Feedback(seq=self.seq, elapsed=self.stamp_ns / 1e9)

    def prepare(self) -> None:
        """Have all nodes get ready."""
        node = self._node
        node.transforms.mount(*self.scenario.cameras)
        node.say(interface.SCENARIO, self.goal.request.scenario)
        node.say(interface.NODE_STATUS, NodeStatus(
            header=header(0, ''), run_id=self.run_id, node=interface.SIMULATOR,
            state=NodeStatus.READY, implementation=node.timing.words,
            fingerprint=node.world.fingerprint, detail=node.world.origin,
        ))
        node.say(interface.RUN_STATUS, self.status(RunStatus.PREPARING))

    def on_message(self, topic: topics.Topic, message: Any) -> None:
        """Take a message of a topic that the simulator listens to.

        Raises:
            InfraError: its node does not keep to the protocol.
        """
        if message.run_id != self.run_id:
            return
        if topic is interface.NODE_STATUS:
            self._on_status(message)
        elif not self.steps.started:
            pass  # before its first step a run has nothing to answer
        elif topic is interface.ESTIMATE:
            self.steps.estimate(message.seq, message.stamp_ns, message.value)
        elif topic is interface.COMMAND:
            self.steps.command(message.seq, message.stamp_ns, message.value)
        elif topic is interface.PROGRESS:
            self.steps.progress(message.value, message.seq, message.stamp_ns)
        elif topic is interface.VERDICT:
            self.verdict = message
            self.steps.judged(message)

    def _on_status(self, status: NodeStatus) -> None:
        recorder = status.node == interface.RECORDER
        if status.state == NodeStatus.READY and status.node in self.participants:
            if not same_ready(self.ready.setdefault(status.node, status), status):
                words = 'two different nodes have this name'
                raise InfraError(InfraKind.INTRUDER, status.node, -1, words)
            self.listens[status.node] = set(status.listens)
            if status.node == interface.PERCEPTION:
                self.perception = {
                    'perception': status.implementation, 'fingerprint': status.fingerprint,
                }
            self.steps.ready(status.node)
        elif status.state == NodeStatus.ERROR:
            blame = parse_blame(status.detail)
            if blame is not None and blame[0] == InfraKind.INTRUDER and not self.steps.started:
                return  # a node started again; all publishers are checked before the start
            kind = InfraKind.BAG if recorder else InfraKind.NODE_ERROR
            self.steps.fail(*(blame or (kind, status.node, status.detail)))
        elif status.state == NodeStatus.DONE and recorder:
            self.steps.recorded(status.detail, status.seq)

    # See :class:`LiveGraph` --------------------------------------------------------------------

    def advance(self, command: TaxiCommand) -> None:
        """Move the world by one step."""
        self.world.advance(command)

    def observe(self) -> Observation:
        """Look at the world; rendering is the slowest part, so only for subscribers."""
        self._begun_s = time.perf_counter()
        looked_at = self._node.ends.speakers[interface.IMAGE.name].get_subscription_count() > 0
        now = self.world.observe(picture=looked_at)
        for who in sorted(self.listeners(interface.IMAGE)):
            check_picture(now, who)
        self.frame = now
        return now

    def publish(self, frame: Observation) -> None:
        """Publish a frame with its transforms; the second camera's if somebody looks."""
        seen = () if frame.measured is None else frame.measured.camera
        if seen and not any(
            self._node.ends.speakers[topic.name].get_subscription_count()
            for topic in (interface.CAMERA2, interface.CAMERA2_INFO)
        ):
            frame, seen = frame.without_second_camera, ()
        for picture in seen:
            self._node.say(interface.CAMERA2_INFO, camera_info_cdr(
                picture.stamp_ns, self.scenario.cameras[1], CAMERA2_FRAME))
        for topic, message in observation_messages(frame, frame.image, self.run_id, self.camera):
            self._node.say(topic, message)
            if topic is topics.ODOMETRY:
                self._node.transforms.follow(message)
        self._node.pace.frames.took(time.perf_counter() - self._begun_s)

    def settle(self, unestimated: Sequence[int], uncommanded: Sequence[int]) -> None:
        """Publish which earlier frames of a free run get no answer."""
        self._node.say(interface.TIMING, TimingMessage(
            header=header(self.stamp_ns, ''), run_id=self.run_id, seq=self.seq,
            unestimated=unestimated, uncommanded=uncommanded,
        ))

    def start(self) -> None:
        """Say that the run begins."""
        self._node.say(interface.RUN_STATUS, self.status(RunStatus.RUNNING))

    def announce(self, ending: Ending) -> None:
        """Say how the run ended."""
        if self.steps.free is not None:
            self.account = account_message(self.steps.free, self.run_id, self.stamp_ns)
            self._node.say(interface.TIMING, self.account)
        self._node.say(interface.RUN_STATUS, self._ended(ending))

    def finish(self, ending: Ending) -> None:
        """Give the ending to the client."""
        self.done.set_result(self._ended(ending))

    def held(self) -> None:
        """Release those who wait for a pause."""
        if not self._rest.done():
            self._rest.set_result(None)

    def rest(self) -> Future:
        """Future that is done when a pause holds the run between two steps, or it is closed."""
        if self._rest.done():
            self._rest = Future(executor=self._node.executor)
        return self._rest

    def _ended(self, ending: Ending) -> RunStatus:
        return self.status(
            RunStatus.ENDED, outcome=ending.outcome, kind=ending.kind, who=ending.who,
            detail=ending.detail,
        )

    def unmatched(self) -> list[str]:
        """Topics on which the simulator has not found all other nodes of the run."""
        ends = self._node.ends
        return [
            *ends.unmatched(self.participants, self.listeners),
            *(
                topic.name for topic in interface.TOPICS if topic.name not in ends.listeners
                and not domain.has_its_publishers(self._node, topic, self.participants)
            ),
        ]

    def intruder(self) -> tuple[str, str] | None:
        """See :func:`.domain.intruder`."""
        return domain.intruder(self._node, self.participants)

    def why_not_ready(self) -> tuple[str, str, str]:
        """See :func:`.domain.why_not_ready`."""
        silent = self.steps.lockstep.missing()
        return domain.why_not_ready(self._node, self.participants, silent, self.unmatched())

    def why_silent(self, who: str) -> str:
        """See :func:`.domain.why_silent`."""
        return domain.why_silent(self._node, who, self.participants)


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

    def look(self, run: ActiveRun | None) -> Health:
        """Health since the last look, with the current run, if any."""
        rate, frames = self.frames.look('frame')
        period_ns = CONTROL_PERIOD_NS if run is None else run.scenario.period_ns
        values: dict[str, object] = {
            'step rate [1/s]': rate, 'real-time factor': rate * period_ns / NS_PER_S,
            **frames, 'runs ended': self._ended.total(),
            **{f'runs {outcome}': count for outcome, count in sorted(self._ended.items())},
        }
        if run is None:
            level = DiagnosticStatus.ERROR if self._broken else DiagnosticStatus.OK
            return Health(level=level, message=self._broken or 'no run', values=values)
        steps = run.steps
        waited_s = time.monotonic() - steps.heard_s
        waits_for = ', '.join(steps.awaited(diagnostics.PATIENCE_S))
        values |= {
            'run': run.run_id, 'step': steps.lockstep.seq, 'last step': run.world.last_seq,
            'waits for': waits_for, 'silent for [s]': waited_s, **run.perception,
        }
        free = steps.free is not None and steps.started and steps.ending is None
        if steps.free is not None:
            figures = steps.free.account.figures()
            values |= {f'free run, {name}': figures[name] for name in _OF_FREE_RUNS}
        if waits_for and (free or too_long(waited_s)):
            since = '' if free else f' {waited_s:.1f} s'
            line = f'run {run.run_id} has waited{since} for {waits_for}'
            return Health(level=DiagnosticStatus.WARN, message=line, values=values)
        line = f'step {steps.lockstep.seq} of {run.world.last_seq}' if steps.started else 'starting'
        line += ', paused' * (steps.allowed == 0)
        return Health(message=f'run {run.run_id}: {line}', values=values)
