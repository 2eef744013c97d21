"""``taxinet bench`` as people type it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import pytest

from taxinet_ros.bench import subjects
from taxinet_ros.cli.main import _exit_code, app


@pytest.fixture(autouse=True)
def threads():
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


def call(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    capsys.readouterr()
    code = _exit_code(lambda: app(['bench', *words], standalone_mode=False))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second of the loop."""
    monkeypatch.setattr(
        subjects, 'SCENARIO', dataclasses.replace(subjects.SCENARIO, duration_s=1.0)
    )


@pytest.mark.usefixtures('short')
def test_given_json_when_asked_for_then_it_is_all_there_is_and_can_be_compared_with(
    tmp_path: Path, capsys
) -> None:
    code, out, err = call(capsys, 'loop', '--repeats', '2', '--json')
    assert (code, err) == (0, '')
    old = json.loads(out)
    assert set(old) == {'machine', 'figures'}
    assert set(old['figures']) == {'loop/network', 'loop/truth'}

    old['figures']['loop/truth']['median_s'] = 1e3
    del old['figures']['loop/network']
    old['machine']['processor'] = 'another one'
    path = tmp_path / 'old.json'
    path.write_text(json.dumps(old), encoding='utf-8')
    words = ['loop', '--repeats', '2', '--compare', str(path)]
    new = json.loads(call(capsys, *words, '--json')[1])
    assert set(new['compared']['ratios']) == {'loop/truth'}
    assert new['compared']['ratios']['loop/truth'] < 1e-3
    assert list(new['compared']['differences']) == ['processor']

    code, out, err = call(capsys, *words)
    assert (code, err) == (0, '')
    lines = {line.split('  ')[0]: line.split() for line in out.splitlines()}
    assert lines['loop/truth'][-1] == '0.00'
    assert lines['loop/network'][-1] == '-'
    assert 'not the same machine: processor was another one, is ' in out


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['graphs'], "bench: 'graphs' is unknown; known: camera, loop, graph"),
        (['loop', '--repeats', '0'], 'bench: repeats is 0, needs to be 1 or more'),
        (['loop', '--compare', 'nowhere.json'], 'bench: cannot read nowhere.json: '),
        (['loop', '--guard'], 'bench: --guard checks the ratios of the graph; name graph'),
    ],
)
def test_given_bad_words_when_typed_then_one_line_says_so(
    words: list[str], message: str, capsys, tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = call(capsys, *words)
    assert (code, out) == (2, '')
    assert err.startswith(f'taxinet: error: {message}')
    assert err.count('\n') == 1


@pytest.mark.parametrize(('ratio', 'code', 'line'), [
    (1.0, 0, ''),
    (3.0, 1, 'bench: a / b is 3.00, guarded at 2 or less\n'),
])
def test_given_a_guard_when_a_ratio_is_beyond_its_bound_then_the_exit_code_and_a_line_say_so(
    ratio: float, code: int, line: str, capsys, monkeypatch
) -> None:
    report = {
        'machine': {}, 'figures': {},
        'ratios': {'a / b': {'value': ratio, 'low': ratio, 'high': ratio, 'most': 2.0}},
    }
    monkeypatch.setattr('taxinet_ros.bench.run.run_subjects', lambda *args: report)
    found, out, err = call(capsys, 'graph', '--guard')
    assert (found, err) == (code, line)
    assert 'a / b' in out
    assert '<= 2' in out
    assert call(capsys, 'graph')[0] == 0
