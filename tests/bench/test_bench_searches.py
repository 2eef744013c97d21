"""``taxinet bench searches`` and ``intervals``: landscapes, words on the command line, tables."""

from __future__ import annotations

import json

import numpy as np
import pytest

from taxinet_ros.bench.intervals import LANDSCAPES, measure_intervals
from taxinet_ros.bench.searches import RUNS, search
from taxinet_ros.cli.bench.samplers import run_intervals
from taxinet_ros.cli.main import _exit_code, app
from taxinet_ros.cli.options import asks_for_study
from taxinet_ros.errors import UsageError


def call(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = _exit_code(lambda: app(['bench', *words], standalone_mode=False))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_t7_given_words_when_searched_then_each_sampler_has_its_line_for_each_landscape(
    capsys,
) -> None:
    words = ['searches', 'four', 'ce', 'corner', 'random', '--repeats', '2']
    code, out, err = call(capsys, *words, '--json')
    assert (code, err) == (0, '')
    found = json.loads(out)
    assert (found['runs'], found['repeats']) == (RUNS, 2)
    lines = {(one['landscape'], one['sampler']): one for one in found['searches']}
    assert list(lines) == [
        ('corner', 'random'), ('corner', 'ce'), ('four', 'random'), ('four', 'ce'),
    ]
    one = lines['four', 'ce']
    both = [search('four', 'ce', seed) for seed in (0, 1)]
    assert one['regions'] == sum(each.regions for each in both) / 2
    assert one['distinct'] == sum(each.distinct for each in both) / 2

    code, out, err = call(capsys, *words)
    assert (code, err) == (0, '')
    assert out.startswith('2 searches of 200 runs for each line\n')
    assert f'ce {100 * one["found"]:.0f}% {100 * one["regions"]:.0f}%' in ' '.join(out.split())


@pytest.mark.parametrize(('words', 'message'), [
    (['searches', 'corners'], "sampler or landscape 'corners' is unknown; known: random, "),
    (['searches', '--repeats', '0'], '--repeats is 0, needs to be 1 or more'),
    (['searches', '--guard'], '--guard: not with searches'),
    (['camera', 'searches'], 'searches must come first'),
])
def test_given_a_mistake_when_searches_are_asked_for_then_one_line_says_what(
    words, message: str, capsys
) -> None:
    code, out, err = call(capsys, *words)
    assert (code, out) == (2, '')
    assert message in err
    assert err.count('\n') == 1


@pytest.mark.parametrize('shape', LANDSCAPES)
@pytest.mark.parametrize('rate', [0.5, 0.1, 0.01])
def test_given_a_landscape_then_it_fails_as_often_as_it_says(shape, rate):
    rho = LANDSCAPES[shape](rate)
    across, up = ((np.arange(size) + 0.5) / size for size in (400, 397))
    failed = [rho((x, y)) <= 0 for x in across.tolist() for y in up.tolist()]
    assert np.mean(failed) == pytest.approx(rate, rel=0.06)


def test_given_words_then_only_what_belongs_to_it_is_taken():
    assert asks_for_study('intervals', ['intervals', 'ce'], ['subjects', 'repeats', 'as_json'])
    assert not asks_for_study('intervals', ['camera'], ['compare'])
    with pytest.raises(UsageError, match='intervals must come first'):
        asks_for_study('intervals', ['ce', 'intervals'], ['subjects'])
    with pytest.raises(UsageError, match='--compare: not with intervals'):
        asks_for_study('intervals', ['intervals'], ['subjects', 'compare'])
    for words, repeats, said in ((['cma'], 5, "sampler 'cma' is unknown"), ([], 0, '--repeats')):
        with pytest.raises(UsageError, match=said):
            measure_intervals(words, repeats, lambda done, total: None)


def test_given_a_few_searches_then_there_is_a_table_and_json(monkeypatch, capsys):
    short = {'runs': (20, 40), 'rates': (0.5,), 'workers': 1}
    monkeypatch.setattr(
        'taxinet_ros.cli.bench.samplers.measure_intervals',
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
