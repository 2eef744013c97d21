"""Latency on the real graph: what the bag shows, and that every layout gives the same bytes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from graph_runs import files, judged_in

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.motion.aircraft import TAXI_SPEED_MPS, Aircraft
from taxinet_ros.core.motion.controller import SteeringGains, steer
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.pacing.timing import parse_latency
from taxinet_ros.core.perception.perception import GroundTruth
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph, process_graph

pytestmark = pytest.mark.ros

DRAWN = 'perception=normal(0.25,0.1) controller=uniform(0,0.1)'


def run(opened, asked: RunRequest) -> RunResult:
    (result,) = judged_in(opened, asked)
    return result


def graph_of(out: Path, latency: str, **more) -> GraphOptions:
    timing = parse_latency([latency])
    return GraphOptions(perception='truth', out=out, images='none', timing=timing, **more)


def test_r5_given_0_3_s_then_the_aircraft_follows_estimates_exactly_three_steps_old(
    tmp_path, short_request
):
    result = run(composed_graph(graph_of(tmp_path, 'perception=0.3')), short_request)
    bag = tmp_path / short_request.run_id
    trace = open_recording(bag).columns
    assert len(trace['seq']) == 21
    # The estimates are the truth of their own frames; what is late is their effect.
    assert trace['est_cte_m'].tobytes() == trace['cte_m'].tobytes()
    # By the aircraft and the steering law alone: no estimate for 3 steps, then that of 3 ago.
    aircraft = Aircraft(short_request.scenario)
    for seq in range(20):
        assert aircraft.state.tracking_error.cte_m == trace['cte_m'][seq], seq
        assert aircraft.state.tracking_error.he_rad == trace['he_rad'][seq], seq
        command = TaxiCommand(steering_rad=0.0, speed_mps=TAXI_SPEED_MPS)
        if seq >= 3:
            seen = TrackingError(
                cte_m=float(trace['est_cte_m'][seq - 3]), he_rad=float(trace['est_he_rad'][seq - 3])
            )
            command = steer(seen, SteeringGains())
        aircraft.advance(command)
    assert abs(trace['cte_m'][-1] - trace['cte_m'][0]) > 0.1, 'the aircraft did not move'
    assert result.timing == open_recording(bag).run.timing.words == 'latency perception=0.3'
    # Compares every state with the bag's, to the bit.
    assert len(list(open_recording(bag).observations())) == 21


def test_r5_given_drawn_latencies_then_loop_processes_and_composed_graph_agree_to_the_bit(
    tmp_path, short_request
):
    one = run(composed_graph(graph_of(tmp_path / 'one', DRAWN)), short_request)
    run(process_graph(graph_of(tmp_path / 'many', DRAWN), tmp_path / 'logs'), short_request)
    bags = [tmp_path / name / short_request.run_id for name in ('one', 'many')]
    assert files(bags[0]) == files(bags[1])
    judged = run_closed_loop(
        short_request.scenario, GroundTruth(), specs=[parse_spec('phi_always')],
        timing=parse_latency([DRAWN]), draws=(short_request.seed, short_request.index),
    )
    assert list(one.rho.values()) == [reading.lower for reading in judged.readings]
    assert one.statistics.max_cross_track_m == judged.statistics.max_cross_track_m
    assert one.statistics.cte_error == judged.statistics.cte_error
    other = dataclasses.replace(short_request, index=5, run_id='other')
    run(composed_graph(graph_of(tmp_path / 'five', DRAWN)), other)
    paths = [
        open_recording(bag).columns['cte_m'].tolist()
        for bag in (bags[0], tmp_path / 'five' / 'other')
    ]
    assert paths[0] != paths[1], 'another run of the campaign has the same draws'


def test_r5_given_no_latency_or_0_s_then_the_bag_has_the_bytes_of_always(tmp_path, short_request):
    """The simulator reports nothing of itself then, so bags are what they were before."""
    for name, latency in (('none', ''), ('zero', 'perception=0')):
        result = run(composed_graph(graph_of(tmp_path / name, latency)), short_request)
        assert result.timing == ''
    bags = [tmp_path / name / short_request.run_id for name in ('none', 'zero')]
    assert files(bags[0]) == files(bags[1])
    counts = read_info(bags[0]).counts
    assert counts['/node_status'] == len(short_request.participants)


def test_r5_given_a_bag_with_latency_then_the_doctor_finds_it_whole(tmp_path, short_request):
    run(composed_graph(graph_of(tmp_path, DRAWN)), short_request)
    found = check_bag(tmp_path / short_request.run_id)
    assert found.findings == ()
