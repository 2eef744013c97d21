"""Timings of commands and of parts of a run, briefly."""

from __future__ import annotations

import json
import math

import campaign
import control_step
import cv2
import monitors
import pytest
import timings
from control_step import PARTS, TRANSPORT, WHOLE
from timings import measure_subjects

from taxinet_ros.samplers.registry import SAMPLERS

pytestmark = pytest.mark.nightly


@pytest.fixture(autouse=True)
def threads():
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


def test_given_every_subject_but_the_graph_when_measured_once_then_each_has_its_figures(
    monkeypatch, capsys,
) -> None:
    monkeypatch.setattr(campaign, 'WORKERS', (1,))
    monkeypatch.setattr(campaign, 'RUNS', 3)
    monkeypatch.setattr(campaign, '_SEARCH', (*campaign._SEARCH, '--set', 'duration=1'))
    for word in ('10k', '100k'):
        monkeypatch.setitem(monitors.LENGTHS, word, 1_000)
    subjects = ['start-up', 'campaign', 'physics', 'inference', 'monitor', 'samplers']
    assert timings.main([*subjects, '--repeats', '1', '--json']) == 0
    report = json.loads(capsys.readouterr().out)
    found = report['figures']
    assert all(figure['median_s'] > 0 for figure in found.values())
    assert {name.split('/')[0] for name in found} == set(subjects)
    assert {f'samplers/{word}' for word in SAMPLERS} < set(found)
    first, whole = (found[f'start-up/taxinet run{of}'] for of in (', first step', ' of 1 s'))
    assert first['median_s'] < whole['median_s']
    step = found['physics/control step']
    assert step['real_time_factor'] == pytest.approx(0.1 / step['median_s'])
    assert found['campaign/1 worker']['real_time_factor'] > 0
    assert report['amounts']['memory: taxinet run'] > 50e6


@pytest.mark.ros
def test_given_the_graph_when_measured_then_a_control_step_is_the_sum_of_its_parts() -> None:
    report = measure_subjects(['graph'], 1, lambda done, total: None)
    tick, amounts = report['tick'], report['amounts']
    assert list(tick) == [*PARTS, TRANSPORT, WHOLE]
    assert math.fsum(tick[part] for part in (*PARTS, TRANSPORT)) == pytest.approx(tick[WHOLE])
    assert all(tick[part] > 0 for part in PARTS)
    assert tick[WHOLE] == pytest.approx(report['figures']['graph/composed, network']['cpu_s'] / 301)
    assert set(report['ratios']) == {ratio.name for ratio in control_step.RATIOS}
    assert amounts['a run with pictures'] > 10 * amounts['a run without pictures'] > 0
