"""``taxinet bench searches`` as people type it."""

from __future__ import annotations

import json

import pytest

from taxinet_ros.bench.searches import RUNS, search
from taxinet_ros.cli.main import _exit_code, app


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
    (['camera', 'searches'], 'searches goes first'),
])
def test_given_a_mistake_when_searches_are_asked_for_then_one_line_says_what(
    words, message: str, capsys
) -> None:
    code, out, err = call(capsys, *words)
    assert (code, out) == (2, '')
    assert message in err
    assert err.count('\n') == 1
