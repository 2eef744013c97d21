"""Simulator node: world, camera, clock and lockstep control.

It serves the action ``run_scenario``. For each goal it publishes the scenario, waits until every
participant is ready, then publishes frame after frame; it integrates to the next only after the
command for the current one has arrived. Wall-clock watchdogs turn silence into ``INFRA_ERROR``;
they never decide a verdict.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.clock import Clock as RclClock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from taxinet_msgs.msg import NodeStatus, RunStatus, Verdict

from taxinet_ros.bag.run.messages import observation_messages
from taxinet_ros.core import topics
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.motion.controller import STOP
from taxinet_ros.core.pacing.free_run import FreeRun
from taxinet_ros.core.pacing.timing import LAWS, MOST_FACTOR, parse_latency
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.core.verdict.outcome import NOT_JUDGED, Outcome, outcome_of
from taxinet_ros.core.world import check_picture, close_world, find_world
from taxinet_ros.errors import InfraError, InfraKind
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.lockstep import diagnostics
from taxinet_ros.nodes.lockstep.active_run import (
    FREE_TICK_S,
    ActiveRun,
    RunHealth,
    check_answer,
    check_command,
    chosen_timing,
    not_begun,
)
from taxinet_ros.nodes.lockstep.diagnostics import PARAMETER as DIAGNOSTICS
from taxinet_ros.nodes.lockstep.diagnostics import Diagnostics, Health
from taxinet_ros.nodes.lockstep.endpoints import (
    brief_intruder,
    has_its_publishers,
    heard_by,
    hears,
    intruder,
    missing_nodes,
    second_publisher_events,
    why_silent,
)
from taxinet_ros.nodes.messages.convert import (
    account_message,
    duplicate_node_error,
    header,
    one_line,
    parse_blame,
    same_ready,
    settled_message,
)
from taxinet_ros.nodes.messages.step import (
    StepMessage,
    TransformBroadcaster,
    is_read_raw,
    step_reader,
)
from taxinet_ros.nodes.running.domain import require_free_domain
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import (
    Parameter,
    Usage,
    declare_all,
    published_topics,
    refuse_unknown,
    subscribed_topics,
)
from taxinet_ros.registry import CAMERAS, KMWH, WORLDS, names

_WATCH_PERIOD_S = 0.1
_LAST_STEP_S = 1.0
"""Maximum wait [s] for the answers to the current frame when a run is aborted."""

_DELIVERY_S = 0.3
"""Time [s] for delivery of the last answer before this node leaves the graph."""

_STALLED_S = 1.0
"""Step duration [s] above which the missing nodes count as awaited."""

_RESULT_KEPT_S = 10  # rclpy would keep those of 15 minutes, and list them at each change
_CERTAIN = (InfraKind.INTRUDER, InfraKind.DIED)
_SUSPECTED_S = 1.0
"""Time [s] to wait for evidence that another node caused a node's protocol error."""


_OPTIONS = (
    Parameter(
        name='answer_timeout', default=10.0, limits=(0.1, 3600.0),
        description='wall-clock silence of a participant that ends a run as INFRA_ERROR [s]',
    ),
    Parameter(
        name='ready_timeout', default=30.0, limits=(0.1, 3600.0),
        description='wall-clock time for every participant to get ready [s]',
    ),
    Parameter(
        name='latency', default='',
        takes=f'perception=LATENCY or controller=LATENCY, LATENCY being {LAWS}; or empty',
        description='how late answers take effect [s]',
    ),
    Parameter(
        name='lockstep', default=True,
        description='simulated time waits for every answer; false: it goes by the wall clock',
    ),
    Parameter(
        name='real_time_factor', default=1.0, limits=(0.0, MOST_FACTOR),
        description='simulated seconds per second of a free run (lockstep false); 0: as fast as it '
        'goes',
    ),
    Parameter(
        name='world', default=KMWH,
        takes=f'{", ".join(names(WORLDS))}, each with +CAMERA: {", ".join(names(CAMERAS))}',
        description='the world that runs take place in, and who takes its pictures',
    ),
    Parameter(
        name='world_sha256', default='', takes='64 hexadecimal digits, or empty',
        description="required SHA-256 of the world's package; empty: any",
    ),
)

