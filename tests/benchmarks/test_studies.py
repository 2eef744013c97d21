"""Landscapes fail as often as they say; words on the command line, and tables."""

from __future__ import annotations

import json
from functools import partial

import common

import intervals
import numpy as np
import pytest
import searches
import sequential
from intervals import LANDSCAPES, measure_intervals
from searches import RUNS, search

from taxinet_ros.errors import InfraError, InfraKind, UsageError


@pytest.mark.nightly
def test_t7_given_words_when_searched_then_each_sampler_has_its_line_for_each_landscape(
    capsys,
) -> None:
    words = ['four', 'ce', 'corner', 'random', '--repeats', '2']
    assert searches.main([*words, '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found['runs'], found['repeats']) == (RUNS, 2)
    lines = {(one['landscape'], one['sampler']): one for one in found['searches']}
    assert list(lines) == [
        ('corner', 'random'), ('corner', 'ce'), ('four', 'random'), ('four', 'ce'),
    ]
    one = lines['four', 'ce']
    both = [search('four', 'ce', seed) for seed in (0, 1)]
    assert one['regions'] == sum(each.regions for each in both) / 2
    assert one['distinct'] == sum(each.distinct for each in both) / 2

    assert searches.main(words) == 0
    out = capsys.readouterr().out
    assert out.startswith('2 searches of 200 runs for each line\n')
    assert f'ce {100 * one["found"]:.0f}% {100 * one["regions"]:.0f}%' in ' '.join(out.split())


@pytest.mark.parametrize(('words', 'message'), [
    (['corners'], "'corners' is unknown; known: random, "),
    (['--repeats', '0'], 'argument --repeats: 0, needs to be 1 or more'),
])
def test_given_a_mistake_when_searches_are_asked_for_then_it_is_named(words, message, capsys):
    with pytest.raises(SystemExit, match='2'):
        searches.main(words)
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(('error', 'code'), [
    (UsageError('wrong'), 2), (InfraError(InfraKind.DIED, 'it', -1, 'gone'), 4),
])
def test_given_an_error_when_a_script_ends_then_it_is_one_line_and_the_exit_code(
    error, code, capsys,
):
    def fail():
        raise error

    with pytest.raises(SystemExit, match=str(code)):
        common.leave(fail)
    assert capsys.readouterr().err == f'error: {error}\n'


@pytest.mark.one_in(3)
@pytest.mark.parametrize('shape', LANDSCAPES)
@pytest.mark.parametrize('rate', [0.5, 0.1, 0.01])
def test_given_a_landscape_then_it_fails_as_often_as_it_says(shape, rate):
    rho = LANDSCAPES[shape](rate)
    across, up = ((np.arange(size) + 0.5) / size for size in (400, 397))
    failed = [rho((x, y)) <= 0 for x in across.tolist() for y in up.tolist()]
    assert np.mean(failed) == pytest.approx(rate, rel=0.06)


def test_given_a_few_searches_then_there_is_a_table_and_json(monkeypatch, capsys):
    monkeypatch.setattr(intervals, 'measure_intervals', partial(
        measure_intervals, runs=(20, 40), rates=(0.5,), workers=1,
    ))
    assert intervals.main(['halton', 'random', '--repeats', '4', '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one['sampler'] for one in found['intervals']] == ['halton', 'random']
    assert [one['drawn'] for one in found['intervals']] == [[6.0, 12.0], [20.0, 40.0]]
    assert intervals.main(['random', '--repeats', '4']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith('4 searches for each line, band, corner, diagonal, two regions')
    assert [line.split()[:4] for line in lines if line.startswith('random')] == [
        ['random', '50', '%', '20'], ['random', '50', '%', '40'],
    ]


@pytest.mark.nightly
@pytest.mark.parametrize('word', ['mab', 'ce'])
def test_t2_t3_given_known_rates_then_intervals_hold_them_and_gate_passes_seldom(word):
    found = measure_intervals(
        [word], 40, lambda done, total: None, runs=(60, 100), rates=(0.1, 0.01), workers=1,
    )
    for one in found['intervals']:
        assert min(one['covers']) >= 0.87  # 95 % of 40 searches, and more than 2 standard errors
        assert max(one['passes']) <= 0.1
        assert one['watched_covers'] >= 0.87
        assert one['watched_passes'] <= 0.1


def test_given_sequential_tests_then_shares_agree_with_the_exact_ones_and_there_is_a_table(
    monkeypatch, capsys,
):
    monkeypatch.setattr(sequential, 'measure_sequential', partial(
        sequential.measure_sequential, cases=((0.86, 0.95),),
    ))
    assert sequential.main(['--repeats', '200', '--json']) == 0
    found = json.loads(capsys.readouterr().out)['sequential']
    assert [one['role'] for one in found] == ['better', 'design', 'threshold', 'worse'] * 2
    for one in found:
        assert one['passes'] == pytest.approx(one['exact_passes'], abs=0.1)
        assert one['mean_runs'] == pytest.approx(one['exact_mean_runs'], rel=0.3)
    assert sequential.main(['--repeats', '1']) == 0
    assert capsys.readouterr().out.startswith('1 campaigns for each line')
