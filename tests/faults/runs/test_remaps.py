"""Remaps that part a node from its graph: who is parted from what is told, not only that it waits.

ROS takes any remap without a word, and the node then listens where nobody speaks.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fault_runs import once, request, run
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter
from tampering import changed, tamper
from waiting import PATIENT_S, wait_for

from taxinet_ros.core.pacing.timing import AT_ONCE, Timing, free_timing
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import InfraKind
from taxinet_ros.nodes.graph.runner import GraphOptions, SampledGraph
from taxinet_ros.nodes.interface import (
    COMMAND,
    MTL_MONITOR,
    PARTICIPANTS,
    PERCEPTION,
    RECORDER,
    SIMULATOR,
    STEERING_CONTROLLER,
)
from taxinet_ros.nodes.lockstep.endpoints import missing_nodes
from taxinet_ros.nodes.recorder import Recorder
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.executor import NodeExecutor
from taxinet_ros.nodes.running.remaps import cut_off

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

AWAY = '/elsewhere/x'


@contextlib.contextmanager
def remapped_graph(
    out: Path, remaps: dict[str, list[str]], images: str = 'none', timing: Timing = AT_ONCE,
    **timeouts: float,
) -> Iterator[tuple[SampledGraph, dict[str, Any]]]:
    """A graph with rules (FROM:=TO) for some of its nodes, and its nodes by name."""
    options = GraphOptions(
        perception='truth', out=out, images=images, timing=timing,
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


@pytest.mark.parametrize(('who', 'topic', 'blamed', 'detail'), [
    (PERCEPTION, 'ground_truth/tracking_error', PERCEPTION, 'does not subscribe to '
     f'camera/image_raw or ground_truth/tracking_error but to {AWAY}'),
    (PERCEPTION, 'perception/tracking_error', PERCEPTION,
     f'does not publish perception/tracking_error but {AWAY}'),
    (STEERING_CONTROLLER, 'perception/tracking_error', STEERING_CONTROLLER,
     f'does not subscribe to perception/tracking_error but to {AWAY}'),
    (MTL_MONITOR, 'scenario', MTL_MONITOR, f'does not subscribe to scenario but to {AWAY}'),
    (RECORDER, 'camera/image_raw', RECORDER,
     f'does not subscribe to camera/image_raw but to {AWAY}'),
    (SIMULATOR, 'scenario', SIMULATOR, f'scenario is remapped to {AWAY}, but '),
    (SIMULATOR, 'taxi_command', SIMULATOR, f'taxi_command is remapped to {AWAY}, but '
     f'{STEERING_CONTROLLER} publishes /taxi_command'),
])
def test_given_a_node_whose_remap_parts_it_then_it_is_named_with_the_topic_that_it_has_instead(
    who, topic, blamed, detail, tmp_path
):
    images = 'all' if who == RECORDER else 'none'
    with remapped_graph(tmp_path, {who: [f'{topic}:={AWAY}']}, images) as (graph, nodes):
        def why() -> str:
            at_hand = nodes[SIMULATOR]._run
            return ' '.join(nodes[SIMULATOR]._unready(at_hand)) if at_hand is not None else ''

        expected = f'{InfraKind.NOT_READY} {blamed} not ready within {PATIENT_S:g} s: {detail}'
        with once(lambda: why().startswith(expected), graph.interrupt):
            (result,) = run(graph, request(duration=1.0))
        (line,) = cut_off(nodes[who])
        assert line.startswith(f'{topic} is remapped to {AWAY}, but ')
        assert [name for name, node in nodes.items() if cut_off(node)] == [who]
    assert not result.outcome.judged


@pytest.mark.parametrize('who', [SIMULATOR, MTL_MONITOR, RECORDER])
def test_given_a_free_run_then_who_does_not_hear_of_its_timing_is_named_before_it_begins(
    who, tmp_path
):
    timing = free_timing('0')
    with remapped_graph(tmp_path, {who: [f'timing:={AWAY}']}, timing=timing) as (graph, nodes):
        simulator = nodes[SIMULATOR]
        with once(
            lambda: simulator._run is not None and simulator._unready(simulator._run)[1] == who,
            graph.interrupt,
        ):
            (result,) = run(graph, request(duration=1.0))
    assert result.outcome is Outcome.INTERRUPTED


def test_given_a_topic_taken_for_another_of_its_type_then_that_is_told_too(tmp_path):
    """A controller that is fed the truth in the place of the estimates."""
    rule = 'perception/tracking_error:=ground_truth/tracking_error'
    with remapped_graph(tmp_path, {STEERING_CONTROLLER: [rule]}) as (_, nodes):
        wait_for(lambda: cut_off(nodes[STEERING_CONTROLLER]) == [
            'perception/tracking_error is remapped to /ground_truth/tracking_error, but '
            'perception publishes /perception/tracking_error'])


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
        assert [line for node in nodes.values() for line in cut_off(node)] == []
        if '__ns:=/left' not in rules:  # where the sampler of the test is not
            (result,) = run(graph, request(duration=1.0))
            assert result.outcome.judged


def test_given_a_run_that_broke_and_a_recorder_that_hangs_then_the_first_cause_is_what_is_told(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(Recorder, '_end', lambda *_: None)
    with remapped_graph(tmp_path, {}, answer_timeout=5.0) as (graph, _nodes):
        tamper(graph, COMMAND, lambda step, message: [changed(message, speed=-1.0)])
        (result,) = run(graph, request(duration=1.0))
    assert (result.kind, result.who) == (InfraKind.PROTOCOL, STEERING_CONTROLLER), result
    assert result.detail.startswith('commanded ')
