"""Remaps that part a node from its graph: it is named, with the topic that it lacks.

ROS takes any remap without a word, and the node then listens where nobody speaks.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from graph_runs import request, run
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter
from waiting import PATIENT_S, wait_for

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import InfraKind
from taxinet_ros.nodes.graph.runner import GraphOptions, SampledGraph
from taxinet_ros.nodes.interface import (
    PARTICIPANTS,
    PERCEPTION,
    SIMULATOR,
    STEERING_CONTROLLER,
)
from taxinet_ros.nodes.running.domain import missing_nodes, own_domain
from taxinet_ros.nodes.running.executor import NodeExecutor

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

AWAY = '/elsewhere/x'


@contextlib.contextmanager
def remapped_graph(
    out: Path, remaps: dict[str, list[str]], **timeouts: float
) -> Iterator[tuple[SampledGraph, dict[str, Any]]]:
    """A graph with rules (FROM:=TO) for some of its nodes, and its nodes by name."""
    options = GraphOptions(
        perception='truth', out=out, images='none',
        timeouts={'ready_timeout': PATIENT_S, **timeouts},
    )
    nodes = {}
    with own_domain() as domain, NodeExecutor(domain, EventsExecutor) as spinning:
        for name, (kind, parameters) in options.nodes().items():
            words = [part for rule in remaps.get(name, ()) for part in ('-r', rule)]
            nodes[name] = kind(
                context=spinning.context, cli_args=['--ros-args', *words] if words else None,
                parameter_overrides=[Parameter(key, value=v) for key, v in parameters.items()],
            )
            spinning.add(nodes[name])
        yield SampledGraph(spinning, {'server_timeout': PATIENT_S}, ()), nodes


@pytest.mark.parametrize(('who', 'topic', 'detail'), [
    (PERCEPTION, 'ground_truth/tracking_error',
     'does not subscribe to camera/image_raw or ground_truth/tracking_error'),
    (STEERING_CONTROLLER, 'taxi_command', 'does not publish taxi_command'),
])
def test_given_a_node_whose_remap_parts_it_then_it_is_named_with_the_topic_that_it_lacks(
    who, topic, detail, tmp_path
):
    with remapped_graph(tmp_path, {who: [f'{topic}:={AWAY}']}, ready_timeout=2.0) as (graph, _):
        (result,) = run(graph, request(duration=1.0))
    assert (result.outcome, result.kind, result.who) == (
        Outcome.INFRA_ERROR, InfraKind.NOT_READY, who
    )
    assert result.detail == f'not ready within 2 s: {detail}'


@pytest.mark.parametrize('rules', [
    ['camera/image_raw:=/wing/image', 'taxi_command:=/vehicle/command', 'scenario:=/test/scenario',
     'perception/tracking_error:=/estimate'],
    ['__ns:=/left', '/clock:=clock'],
], ids=['topics', 'namespace'])
def test_given_remaps_that_all_nodes_share_then_they_find_each_other_and_nothing_is_said(
    rules, tmp_path
):
    every = (SIMULATOR, *PARTICIPANTS)
    with remapped_graph(tmp_path, dict.fromkeys(every, rules)) as (graph, nodes):
        wait_for(lambda: not any(missing_nodes(node, PARTICIPANTS) for node in nodes.values()))
        if '__ns:=/left' not in rules:  # where the sampler of the test is not
            (result,) = run(graph, request(duration=1.0))
            assert result.outcome.judged
