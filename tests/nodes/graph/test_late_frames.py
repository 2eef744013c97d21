"""``images``: with failures a failed run's bag has the bytes of one recorded with all frames."""

from pathlib import Path

import pytest
from graph_runs import files, request, run_in

from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.rewrite.frames import IMAGE, restore_frames
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.steering_controller import SteeringController

pytestmark = pytest.mark.ros

STEPS = 11


def requests() -> list[RunRequest]:
    """A run that fails and one that passes."""
    values = {'cross_track': 4.0, 'heading': 9, 'time_of_day': 16.5, 'clouds': 'broken', 'rain': 40}
    scenario = scenario_from_human({**values, 'duration': 1})
    return [
        request(spec, scenario=scenario, judging=Judging(specs=(spec,)))
        for spec in ('phi_always', 'on_runway')
    ]


def run_graph(out: Path, images: str, asked: list[RunRequest]) -> list[RunResult]:
    return run_in(composed_graph(GraphOptions(perception='truth', out=out, images=images)), *asked)


def test_given_a_failed_run_then_its_bag_is_that_of_all_frames_to_the_byte(tmp_path):
    for images in ('all', 'failures', 'none'):
        results = run_graph(tmp_path / images, images, requests())
        assert [result.outcome for result in results] == [Outcome.FAIL, Outcome.PASS]
    bags = {
        images: [files(tmp_path / images / asked.run_id) for asked in requests()]
        for images in ('all', 'failures', 'none')
    }
    assert read_info(tmp_path / 'all' / 'phi_always').counts[IMAGE] == STEPS
    assert bags['failures'][0] == bags['all'][0], 'the failed run'
    assert bags['failures'][1] == bags['none'][1], 'the passed run'
    assert bags['none'][1] != bags['all'][1]
    for asked, expected in zip(requests(), bags['all'], strict=True):
        rendered = tmp_path / 'rendered' / asked.run_id
        list(restore_frames(open_recording(tmp_path / 'none' / asked.run_id), rendered))
        assert files(rendered) == expected


def test_given_a_run_that_breaks_then_it_keeps_frames_and_reason(tmp_path, monkeypatch):
    answer = SteeringController._answer

    def broken(self, estimate):
        if estimate.seq == 6:
            raise RuntimeError('out of order')
        answer(self, estimate)

    monkeypatch.setattr(SteeringController, '_answer', broken)
    (result,) = run_graph(tmp_path, 'failures', requests()[:1])
    assert (result.outcome, result.who) == (Outcome.INFRA_ERROR, 'steering_controller')
    assert 'out of order' in result.detail
    info = read_info(tmp_path / 'phi_always')
    assert info.complete
    assert info.counts[IMAGE] == info.counts['/camera/camera_info'] == 7


def test_given_frames_that_cannot_be_had_then_the_run_has_no_verdict(tmp_path, monkeypatch):
    def unlike(path, seq, before, now):
        raise RuntimeError('elsewhere')

    monkeypatch.setattr('taxinet_ros.bag.run.resimulation.check_state', unlike)
    results = run_graph(tmp_path, 'failures', requests())
    assert [result.outcome for result in results] == [Outcome.INFRA_ERROR, Outcome.PASS]
    assert (results[0].who, 'elsewhere' in results[0].detail) == ('recorder', True)
    assert read_info(tmp_path / 'phi_always').complete
