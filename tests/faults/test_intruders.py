"""Who has no part in a run and speaks in it: the run has no verdict, and names him."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from fault_runs import once, request, run, steps_in
from rclpy.context import Context
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from taxinet_msgs.msg import NodeStatus, RunStatus, TaxiCommand, TrackingError, Verdict
from waiting import wait_for

from taxinet_ros.bag.facts import read_facts
from taxinet_ros.bag.reader import read_info
from taxinet_ros.core.outcome import Outcome, RunResult
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.convert import time_of
from taxinet_ros.nodes.graph import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import RECORDER, Topic

pytestmark = pytest.mark.ros

PEER = 'somebody_else'


@contextlib.contextmanager
def peer(graph: Any, name: str = PEER) -> Iterator[Node]:
    """A node of another participant on the graph's domain, as another process has."""
    context = Context()
    rclpy.init(context=context, domain_id=graph.domain)
    node = Node(name, context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def node_of(graph: Any, name: str) -> Any:
    return next(node for node in graph.nodes if node.get_name() == name)


def steps_written(graph: Any, count: int) -> Callable[[], bool]:
    recorder = node_of(graph, RECORDER)
    return lambda: getattr(recorder, '_written', 0) >= count


def forged(topic: Topic, run_id: str = 'run') -> Any:
    """What somebody might say to have it his way."""
    return {
        interface.RUN_STATUS.name: RunStatus(
            run_id=run_id, state=RunStatus.ENDED, outcome='PASS', seq=3),
        interface.ESTIMATE.name: TrackingError(run_id=run_id, cross_track_error=9.0, valid=True),
        interface.COMMAND.name: TaxiCommand(run_id=run_id, steering_angle=0.5, speed=9.0),
        interface.TRUTH.name: TrackingError(run_id=run_id, valid=True),
        interface.CLOCK.name: Clock(clock=time_of(0)),
        interface.NODE_STATUS.name: NodeStatus(
            run_id=run_id, node=RECORDER, state=NodeStatus.DONE, detail='PASS', seq=3),
        interface.VERDICT.name: Verdict(run_id=run_id, complete=True, satisfied=True),
    }.get(topic.name, topic.type())


def speak(node: Node, topic: Topic, listeners: int = 1) -> Any:
    """Publish one forged message on a topic, as soon as somebody hears it."""
    publisher = node.create_publisher(topic.type, topic.name, topic.qos)
    wait_for(lambda: publisher.get_subscription_count() >= listeners)
    publisher.publish(forged(topic))
    return publisher


def disturbed(out: Path, act: Callable[[Any], object], **changes: Any) -> RunResult:
    """A run of ten minutes in which somebody does something after five steps."""
    options = GraphOptions(perception='truth', out=out, images='none', **changes)
    with composed_graph(options) as graph, once(steps_written(graph, 5), lambda: act(graph)):
        (result,) = run(graph, request())
    return result


def assert_bag_has_no_verdict(bag: Path, who: str) -> None:
    """It is closed, says who broke the run, and holds what was recorded before."""
    assert read_info(bag).complete
    facts = read_facts(bag)
    assert facts.outcome == Outcome.INFRA_ERROR, facts
    steps = steps_in(bag)
    assert steps == list(range(len(steps)))
    assert len(steps) >= 5


@pytest.mark.parametrize('topic', [
    topic for topic in interface.TOPICS if topic is not interface.IMAGE
], ids=lambda topic: topic.name.replace('/', '-'))
def test_f4_given_a_peer_that_speaks_amid_a_run_then_it_ends_without_a_verdict_and_names_him(
    topic, tmp_path
):
    with contextlib.ExitStack() as stack:
        result = disturbed(
            tmp_path, lambda graph: speak(stack.enter_context(peer(graph)), topic)
        )
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    assert result.who == PEER
    assert topic.name in result.detail
    assert result.rho == {}
    assert_bag_has_no_verdict(tmp_path / 'run', PEER)
