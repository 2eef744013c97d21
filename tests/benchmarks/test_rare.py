"""Estimates of rare failures: landscapes fail as often as they say, intervals hold, a table."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest
import rare
from rare import LANDSCAPES, METHODS, RUNS, SPACE, attempt, draw, measure_rare, split
from scipy.special import ndtri

from taxinet_ros.samplers.splitting import LOOK_TAIL
from taxinet_ros.trials.rates import share_bounds

pytestmark = pytest.mark.nightly


@pytest.mark.parametrize('name', LANDSCAPES)
@pytest.mark.parametrize('probability', [0.1, 0.01])
def test_given_a_landscape_then_it_fails_as_often_as_it_says(name, probability):
    points = ndtri(np.random.default_rng(1).random((200_000, len(SPACE))))
    share = float((LANDSCAPES[name].make(probability)(points) <= 0).mean())
    error = (probability * (1 - probability) / len(points)) ** 0.5
    assert share == pytest.approx(probability, abs=4 * error)


@pytest.mark.parametrize('name', ['late', 'three', 'capped', 'rough', 'corners', 'hidden'])
def test_a_region_that_islands_lost_is_within_the_interval(name):
    found = [split(LANDSCAPES[name].make(1e-4), seed) for seed in range(2)]
    assert all(one.low <= 1e-4 <= one.high for one in found)
    assert all(3000 < one.runs <= RUNS for one in found)
    # Beyond what plain draws exclude, nothing is known: 2,000 without a failure.
    assert {one.high for one in found if not one.plain} <= {
        share_bounds(failed, 2000 - failed, LOOK_TAIL)[1] for failed in (0, 1)
    }


def test_given_known_probabilities_then_the_mean_of_the_islands_is_unbiased():
    found = [
        split(LANDSCAPES[name].make(1e-3), seed, runs=1000, floor=1e-3)
        for name in ('half', 'two', 'kinds') for seed in range(4)
    ]
    ratio = np.array([one.probability for one in found if not one.plain]) / 1e-3
    assert len(ratio) >= 8
    assert abs(ratio.mean() - 1) < 4 * ratio.std(ddof=1) / len(ratio) ** 0.5


def test_given_one_in_a_hundred_then_all_is_drawn_plainly():
    found = split(LANDSCAPES['ring'].make(0.01), 0)
    assert (found.plain, found.runs) == (True, RUNS)
    assert found.low <= 0.01 <= found.high <= 3 * found.low


def test_given_plain_draws_then_their_intervals_cover():
    plain = [draw(0.01, 4000, seed) for seed in range(100)]
    assert sum(one.low <= 0.01 <= one.high for one in plain) >= 90
    assert np.mean([one.probability for one in plain]) == pytest.approx(0.01, rel=0.07)


def test_given_an_estimate_then_the_others_have_as_many_runs_and_it_is_repeatable():
    one = attempt('half', 0.01, 3)
    assert {getattr(one, method).runs for method in METHODS} == {one.splitting.runs}
    assert 0 < one.splitting.runs <= RUNS
    assert one == attempt('half', 0.01, 3)


def test_given_words_then_there_are_json_and_a_table(monkeypatch, capsys):
    monkeypatch.setattr(rare, 'measure_rare', partial(
        measure_rare, probabilities=(0.01,), workers=1,
    ))
    words = ['ring', 'half', '--repeats', '1', '--seed', '7']
    assert rare.main([*words, '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert [(one['landscape'], one['probability']) for one in found['rare']] == [
        ('half', 0.01), ('ring', 0.01),
    ]
    own = split(LANDSCAPES['ring'].make(0.01), 7)
    [line] = [one for one in found['rare'] if one['landscape'] == 'ring']
    assert line['splitting']['error'] == pytest.approx(abs(own.probability / 0.01 - 1))
    assert line['runs'] == own.runs
    assert rare.main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith('1 estimates for each line, of at most 4,000 runs')
    assert [row.split()[:3] for row in lines if row.startswith('ring ')] == [
        ['ring', '1e-02', f'{own.runs:,}'],
    ]
