"""A node that has no part in a run and publishes in it: the run has no verdict, and names it."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import TransformStamped
from graph_runs import request, run, steps_in
from rclpy.action import ActionServer
from rclpy.context import Context
from rclpy.node import Node
from tampering import tamper
from tf2_msgs.msg import TFMessage
from waiting import wait_for

from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.messages.convert import death_notice
from taxinet_ros.nodes.running.leave import leave_graph

pytestmark = pytest.mark.ros

PEER = 'somebody_else'
STEP = 9


@contextlib.contextmanager
def peer(graph: Any, name: str = PEER) -> Iterator[Node]:
    """A node of another participant on the graph's domain, as another process has."""
    context = Context()
    rclpy.init(context=context, domain_id=graph.domain)
    node = Node(name, context=context)
    try:
        yield node
    finally:
        leave_graph(node)
        rclpy.try_shutdown(context=context)


def node_of(graph: Any, name: str) -> Any:
    return next(node for node in graph.nodes if node.get_name() == name)


def amid_the_run(graph: Any, act: Callable[[], object]) -> list[object]:
    """Have something done at a step, which waits for it; what came of it."""
    done: list[object] = []

    def how(step: int, message: Any) -> list[Any]:
        if step == STEP and not done:
            done.append(act())
        return [message]

    tamper(graph, interface.COMMAND, how)
    return done


def ears(graph: Any, topic: Topic) -> list[Any]:
    """The subscriptions of the graph's nodes to a topic."""
    name = '/' + topic.name.lstrip('/')
    return [one for node in graph.nodes for one in node.subscriptions if one.topic_name == name]


def speak(graph: Any, node: Node, topic: Topic) -> Any:
    """Publish one message on a topic, once everybody in the graph hears it."""
    heard = ears(graph, topic)
    before = [one.get_publisher_count() for one in heard]
    publisher = node.create_publisher(topic.type, topic.name, topic.qos)
    wait_for(lambda: publisher.get_subscription_count() >= len(heard) and all(
        one.get_publisher_count() > count for one, count in zip(heard, before, strict=True)
    ))
    publisher.publish(topic.type())
    return publisher


def disturbed(out: Path, act: Callable[[Any], object], **changes: Any) -> RunResult:
    """A run of ten minutes in which somebody does something at a step."""
    options = GraphOptions(perception='truth', out=out, images='none', **changes)
    with composed_graph(options) as graph:
        done = amid_the_run(graph, functools.partial(act, graph))
        (result,) = run(graph, request())
    assert done
    return result


def assert_bag_has_no_verdict(bag: Path, who: str) -> None:
    """It is closed, says who broke the run, and holds what was recorded before."""
    assert read_info(bag).complete
    facts = open_recording(bag).facts
    assert facts is not None
    assert (facts.outcome, facts.who) == (Outcome.INFRA_ERROR, who)
    steps = steps_in(bag)
    assert steps == list(range(len(steps)))
    assert len(steps) >= STEP


@pytest.mark.parametrize(
    'topic', [interface.CLOCK, interface.ESTIMATE, interface.VERDICT],
    ids=lambda topic: topic.name.replace('/', '-'),
)
def test_f4_given_a_peer_that_speaks_amid_a_run_then_it_ends_without_a_verdict_and_names_him(
    topic, tmp_path
):
    with contextlib.ExitStack() as stack:
        result = disturbed(
            tmp_path, lambda graph: speak(graph, stack.enter_context(peer(graph)), topic)
        )
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    assert result.who == PEER
    assert topic.name in result.detail
    assert result.rho == {}
    assert_bag_has_no_verdict(tmp_path / 'run', PEER)


@pytest.mark.parametrize(
    'topic', [interface.ODOMETRY, interface.ESTIMATE, interface.VERDICT],
    ids=lambda topic: topic.name.replace('/', '-'),
)
def test_f4_a_publisher_that_is_gone_at_the_next_check_ends_the_run_too(topic, tmp_path):
    def speak_and_leave(graph: Any) -> None:
        with peer(graph) as node:
            node.destroy_publisher(speak(graph, node, topic))
        wait_for(lambda: graph.nodes[0].count_publishers(topic.name) == 1)

    result = disturbed(tmp_path, speak_and_leave)
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    assert result.detail == f'a second publisher of {topic.name} came and left'
    assert_bag_has_no_verdict(tmp_path / 'run', result.who)


