"""What a supervisor tells of runs, and what it tells them."""

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
        self.silent: list[str] = []
        self.watch = RunWatch(self.node, self.lines.append, self.silent.append)
        self._executor = spinning.executor
        runs = interface.RUN_STATUS
        self._publisher = self.others.create_publisher(runs.type, runs.name, runs.qos)
        topic = interface.OBITUARY
        self.others.create_subscription(topic.type, topic.name, self._on_death_notice, topic.qos)
        for node in (self.node, self.others):
            spinning.add(node)
        self.until(lambda: self._publisher.get_subscription_count()
                   and self.node.count_subscribers(topic.name) == 2)

    def _on_death_notice(self, notice: NodeStatus) -> None:
        self.mourned.append((notice.run_id, notice.node, notice.detail))

    def say(self, status: RunStatus) -> None:
        self._publisher.publish(status)

    def until(self, condition: Any) -> None:
        while not condition():
            self._executor.spin_once(timeout_sec=0.1)


@pytest.fixture
def stage():
    with on_own_domain(SingleThreadedExecutor) as spinning:
        yield Stage(spinning)


RUNNING = RunStatus(run_id='one', state=RunStatus.RUNNING)


def test_given_a_death_amid_a_run_then_the_run_is_told_of_it_and_of_none_before(stage):
    stage.watch.report_death(interface.PERCEPTION, 'killed before')
    stage.say(RUNNING)
    stage.until(lambda: stage.watch.run_id == 'one')
    stage.watch.report_death(interface.PERCEPTION, 'killed')
    stage.until(lambda: stage.mourned)
    assert stage.mourned == [('one', interface.PERCEPTION, 'killed')]
    assert stage.watch.run_id == 'one', 'its simulator ends it'


def test_given_a_simulator_that_dies_amid_a_run_then_the_run_is_over(stage):
    stage.say(RUNNING)
    stage.until(lambda: stage.watch.running)
    stage.watch.report_death(interface.SIMULATOR, 'killed')
    stage.until(lambda: stage.mourned and stage.lines)
    assert stage.mourned == [('one', interface.SIMULATOR, 'killed')]
    assert stage.lines == ['run one: INFRA_ERROR died simulator killed']
    assert (stage.watch.run_id, stage.watch.running, stage.watch.asked) == ('', False, False)


def test_given_a_node_whose_silence_ends_a_run_then_it_is_named(stage):
    for status in (RUNNING, RunStatus(
        run_id='one', state=RunStatus.ENDED, outcome='INFRA_ERROR', kind='timeout',
        who=interface.PERCEPTION, detail='silent for 10 s',
    )):
        stage.say(status)
    stage.until(lambda: stage.silent)
    assert stage.silent == [interface.PERCEPTION]
    assert stage.lines == ['run one: INFRA_ERROR timeout perception silent for 10 s']


def test_a_replay_of_every_status_of_a_run_is_not_taken_for_a_run(stage):
    player = Node('bag_player', context=stage.node.context)
    stage._executor.add_node(player)
    topic = interface.RUN_STATUS
    publisher = player.create_publisher(topic.type, topic.name, topic.qos)
    for message in (RUNNING, RunStatus(run_id='one', state=RunStatus.ENDED, outcome='PASS')):
        publisher.publish(message)
    stage.until(lambda: stage.node.count_publishers(topic.name) == 2)
    heard = []
    stage.others.create_subscription(RunStatus, topic.name, heard.append, topic.qos)
    stage.until(lambda: len(heard) == 2)
    player.destroy_node()
    stage.until(lambda: stage.node.count_publishers(topic.name) == 1)
    stage.say(RunStatus(run_id='two', state=RunStatus.RUNNING))
    stage.until(lambda: stage.watch.run_id == 'two')
    assert stage.lines == []
