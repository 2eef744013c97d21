"""What a supervisor tells of deaths, in whatever order it hears of runs and deaths."""

from __future__ import annotations

from typing import Any

import pytest
from graph_runs import on_own_domain
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from taxinet_msgs.msg import NodeStatus, RunStatus

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.supervisor import RunWatch
from taxinet_ros.nodes.running.executor import NodeExecutor


class Stage:
    """A watch that hears of runs only when it is told to listen."""

    def __init__(self, spinning: NodeExecutor) -> None:
        names = 'watch', interface.SIMULATOR
        self.node, self.others = (Node(name, context=spinning.context) for name in names)
        self.lines: list[str] = []
        self.mourned: list[tuple[str, str, str]] = []
        self.watch = RunWatch(self.node, self.lines.append)
        self._executor = spinning.executor
        self._publishers: dict[type, Any] = {}
        for topic in (interface.RUN_STATUS, interface.NODE_STATUS):
            publisher = self.others.create_publisher(topic.type, topic.name, topic.qos)
            self._publishers[topic.type] = publisher
        topic = interface.OBITUARY
        self.others.create_subscription(topic.type, topic.name, self._on_death_notice, topic.qos)
        for node in (self.node, self.others):
            spinning.add(node)
        self.until(lambda: all(p.get_subscription_count() for p in self._publishers.values())
                   and self.node.count_subscribers(topic.name) == 2)

    def _on_death_notice(self, notice: NodeStatus) -> None:
        self.mourned.append((notice.run_id, notice.node, notice.detail))

    def say(self, message: Any) -> None:
        self._publishers[type(message)].publish(message)

    def start_again(self) -> None:
        """A new end of the simulator joins the graph."""
        topic = interface.RUN_STATUS
        self._publishers[RunStatus] = self.others.create_publisher(
            topic.type, topic.name, topic.qos)
        self.until(lambda: self.node.count_publishers(topic.name) == 2)

    def until(self, condition: Any) -> None:
        while not condition():
            self._executor.spin_once(timeout_sec=0.1)


@pytest.fixture
def stage():
    with on_own_domain(SingleThreadedExecutor) as spinning:
        yield Stage(spinning)


RUNNING = RunStatus(run_id='one', state=RunStatus.RUNNING)
READY = NodeStatus(run_id='one', state=NodeStatus.READY, node=interface.STEERING_CONTROLLER)


@pytest.mark.parametrize(('heard_by', 'who'), [
    (RUNNING, interface.SIMULATOR), (READY, interface.SIMULATOR), (RUNNING, interface.PERCEPTION),
], ids=['run, simulator', 'one who is ready, simulator', 'run, perception'])
def test_given_a_death_before_its_run_was_heard_of_then_the_run_is_told_of_it(
    stage, heard_by, who
):
    stage.say(heard_by)
    stage.watch.report_death(who, 'killed')
    assert stage.watch.run_id == '', 'nothing was listened to yet'
    stage.until(lambda: stage.mourned)
    assert stage.mourned == [('one', who, 'killed')]
    if who == interface.SIMULATOR:
        stage.until(lambda: stage.lines)
        assert stage.lines == ['run one: INFRA_ERROR died simulator killed']
        assert (stage.watch.run_id, stage.watch.last_run) == ('', 'one')


def test_given_a_run_that_gets_ready_after_the_death_of_a_participant_then_it_waits_for_the_next(
    stage
):
    stage.watch.report_death(interface.PERCEPTION, 'killed')
    stage.say(RunStatus(run_id='two', state=RunStatus.PREPARING))
    stage.until(lambda: stage.watch.run_id == 'two')
    stage.watch.report_death(interface.STEERING_CONTROLLER, 'killed as well')
    stage.until(lambda: stage.mourned)
    assert stage.mourned == [('two', interface.STEERING_CONTROLLER, 'killed as well')]


def test_given_a_run_of_the_simulator_started_again_then_it_is_told_of_no_death(stage):
    stage.watch.report_death(interface.SIMULATOR, 'killed')
    stage.start_again()
    stage.say(RunStatus(run_id='two', state=RunStatus.RUNNING))
    stage.until(lambda: stage.watch.run_id == 'two')
    stage.watch.report_death(interface.PERCEPTION, 'killed as well')
    stage.until(lambda: stage.mourned)
    assert stage.mourned == [('two', interface.PERCEPTION, 'killed as well')]


def test_a_replay_of_every_status_of_a_run_is_not_taken_for_a_run(stage):
    player = Node('bag_player', context=stage.node.context)
    stage._executor.add_node(player)
    publishers = [
        player.create_publisher(topic.type, topic.name, topic.qos)
        for topic in (interface.NODE_STATUS, interface.RUN_STATUS)
    ]
    ended = RunStatus(run_id='one', state=RunStatus.ENDED, outcome='PASS')
    for message in (READY, RUNNING, ended):
        publishers[isinstance(message, RunStatus)].publish(message)
    topic = interface.RUN_STATUS.name
    stage.until(lambda: stage.node.count_publishers(topic) == 2)
    heard = []
    stage.others.create_subscription(RunStatus, topic, heard.append, interface.RUN_STATUS.qos)
    stage.until(lambda: len(heard) == 2)
    player.destroy_node()
    stage.until(lambda: stage.node.count_publishers(topic) == 1)
    stage.say(RunStatus(run_id='two', state=RunStatus.RUNNING))
    stage.until(lambda: stage.watch.run_id == 'two')
    assert (stage.lines, stage.watch.last_run) == ([], '')
