"""What several tests of nodes look at: one short recorded run."""

from __future__ import annotations

from pathlib import Path

import pytest
from graph_runs import judged_in, request

from taxinet_ros.bag.reader import read_info
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph

STEPS = 21


@pytest.fixture(scope='session')
def short_request() -> RunRequest:
    """A run of two seconds."""
    scene = scenario_from_human({
        'cross_track': 3.0, 'heading': 5, 'distance': 600, 'time_of_day': 10, 'duration': 2,
    })
    return request('played', scenario=scene, seed=1)


@pytest.fixture(scope='session')
def bag(tmp_path_factory, short_request) -> Path:
    """Its bag, camera frames included."""
    out = tmp_path_factory.mktemp('played')
    judged_in(composed_graph(GraphOptions(perception='taxinet', out=out)), short_request)
    assert read_info(out / 'played').counts['/camera/image_raw'] == STEPS
    return out / 'played'
