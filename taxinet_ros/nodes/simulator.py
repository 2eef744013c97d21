"""Simulator node: world, camera, clock and lockstep control.

It serves the action ``run_scenario``. For each goal it publishes the scenario, waits until every
participant is ready, then publishes frame after frame; it integrates to the next only after the
command for the current one has arrived (:mod:`taxinet_ros.core.pacing.stepped_run`). Wall-clock
watchdogs turn silence into ``INFRA_ERROR``; they never decide a verdict.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from taxinet_msgs.msg import NodeStatus

from taxinet_ros.core import topics
from taxinet_ros.core.pacing.timing import LAWS, MOST_FACTOR, timing_of
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import InfraError, InfraKind
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.lockstep import diagnostics, simulation_interfaces
from taxinet_ros.nodes.lockstep.active_run import ActiveRun, RunHealth, not_begun
from taxinet_ros.nodes.lockstep.diagnostics import Diagnostics, Health
from taxinet_ros.nodes.messages.convert import one_line
from taxinet_ros.nodes.messages.step import TransformBroadcaster, is_read_raw, step_reader
from taxinet_ros.nodes.running import domain
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import Parameter, Usage, declare_all, refuse_unknown
from taxinet_ros.registry import CAMERAS, KMWH, WORLDS, names

_WATCH_PERIOD_S = 0.1
_FREE_TICK_S = 0.001  # a hundredth of a step in real time
_DELIVERY_S = 0.3  # for the last answer, before this node leaves the graph
_STALLED_S = 1.0  # duration of a step above which the missing nodes count as awaited
_RESULT_KEPT_S = 10  # rclpy would keep those of 15 minutes, and list them at each change

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
USAGE = Usage.of_node(
    interface.SIMULATOR,
    does='The world, its camera, the clock, and the keeper of the lockstep: for each goal it has '
    'the graph get ready, and steps the world by its answers.',
    other=f'serves the action {interface.RUN_SCENARIO} (taxinet_msgs/action/RunScenario)',
    parameters=(*_OPTIONS, diagnostics.PARAMETER),
)


class Simulator(Node):
    """Runs one world at a time, stepped by the answers of the graph.

    Attributes:
        timing: when answers take effect.
        world: the world of its runs.
        run: the current one, if any.
        answer_timeout_s, ready_timeout_s: its parameters [s].
        ends: its publishers and subscriptions.
        transforms: publishes the frames of tf2.
        pace: figures of its frames and runs.
    """

    def __init__(self, **node: Any) -> None:
        """Declare parameters and join the graph; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(interface.SIMULATOR, **node)
        given = declare_all(self, _OPTIONS)
        self.answer_timeout_s = given['answer_timeout']
        self.ready_timeout_s = given['ready_timeout']
        self.timing = timing_of(
            given['latency'], lockstep=given['lockstep'], factor=given['real_time_factor']
        )
        self.world = find_world(given['world'], given['world_sha256'])
        self.pace = RunHealth()
        Diagnostics(self, self.health)
        refuse_unknown(self)
        self.run: ActiveRun | None = None
        self._leaving, self._may_leave_s = False, 0.0
        self.ends = domain.Endpoints(self, self._on_second_publisher)
        for topic in interface.TOPICS:
            if interface.SIMULATOR in topic.publishers:
                self.ends.speak(topic)
            if interface.SIMULATOR in topic.subscribers:
                on_message = functools.partial(self._on_message, topic, step_reader(topic))
                self.ends.listen(topic, on_message, raw=is_read_raw(topic))
        self.transforms = TransformBroadcaster(self)
        topic = interface.OBITUARY
        self.create_subscription(topic.type, topic.name, self._on_death_notice, topic.qos)
        self._servers = [ActionServer(
            self, interface.RUN_SCENARIO_TYPE, interface.RUN_SCENARIO, self._execute,
            goal_callback=self._accept, cancel_callback=self._cancel, result_timeout=_RESULT_KEPT_S,
        ), *simulation_interfaces.serve(self)]
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_WATCH_PERIOD_S, self._watch, clock=steady)
        if self.timing.free:
            tick = functools.partial(self.attempt, lambda run: run.steps.tick())
            self.create_timer(_FREE_TICK_S, tick, clock=steady)

    def say(self, topic: topics.Topic, message: Any) -> None:
        """Publish on a topic of the table."""
        self.ends.speakers[topic.name].publish(message)

    def may_leave(self) -> bool:
        """Whether the current run has ended as INTERRUPTED, or all other nodes have left."""
        self._leaving = True
        if self.run is not None:
            self.run.steps.cancel()
        alone = not self.ends.speakers[interface.SCENARIO.name].get_subscription_count()
        return alone or (self.run is None and time.monotonic() >= self._may_leave_s)

    def waits_for(self) -> Iterable[str]:
        """Names of the nodes that the current run waits for: see :class:`.node_main.Waiting`."""
        run = self.run
        if run is None or time.monotonic() - run.steps.heard_s < _STALLED_S:
            return ()
        return run.steps.awaited(diagnostics.PATIENCE_S)

    def health(self) -> Health:
        """Health of this node, for diagnostics."""
        return self.pace.look(self.run)

    def close(self) -> None:
        """Leave the graph, since a remaining server would answer the next graph's goals."""
        for server in self._servers:
            server.destroy()

    # The action ------------------------------------------------------------------------------

    def _accept(self, goal: Any) -> GoalResponse:
        if not self._leaving and self.run is None:
            return GoalResponse.ACCEPT
        self.get_logger().warning(f'refused run {goal.scenario.run_id}: another one is active')
        return GoalResponse.REJECT

    def _cancel(self, goal: Any) -> CancelResponse:
        """Refuse to cancel a run that is over, since a cancelled run gets no verdict."""
        run = self.run
        if run is not None and run.goal is goal:  # otherwise it is seen when the run begins
            if run.steps.ending is not None:
                return CancelResponse.REJECT
            run.steps.cancel()
        return CancelResponse.ACCEPT

    async def _execute(self, goal: Any) -> Any:
        result = interface.RUN_SCENARIO_TYPE.Result()
        try:
            run = ActiveRun(goal, self)
        except Exception as error:
            result.status = not_begun(goal.request.scenario.run_id, error)
            goal.abort()
            return result
        self.run = run
        if goal.is_cancel_requested:
            run.steps.cancel()
        run.prepare()
        result.status = await run.done
        result.timing, result.account = self.timing.words, run.account
        self.run = None
        run.close()
        self.pace.ended(run.run_id, result.status)
        self._may_leave_s = time.monotonic() + _DELIVERY_S
        if Outcome(result.status.outcome).judged:
            result.verdict = run.verdict
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result

    # The graph -------------------------------------------------------------------------------

    def attempt(self, action: Callable[[ActiveRun], None]) -> None:
        """Do something for the active run; any error ends that run."""
        run = self.run
        if run is None:
            return
        try:
            action(run)
        except InfraError as error:
            run.steps.fail(error.kind, error.who, error.detail)
        except Exception as error:
            run.steps.fail(InfraKind.SIM, interface.SIMULATOR, one_line(error))

    def _on_message(self, topic: Topic, read: Callable[[Any], Any], given: Any) -> None:
        self.attempt(lambda run: run.on_message(topic, read(given)))

    def _on_death_notice(self, notice: NodeStatus) -> None:
        """A supervisor reports the death of a node, possibly of this one."""
        if self.run is not None and notice.run_id == self.run.run_id:
            self.run.steps.fail(InfraKind.DIED, notice.node, notice.detail)

    def _on_second_publisher(self, topic: Topic) -> None:
        run = self.run
        if run is not None and run.steps.started and run.steps.ending is None:
            found = domain.brief_intruder(self, topic, run.participants)
            run.steps.fail(InfraKind.INTRUDER, *found)

    def _watch(self) -> None:
        self.attempt(lambda run: run.goal.publish_feedback(run.feedback()))
        self.attempt(lambda run: run.steps.watch())


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros simulator``."""
    run_node(_alone, usage=USAGE)


def _alone() -> Simulator:
    domain.require_free_domain()
    return Simulator()


if __name__ == '__main__':
    main()
