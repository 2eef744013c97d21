"""The example that bridges perception messages of others, in the real graph; bad covariances."""

from __future__ import annotations

import math
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from graph_runs import judged_in, request, run_in
from others_perception import BOTH, SIGMA_M, SIGMA_RAD

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.run.message_values import error_of
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.topics import ESTIMATE
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.types import UNKNOWN_COVARIANCE
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph

pytestmark = pytest.mark.ros

BRIDGE = Path(__file__).parents[2] / 'examples' / 'perception_bridge.py'
THEIRS = Path(__file__).parent / 'others_perception.py'
SCENE = scenario_from_human({'cross_track': 1.0, 'heading': 5, 'distance': 700, 'duration': 3})


def graph(out: Path, *words: str):
    theirs = shlex.join([sys.executable, str(THEIRS), *words])
    ours = shlex.join([sys.executable, str(BRIDGE)])
    both = shlex.join(['sh', '-c', f'{theirs} & exec {ours} "$@"', 'bridge'])
    return composed_graph(GraphOptions(perception=f'cmd:{both}', out=out, images='none'))


def test_given_poses_with_covariance_then_a_run_is_judged_and_says_what_they_claim(tmp_path):
    (result,) = judged_in(graph(tmp_path, 'pose'), request(scenario=SCENE))
    recording = open_recording(tmp_path / 'run')
    estimates = [error_of(message) for _, _, message in recording.messages((ESTIMATE,))]
    assert len(estimates) == 31
    claimed = (SIGMA_M**2, BOTH, BOTH, SIGMA_RAD**2)
    assert {estimate.covariance for estimate in estimates} == {claimed}
    trace = recording.columns
    off_m = np.abs(np.asarray(trace['est_cte_m']) - np.asarray(trace['cte_m']))
    assert off_m.max() == pytest.approx(0.8)
    assert set(np.asarray(trace['est_cte_sigma_m'])) == {SIGMA_M}
    statistics = result.statistics
    assert statistics.cte_error.sigma_max == SIGMA_M
    assert statistics.cte_error.within_1_sigma == pytest.approx(23 / 31), 'not every fourth'
    assert statistics.cte_error.within_2_sigma == 1.0
    assert statistics.he_error.sigma_max == SIGMA_RAD
    assert statistics.he_error.within_1_sigma == 1.0
    assert not check_bag(tmp_path / 'run').findings


def test_given_lines_then_a_run_is_judged_and_nothing_is_claimed(tmp_path):
    (result,) = judged_in(graph(tmp_path, 'line'), request(scenario=SCENE))
    recording = open_recording(tmp_path / 'run')
    estimates = [error_of(message) for _, _, message in recording.messages((ESTIMATE,))]
    assert {estimate.covariance for estimate in estimates} == {UNKNOWN_COVARIANCE}
    assert result.statistics.unusable_estimates == 0
    assert result.statistics.cte_error.max_abs < 1e-4
    assert result.statistics.he_error.max_abs < 1e-4
    assert math.isnan(result.statistics.cte_error.sigma_max)
    assert 'est_cte_sigma_m' not in recording.columns


def test_given_a_covariance_that_is_none_then_the_run_ends_with_its_name(tmp_path):
    (result,) = run_in(graph(tmp_path, 'pose', 'wrong'), request(scenario=SCENE))
    assert (result.kind, result.who) == ('protocol', 'perception')
    assert result.detail == \
        'estimated a covariance [0.25, 0.004, 0.004, -1]: a variance is negative'
