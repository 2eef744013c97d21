"""``taxinet bench intervals``: the landscapes, the command's words, and its table."""

from __future__ import annotations

import json

import numpy as np
import pytest

from taxinet_ros.bench.intervals import LANDSCAPES, measure_intervals
from taxinet_ros.cli.given import asks_for
from taxinet_ros.cli.intervals import run_intervals
from taxinet_ros.core.errors import UsageError


@pytest.mark.parametrize('shape', LANDSCAPES)
@pytest.mark.parametrize('rate', [0.5, 0.1, 0.01])
def test_given_a_landscape_then_it_fails_as_often_as_it_says(shape, rate):
    rho = LANDSCAPES[shape](rate)
    across, up = ((np.arange(size) + 0.5) / size for size in (400, 397))
    failed = [rho((x, y)) <= 0 for x in across.tolist() for y in up.tolist()]
    assert np.mean(failed) == pytest.approx(rate, rel=0.06)


def test_given_words_then_only_what_belongs_to_it_is_taken():
    assert asks_for('intervals', ['intervals', 'ce'], ['subjects', 'repeats', 'as_json'])
    assert not asks_for('intervals', ['camera'], ['compare'])
    with pytest.raises(UsageError, match='intervals goes first'):
        asks_for('intervals', ['ce', 'intervals'], ['subjects'])
    with pytest.raises(UsageError, match='--compare: not with intervals'):
        asks_for('intervals', ['intervals'], ['subjects', 'compare'])
    for words, repeats, said in ((['cma'], 5, "sampler 'cma' is unknown"), ([], 0, '--repeats')):
        with pytest.raises(UsageError, match=said):
            measure_intervals(words, repeats, lambda done, total: None)


def test_given_a_few_searches_then_there_is_a_table_and_json(monkeypatch, capsys):
    short = {'runs': (20, 40), 'rates': (0.5,), 'workers': 1}
    monkeypatch.setattr(
        'taxinet_ros.cli.intervals.measure_intervals',
        lambda words, repeats, show: measure_intervals(words, repeats, show, **short),
    )
    assert run_intervals(['halton', 'random'], repeats=4, as_json=True) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one['sampler'] for one in found['intervals']] == ['halton', 'random']
    assert [one['drawn'] for one in found['intervals']] == [[6.0, 12.0], [20.0, 40.0]]
    assert run_intervals(['random'], repeats=4, as_json=False) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith('4 searches for each line, band, corner, diagonal, two regions')
    assert [line.split()[:4] for line in lines if line.startswith('random')] == [
        ['random', '50', '%', '20'], ['random', '50', '%', '40'],
    ]
