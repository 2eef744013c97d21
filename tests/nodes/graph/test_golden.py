"""The golden runs come out as recorded: bit for bit on their stack, nearly so elsewhere."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from taxinet_ros.bag.check.compare import compare_golden, golden_bags, same_stack
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.nodes.graph.replay import rerun

pytestmark = pytest.mark.ros

GOLDEN = Path(__file__).parents[3] / 'bags' / 'golden'
NAMES = ('original-early-light', 'taxinet-broken-clouds', 'taxinet-midday', 'truth-nominal')
MOST_BYTES = 400_000


@pytest.fixture(scope='module')
def again(tmp_path_factory):
    out = tmp_path_factory.mktemp('golden')
    runs = {bag.name: open_recording(bag).run for bag in golden_bags(GOLDEN)}
    wanted = [(run, run.perception, 'steering') for run in runs.values()]
    results = rerun(wanted, out, images='none')
    return out, runs, results


def test_given_the_folder_then_it_holds_the_small_bags_that_the_tests_know():
    assert tuple(bag.name for bag in golden_bags(GOLDEN)) == NAMES
    for bag in golden_bags(GOLDEN):
        assert sum(file.stat().st_size for file in bag.iterdir()) < MOST_BYTES


@pytest.mark.parametrize('name', NAMES)
def test_given_a_golden_scene_when_run_again_then_the_bag_is_the_same(name, again):
    out, runs, results = again
    assert results[name].outcome.judged, results[name]
    found = compare_golden(
        GOLDEN / name, out / name, perception=runs[name].perception,
        to_the_bit=same_stack(GOLDEN),
    )
    assert sum(topic.counts[0] for topic in found.topics) == 1097
    assert found.equal, [str(topic) for topic in found.topics if not topic.equal]


@pytest.mark.parametrize('name', NAMES)
def test_given_a_golden_bag_then_something_happens_in_it(name, again):
    out, runs, results = again
    trace = open_recording(out / name).columns
    assert np.hypot(np.diff(trace['x_m']), np.diff(trace['y_m'])).sum() > 40
    assert results[name].outcome is (Outcome.FAIL if name == NAMES[0] else Outcome.PASS)
    errors = np.abs(trace['est_cte_m'] - trace['cte_m'])
    assert (errors.max() > 0) == (runs[name].perception != 'truth')


def test_given_a_changed_controller_then_the_check_bites(again, tmp_path):
    _, runs, _ = again
    run = dataclasses.replace(runs['truth-nominal'], gains={'heading_gain': 1.5})
    rerun([(run, 'truth', 'steering')], tmp_path, images='none')
    found = compare_golden(
        GOLDEN / 'truth-nominal', tmp_path / 'truth-nominal', perception='truth', to_the_bit=False
    )
    differing = {topic.topic: topic for topic in found.topics if not topic.equal}
    assert '/taxi_command' in differing
    assert differing['/node_status'].first.field == 'implementation'