USAGE = Usage(
    executable=interface.SIMULATOR,
    does='The world, its camera, the clock, and the keeper of the lockstep: for each goal it has '
    'the graph get ready, and steps the world by its answers.',
    publishes=published_topics(interface.SIMULATOR),
    subscribes=subscribed_topics(interface.SIMULATOR),
    other=f'serves the action {interface.RUN_SCENARIO} (taxinet_msgs/action/RunScenario)',
    parameters=(*_OPTIONS, DIAGNOSTICS),
)


class Simulator(Node):
    """Runs one world at a time, stepped by the answers of the graph."""

    def __init__(self, **node: Any) -> None:
        """Declare parameters and join the graph; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(interface.SIMULATOR, **node)
        given = declare_all(self, _OPTIONS)
        self._answer_timeout_s = given['answer_timeout']
        self._ready_timeout_s = given['ready_timeout']
        self._timing = chosen_timing(
            parse_latency([given['latency']]), lockstep=given['lockstep'],
            factor=given['real_time_factor'],
        )
        self._world = find_world(given['world'], given['world_sha256'])
        self._health = RunHealth()
        self._diagnostics = Diagnostics(self, self._diagnose)
        refuse_unknown(self)
        self._run: ActiveRun | None = None
        self._leaving = False
        self._may_leave_s = 0.0
        self._speakers: dict[str, Publisher] = {}
        self._listeners: dict[str, Subscription] = {}
        for topic in interface.TOPICS:
            if interface.SIMULATOR in topic.publishers:
                self._speakers[topic.name] = self.create_publisher(
                    topic.type, topic.name, topic.qos
                )
        for topic, callback in (
            (interface.NODE_STATUS, self._on_status),
            (interface.PROGRESS, self._on_progress),
            (interface.ESTIMATE, self._on_estimate),
            (interface.COMMAND, self._on_command),
            (interface.VERDICT, self._on_verdict),
        ):
            hear = functools.partial(self._hear, step_reader(topic), callback)
            self._listeners[topic.name] = self.create_subscription(
                topic.type, topic.name, hear, topic.end_qos, raw=is_read_raw(topic),
                event_callbacks=second_publisher_events(topic, self._on_second_publisher),
            )
        self._transforms = TransformBroadcaster(self)
        topic = interface.OBITUARY
        told = functools.partial(self._hear, step_reader(topic), self._on_death_notice)
        self.create_subscription(topic.type, topic.name, told, topic.qos)
        self._server = ActionServer(
            self,
            interface.RUN_SCENARIO_TYPE,
            interface.RUN_SCENARIO,
            self._execute,
            goal_callback=self._accept,
            cancel_callback=self._cancel,
            result_timeout=_RESULT_KEPT_S,
        )
        steady = RclClock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_WATCH_PERIOD_S, self._watch, clock=steady)
        if self._timing.free:
            self._held: TaxiCommand = STOP
            self.create_timer(FREE_TICK_S, self._tick, clock=steady)

    def may_leave(self) -> bool:
        """Whether the current run has ended as INTERRUPTED, or all other nodes have left."""
        self._leaving = True
        alone = not self._speakers[interface.SCENARIO.name].get_subscription_count()
        return alone or (self._run is None and time.monotonic() >= self._may_leave_s)

    def waits_for(self) -> Iterable[str]:
        """Names of the nodes that the current run waits for: see :mod:`.waiting`."""
        run = self._run
        if run is None:
            return ()
        if run.started and time.monotonic() - run.last_heard < _STALLED_S:
            return ()
        return self._awaited(run)

    def close(self) -> None:
        """Leave the graph, since a remaining server would answer the next graph's goals."""
        self._server.destroy()

    # The action ------------------------------------------------------------------------------

    def _accept(self, goal: Any) -> GoalResponse:
        busy = self._leaving or self._run is not None
        if busy:
            self.get_logger().warning(f'refused run {goal.scenario.run_id}: another one is active')
        return GoalResponse.REJECT if busy else GoalResponse.ACCEPT

    def _cancel(self, goal: Any) -> CancelResponse:
        """Refuse to cancel a run that is over, since a cancelled run gets no verdict."""
        run = self._run
        over = run is not None and run.goal is goal and run.ending is not None
        return CancelResponse.REJECT if over else CancelResponse.ACCEPT

    async def _execute(self, goal: Any) -> Any:
        result = interface.RUN_SCENARIO_TYPE.Result()
        scenario = goal.request.scenario
        try:
            run = ActiveRun(goal, self.executor, self._timing, self._world.make)
        except Exception as error:
            result.status = not_begun(scenario.run_id, error)
            goal.abort()
            return result
        self._run = run
        self._transforms.mount(run.camera)
        self._say(interface.SCENARIO, scenario)
        self._say(interface.NODE_STATUS, self._own_status(run))
        self._say(interface.RUN_STATUS, run.status(RunStatus.PREPARING))
        result.timing = self._timing.words
        result.status = await run.done
        if run.free is not None:
            # As the recorder was told: late answers no longer count.
            result.account = run.told_account or account_message(run.free, run.run_id)
        if result.status.outcome in (Outcome.PASS, Outcome.FAIL):
            result.verdict = run.verdict
        self._run = None
        close_world(run.world)
        self._health.ended(run.run_id, result.status)
        self._may_leave_s = time.monotonic() + _DELIVERY_S
        if result.status.outcome in (Outcome.PASS, Outcome.FAIL):
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result

    def _own_status(self, run: ActiveRun) -> NodeStatus:
        """Status of this node for the run's bag, with the timing of answers and the world."""
        return NodeStatus(
            header=header(0, ''), run_id=run.run_id, node=interface.SIMULATOR,
            state=NodeStatus.READY, implementation=self._timing.words,
            fingerprint=self._world.fingerprint,
            detail=self._world.origin,
        )

    # Messages of the graph ---------------------------------------------------------------------

    def _hear(
        self, read: Callable[[Any], Any], callback: Callable[[ActiveRun, Any], None], given: Any
    ) -> None:
        """Handle a message of the active run; any error ends that run."""
        run = self._run
        if run is not None:
            self._attempt(run, lambda: self._take(run, callback, read(given)))

    def _take(
        self, run: ActiveRun, callback: Callable[[ActiveRun, Any], None], message: Any
    ) -> None:
        # Before its first step a run has nothing to answer.
        early = not run.started and callback not in (self._on_status, self._on_death_notice)
        if message.run_id == run.run_id and not early:
            callback(run, message)

    def _attempt(self, run: ActiveRun, action: Callable[[], None]) -> None:
        try:
            action()
        except InfraError as error:
            self._fail(run, error.kind, error.who, error.detail)
        except Exception as error:
            self._fail(run, InfraKind.SIM, interface.SIMULATOR, one_line(error))

    def _on_status(self, run: ActiveRun, status: NodeStatus) -> None:
        if status.state == NodeStatus.READY and status.node in run.participants:
            if not same_ready(run.ready.setdefault(status.node, status), status):
                raise duplicate_node_error(status.node)
            run.listens[status.node] = set(status.listens)
            if status.node == interface.PERCEPTION:
                run.perception = {
                    'perception': status.implementation, 'fingerprint': status.fingerprint,
                }
            run.lockstep.ready(status.node)
            run.reset_watchdog()
            self._start_if_ready(run)
        elif status.state == NodeStatus.ERROR:
            self._on_error(run, status)
        elif status.state == NodeStatus.DONE and status.node == interface.RECORDER:
            self._on_done(run, status)

    def _on_error(self, run: ActiveRun, status: NodeStatus) -> None:
        blame = parse_blame(status.detail)
        if blame is not None and blame[0] == InfraKind.INTRUDER and not run.started:
            return  # a node that was started again; all publishers are checked before the start
        bag = status.node == interface.RECORDER
        usual = InfraKind.BAG if bag else InfraKind.NODE_ERROR, status.node, status.detail
        self._fail(run, *(blame or usual))

    def _on_done(self, run: ActiveRun, done: NodeStatus) -> None:
        """The recorder has closed its bag; a verdict counts only if the bag contains it."""
        if run.ending is None:
            detail = f'closed its bag as {done.detail} amid the run'
            self._fail(run, InfraKind.BAG, interface.RECORDER, detail)
        elif Outcome(run.ending.outcome).judged and (done.detail, done.seq) != (
            run.ending.outcome, run.ending.seq
        ):
            detail = f'closed its bag as {done.detail} at step {done.seq}'
            self._fail(run, InfraKind.BAG, interface.RECORDER, detail)
        else:
            run.finish()

    def _on_death_notice(self, run: ActiveRun, notice: NodeStatus) -> None:
        """A supervisor reports the death of a node, possibly of this one."""
        self._fail(run, InfraKind.DIED, notice.node, notice.detail)

    def _on_estimate(self, run: ActiveRun, estimate: StepMessage) -> None:
        check_answer(estimate, interface.PERCEPTION, run.lockstep.seq)
        if run.lockstep.answer(interface.PERCEPTION, estimate.seq, time.monotonic()):
            run.reset_watchdog()

    def _on_command(self, run: ActiveRun, command: StepMessage) -> None:
        if run.ending is not None:
            return
        try:
            check_answer(command, interface.STEERING_CONTROLLER, run.lockstep.seq)
        except InfraError as error:
            # It may repeat an error of the perception, whose estimate has then not arrived yet.
            run.suspect = run.suspect or (error, time.monotonic())
            return
        check_command(command.value, interface.STEERING_CONTROLLER, command.seq)
        # The estimate travels on another topic and may be overtaken by the command made from it.
        if run.free is None:
            run.lockstep.answer(interface.PERCEPTION, command.seq)
        if run.lockstep.answer(interface.STEERING_CONTROLLER, command.seq, time.monotonic()):
            run.command = command.value
            run.reset_watchdog()
            self._go_on(run)

    def _on_progress(self, run: ActiveRun, progress: StepMessage) -> None:
        if progress.seq > run.lockstep.seq:
            detail = f'has come to frame {progress.seq}, which is not out yet'
            raise InfraError(InfraKind.PROTOCOL, progress.value, run.lockstep.seq, detail)
        arrived = progress.stamp_ns // CONTROL_PERIOD_NS
        run.lockstep.progress(progress.value, progress.seq, arrived, time.monotonic())
        run.reset_watchdog()
        self._go_on(run)

    def _on_verdict(self, run: ActiveRun, verdict: Verdict) -> None:
        run.verdict = verdict
        if verdict.stopped_early:
            run.lockstep.end(interface.MTL_MONITOR)
        run.reset_watchdog()
        self._go_on(run)

    # Stepping --------------------------------------------------------------------------------

    def _start_if_ready(self, run: ActiveRun) -> None:
        if run.started or not run.lockstep.all_ready or self._deaf(run):
            return
        run.started = True
        run.publishers = self._count_publishers()
        self._say(interface.RUN_STATUS, run.status(RunStatus.RUNNING))
        self._publish_frame(run)

    def _deaf(self, run: ActiveRun) -> list[str]:
        """Topics on which this node has not yet found all other endpoints of the run."""
        unheard = [
            name
            for name, publisher in self._speakers.items()
            if not heard_by(self, publisher, run.listeners(name))
        ]
        return unheard + [
            topic.name for topic in interface.TOPICS if not (
                hears(self, self._listeners[topic.name], topic, run.participants)
                if topic.name in self._listeners
                else has_its_publishers(self, topic, run.participants)
            )
        ]

    def _go_on(self, run: ActiveRun) -> None:
        if run.ending is not None or not run.started:
            return
        if run.goal.is_cancel_requested and not run.unwanted_s:
            run.unwanted_s = time.monotonic()
        over = run.lockstep.complete and run.verdict is not None
        if run.unwanted_s and (over or run.command is not None):
            self._break_off(run)
        elif run.lockstep.may_advance and run.command is not None:
            command, run.command = run.command, None
            run.world.advance(run.commands.at(run.lockstep.seq, command))
            self._publish_frame(run)
        elif over and run.verdict is not None:
            self._conclude(run, run.verdict)

    def _publish_frame(self, run: ActiveRun) -> None:
        # Rendering is the slowest part, so skip it without subscribers.
        begun_s = time.perf_counter() if self._diagnostics.watched else 0.0
        looked_at = self._speakers[interface.IMAGE.name].get_subscription_count() > 0
        now = run.world.observe(picture=looked_at)
        for who in sorted(run.listeners(interface.IMAGE.name)):
            check_picture(now, who)
        run.lockstep.begin(now.seq, time.monotonic())
        for topic, message in observation_messages(now, run.run_id, run.camera):
            self._say(topic, message)
            if topic is topics.ODOMETRY:
                self._transforms.follow(message)
        # A camera may take longer for a picture than the others may for their answers.
        run.reset_watchdog()
        if run.free is not None:
            self._held = run.command or run.first
            self._say(interface.TIMING, settled_message(run.free, run.run_id))
        if begun_s:
            self._health.frames.took(time.perf_counter() - begun_s)

    def _tick(self) -> None:
        """Advance a free run if its next step is due."""
        run = self._run
        if run is not None and run.free is not None and run.started and run.ending is None:
            free = run.free
            self._attempt(run, lambda: self._go_freely(run, free))

    def _go_freely(self, run: ActiveRun, free: FreeRun) -> None:
        now_s = time.monotonic()
        if run.unwanted_s:
            self._break_off(run)
        elif free.seq < free.last_seq:
            if free.pace.due(now_s) and free.room:
                run.world.advance(self._held)
                self._publish_frame(run)
        elif free.closed:
            message = settled_message(free, run.run_id)
            if message.unestimated or message.uncommanded:
                self._say(interface.TIMING, message)
            self._go_on(run)
        else:
            free.closed = free.pace.due(now_s)

    def _conclude(self, run: ActiveRun, verdict: Verdict) -> None:
        outcome = outcome_of(verdict)
        if not outcome.judged:
            self._fail(run, **NOT_JUDGED)
            return
        if (found := self._intruder(run)) is not None:
            self._fail(run, InfraKind.INTRUDER, *found)
            return
        self._end(run, run.status(RunStatus.ENDED, outcome=outcome))

    # Endings ---------------------------------------------------------------------------------

    def _count_publishers(self) -> dict[str, int]:
        """Number of publishers of each topic of a run."""
        return {topic.name: self.count_publishers(topic.name) for topic in interface.TOPICS}

    def _intruder(self, run: ActiveRun) -> tuple[str, str] | None:
        """A node that publishes on a topic of the run, and a line on it."""
        every = (intruder(self, topic, run.participants) for topic in interface.TOPICS)
        return next((found for found in every if found is not None), None)

    def _fail(self, run: ActiveRun, kind: str, who: str, detail: str) -> None:
        # The error may be caused by a node outside the run; but one that died may have been started
        # again.
        doubtful = run.started and run.ending is None and kind not in _CERTAIN
        if doubtful and (found := self._intruder(run)) is not None:
            kind, (who, detail) = InfraKind.INTRUDER, found
        status = run.status(
            RunStatus.ENDED, outcome=Outcome.INFRA_ERROR, kind=kind, who=who, detail=detail
        )
        recorder_lost = interface.RECORDER in who.split(', ') and kind != InfraKind.INTRUDER
        judged = run.ending is not None and Outcome(run.ending.outcome).judged
        if run.ending is None or (judged and who == interface.SIMULATOR):
            self._end(run, status, recorder_lost)
        elif recorder_lost:
            # The bag could not be finished, so the evidence is incomplete and no verdict counts. An
            # earlier error remains the reason.
            if run.ending.outcome != Outcome.INFRA_ERROR:
                run.ending = status
            run.finish()

    def _break_off(self, run: ActiveRun) -> None:
        """Abort a run, between two steps if possible."""
        self._end(run, run.status(RunStatus.ENDED, outcome=Outcome.INTERRUPTED))

    def _end(self, run: ActiveRun, status: RunStatus, recorder_lost: bool = False) -> None:
        """Announce the end, then wait until the recorder, if any, has closed its bag."""
        run.ending = status
        run.reset_watchdog()
        if run.free is not None:
            run.told_account = account_message(run.free, run.run_id)
            self._say(interface.TIMING, run.told_account)
        self._say(interface.RUN_STATUS, status)
        if recorder_lost or interface.RECORDER not in run.participants:
            run.finish()

    def _diagnose(self) -> Health:
        """Health of this node, for diagnostics."""
        run = self._run
        return self._health.look(run, ', '.join(self._awaited(run)) if run is not None else '')

    def _awaited(self, run: ActiveRun) -> list[str]:
        """Names of the nodes that a run waits for; in a free run, those overdue."""
        if run.ending is not None:
            return [interface.RECORDER]
        if not run.started:
            return self._unready(run)[1].split(', ')
        if run.free is not None:
            silent = run.free.silent(time.monotonic(), diagnostics.PATIENCE_S)
            return [silent] if silent else []
        return [interface.MTL_MONITOR] if run.lockstep.complete else run.lockstep.missing()

    def _watch(self) -> None:
        run = self._run
        if run is None:
            return
        now = time.monotonic()
        silence = now - run.last_heard
        run.goal.publish_feedback(run.feedback())
        if not run.unwanted_s and (self._leaving or run.goal.is_cancel_requested):
            run.unwanted_s = now
        if run.ending is not None:
            self._await_recorder(run, silence)
        elif not run.started:
            self._attempt(run, lambda: self._await_ready(run))
        else:
            self._watch_steps(run, now, silence)
            changed = run.ending is None and self._count_publishers() != run.publishers
            if changed and (found := self._intruder(run)) is not None:
                self._fail(run, InfraKind.INTRUDER, *found)

    def _on_second_publisher(self, topic: Topic) -> None:
        run = self._run
        if run is not None and run.started and run.ending is None:
            self._fail(run, InfraKind.INTRUDER, *brief_intruder(self, topic, run.participants))

    def _watch_steps(self, run: ActiveRun, now: float, silence: float) -> None:
        if run.unwanted_s and now - run.unwanted_s > _LAST_STEP_S:
            self._break_off(run)
        elif run.unwanted_s:
            self._go_on(run)
        elif run.suspect is not None and now - run.suspect[1] > _SUSPECTED_S:
            error = run.suspect[0]
            self._fail(run, error.kind, error.who, error.detail)
        elif run.free is not None and (
            who := run.free.silent(now, self._answer_timeout_s)
        ):
            self._fail_silent(run, who)
        elif silence > self._answer_timeout_s:
            self._fail_silent(run, (run.lockstep.missing() or [interface.MTL_MONITOR])[0])

    def _fail_silent(self, run: ActiveRun, who: str) -> None:
        why = why_silent(self, who, run.participants)
        detail = f'silent for {self._answer_timeout_s:g} s' + (f': it {why}' if why else '')
        self._fail(run, InfraKind.TIMEOUT, who, detail)

    def _await_recorder(self, run: ActiveRun, silence_s: float) -> None:
        """Wait for the recorder to close its bag; during a shutdown it may have left."""
        # Its first endpoint: others may not be discovered yet although it knows of the run.
        ends = self.get_subscriptions_info_by_topic(interface.SCENARIO.name)
        if self._leaving and interface.RECORDER not in {end.node_name for end in ends}:
            run.finish()
        elif silence_s > self._answer_timeout_s:
            self._fail(run, InfraKind.TIMEOUT, interface.RECORDER, 'did not finish its bag')

    def _await_ready(self, run: ActiveRun) -> None:
        self._start_if_ready(run)
        if run.started:
            return
        if run.unwanted_s:
            self._break_off(run)
        elif time.monotonic() - run.created > self._ready_timeout_s:
            self._fail(run, *self._unready(run))

    def _unready(self, run: ActiveRun) -> tuple[str, str, str]:
        """Kind, who and detail for a run that could not start; only nodes that others wait for."""
        within = f'not ready within {self._ready_timeout_s:g} s'
        if (found := self._intruder(run)) is not None:
            return InfraKind.INTRUDER, found[0], f'{found[1]} ({within})'
        if absent := missing_nodes(self, run.participants):
            names = sorted(absent)
            return InfraKind.NOT_READY, ', '.join(names), f'{within}: {absent[names[0]]}'
        if silent := run.lockstep.missing():
            why = why_silent(self, silent[0], run.participants) or 'does not say that it is ready'
            detail = f'{within}: {why}'
            return InfraKind.NOT_READY, ', '.join(silent), detail
        detail = f'{within}: not all ends are found on {", ".join(self._deaf(run))}'
        return InfraKind.NOT_READY, interface.SIMULATOR, detail

    def _say(self, topic: topics.Topic, message: Any) -> None:
        self._speakers[topic.name].publish(message)


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros simulator``."""
    run_node(_alone, usage=USAGE)


def _alone() -> Simulator:
    require_free_domain()
    return Simulator()


if __name__ == '__main__':
    main()