@pytest.mark.parametrize('name', [PEER, interface.PERCEPTION])
def test_f4_given_a_second_publisher_from_the_start_then_no_run_begins_and_it_is_named(
    name, tmp_path
):
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none', timeouts={'ready_timeout': 1.0},
    )
    with composed_graph(options) as graph, peer(graph, name) as node:
        publisher = speak(graph, node, interface.ESTIMATE)
        (result,) = run(graph, request(duration=1.0))
        node.destroy_publisher(publisher)
        (after,) = run(graph, request('after', duration=1.0))
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    assert (result.who, result.rho) == (name, {})
    assert steps_in(tmp_path / 'run') == []
    assert after.outcome.judged, 'he is gone, and is held against nobody'


def test_f4_given_onlookers_and_others_who_speak_of_frames_then_not_a_byte_changes(tmp_path):
    """The topics of tf2 are everybody's."""
    def look_on(graph: Any) -> None:
        for _ in range(2):
            with peer(graph) as node:
                for topic in (*interface.TOPICS, *interface.TRANSFORMS):
                    node.create_subscription(topic.type, topic.name, lambda _: None, topic.qos)
                lie = TransformStamped(child_frame_id=interface.BASE_FRAME)
                lie.header.frame_id = interface.MAP_FRAME
                for topic in interface.TRANSFORMS:
                    publisher = node.create_publisher(topic.type, topic.name, topic.qos)
                    publisher.publish(TFMessage(transforms=[lie]))
                wait_for(lambda: node.count_publishers('run_status') == 1)

    bags = []
    for folder, act in ((tmp_path / 'alone', lambda _: None), (tmp_path / 'seen', look_on)):
        with composed_graph(GraphOptions(perception='truth', out=folder, images='none')) as graph:
            amid_the_run(graph, functools.partial(act, graph))
            (result,) = run(graph, request(duration=2.0))
        assert result.outcome.judged, result
        bags.append((folder / 'run' / 'run_0.mcap').read_bytes())
    assert bags[0] == bags[1]


def test_f4_given_a_peer_that_is_noticed_only_at_the_end_then_the_verdict_is_withheld(tmp_path):
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    with composed_graph(options) as graph, contextlib.ExitStack() as stack:
        came = amid_the_run(
            graph, lambda: speak(graph, stack.enter_context(peer(graph)), interface.PROGRESS)
        )
        (result,) = run(graph, request(duration=5.0))
    assert came
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder')
    assert result.who == PEER
    facts = open_recording(tmp_path / 'run').facts
    assert facts.outcome == Outcome.INFRA_ERROR
    assert steps_in(tmp_path / 'run') == list(range(51))


@pytest.mark.parametrize('who', [interface.SIMULATOR, interface.PERCEPTION])
def test_f4_given_an_obituary_then_the_run_has_no_verdict(who, tmp_path):
    def report_death(graph: Any) -> Any:
        node = stack.enter_context(peer(graph))
        topic = interface.OBITUARY
        publisher = node.create_publisher(topic.type, topic.name, topic.qos)
        wait_for(lambda: publisher.get_subscription_count() == 2)
        publisher.publish(death_notice('run', who, 'said so'))

    with contextlib.ExitStack() as stack:
        result = disturbed(tmp_path, report_death)
    assert (result.outcome, result.kind, result.who) == (Outcome.INFRA_ERROR, 'died', who)
    assert_bag_has_no_verdict(tmp_path / 'run', who)


def test_f4_given_a_second_simulator_then_its_answers_are_no_results(tmp_path):
    """He who answers for the simulator would decide what the table says."""
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none', patience={'server_timeout': 1.0},
    )
    kind, name = interface.RUN_SCENARIO_TYPE, interface.RUN_SCENARIO
    with composed_graph(options) as graph, contextlib.ExitStack() as stack:
        def serve() -> bool:
            node = stack.enter_context(peer(graph))
            server = ActionServer(node, kind, name, lambda goal: kind.Result())
            stack.callback(server.destroy)
            scenario = interface.SCENARIO
            node.create_publisher(scenario.type, scenario.name, scenario.qos)
            looker = node_of(graph, interface.SIMULATOR)
            wait_for(lambda: PEER in {
                end.node_name for end in looker.get_publishers_info_by_topic(scenario.name)
            })
            return True

        came = amid_the_run(graph, serve)
        amid, after = run(graph, request(duration=2.0), request('after', duration=2.0))
    assert came
    assert [result.outcome for result in (amid, after)] == [Outcome.INFRA_ERROR] * 2
    assert [(result.kind, result.who) for result in (amid, after)] == [('intruder', PEER)] * 2
    assert read_info(tmp_path / 'run').complete
    assert not (tmp_path / 'after').exists()
