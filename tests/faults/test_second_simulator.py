"""A second simulator beside a graph: its runs are not recorded, its answers are not taken."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy
from fault_runs import request, run
from rclpy.action import ActionServer
from rclpy.context import Context
from rclpy.node import Node
from taxinet_msgs.action import RunScenario
from taxinet_msgs.msg import RunStatus
from waiting import wait_for

from taxinet_ros.core.outcome import Outcome
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.convert import scenario_message
from taxinet_ros.nodes.graph import GraphOptions, SampledGraph, composed_graph
from taxinet_ros.nodes.interface import RECORDER
from taxinet_ros.nodes.scenario_sampler import result_of

pytestmark = pytest.mark.ros


@pytest.fixture
def graph(tmp_path) -> Iterator[SampledGraph]:
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none', timeouts={'ready_timeout': 5.0}
    )
    with composed_graph(options) as graph:
        yield graph


@pytest.fixture
def other(graph) -> Iterator[Node]:
    context = Context()
    rclpy.init(context=context, domain_id=graph.domain)
    node = Node('simulator', context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def test_f5_given_runs_that_nobody_here_asked_for_then_they_are_not_recorded(
    graph, other, tmp_path
):
    topic = interface.SCENARIO
    publisher = other.create_publisher(topic.type, topic.name, topic.qos)
    wait_for(lambda: publisher.get_subscription_count() >= 4)
    publisher.publish(scenario_message(request('foreign')))
    (result,) = run(graph, request('asked_for'))
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    assert [folder for folder in tmp_path.iterdir() if folder.is_dir()] == []


def test_f5_given_a_second_server_then_no_answer_is_taken(graph, other):
    server = ActionServer(other, RunScenario, interface.RUN_SCENARIO, lambda goal: None)
    (recorder,) = (node for node in graph.nodes if node.get_name() == RECORDER)
    feedback = f'{interface.RUN_SCENARIO}/_action/feedback'
    wait_for(lambda: len(recorder.get_publishers_info_by_topic(feedback)) == 2)
    (result,) = run(graph, request())
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    server.destroy()


def test_f5_given_an_answer_without_an_outcome_then_it_is_an_error_of_the_bench():
    answer = RunScenario.Result(status=RunStatus(outcome='', seq=3))
    result = result_of(answer)
    assert (result.outcome, result.kind, result.who) == (
        Outcome.INFRA_ERROR, 'protocol', 'simulator'
    )
    assert result.detail == "answered '', which is no outcome"
