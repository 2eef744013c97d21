"""``taxinet bench`` as people type it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest

from taxinet_ros.bench.subjects import monitor
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


def test_given_json_when_asked_for_then_it_is_all_there_is_and_can_be_compared_with(
    tmp_path: Path, capsys, monkeypatch
) -> None:
    for word in monitor.LENGTHS:
        monkeypatch.setitem(monitor.LENGTHS, word, 300)
    code, out, err = call(capsys, 'monitor', '--repeats', '2', '--json')
    assert (code, err) == (0, '')
    old = json.loads(out)
    assert set(old) == {'machine', 'figures'}
    assert {name.partition('/')[0] for name in old['figures']} == {'monitor'}

    old['figures']['monitor/on_runway sample']['median_s'] = 1e3
    old['machine']['processor'] = 'another one'
    path = tmp_path / 'old.json'
    path.write_text(json.dumps(old), encoding='utf-8')
    words = ['monitor', 'physics', '--repeats', '2', '--compare', str(path)]
    new = json.loads(call(capsys, *words, '--json')[1])
    assert set(new['compared']['ratios']) == set(old['figures'])
    assert new['compared']['ratios']['monitor/on_runway sample'] < 1e-3
    assert list(new['compared']['differences']) == ['processor']

    code, out, err = call(capsys, *words)
    assert (code, err) == (0, '')
    lines = {line.split('  ')[0]: line.split() for line in out.splitlines()}
    assert lines['monitor/on_runway sample'][-1] == '0.00'
    assert lines['physics/new'][-1] == '-'
    assert 'not the same machine: processor was another one, is ' in out


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['graphs'], "bench: 'graphs' is unknown; known: camera, "),
        (['monitor', '--repeats', '0'], 'bench: --repeats is 0, needs to be 1 or more'),
        (['monitor', '--compare', 'nowhere.json'], 'bench: cannot read nowhere.json: '),
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


def report_of(ratio: float) -> dict[str, object]:
    return {
        'machine': {}, 'figures': {},
        'ratios': {'a / b': {'value': ratio, 'low': ratio, 'high': ratio, 'clock': 'processor',
                             'least': None, 'most': 2.0, 'kept': ratio <= 2}},
        'tick': {'physics': 1e-3, 'whole': 4e-3},
        'amounts': {'a run': 3e6},
        'left_out': {'start-up': 'no reason'},
    }  # fmt: skip


@pytest.mark.parametrize(('ratio', 'code', 'line'), [
    (1.0, 0, ''),
    (3.0, 1, 'bench: a / b is 3.00, guarded at 2 or less\n'),
])
def test_given_a_guard_when_a_ratio_is_beyond_its_bound_then_the_exit_code_and_a_line_say_so(
    ratio: float, code: int, line: str, capsys, monkeypatch
) -> None:
    monkeypatch.setattr(
        'taxinet_ros.cli.bench.subjects.run_subjects', lambda *args: report_of(ratio)
    )
    found, out, err = call(capsys, 'graph', '--guard')
    assert (found, err) == (code, line)
    for words in ('a / b', 'physics', '25%', '3.0 MB', '<= 2', 'left out: start-up: no reason'):
        assert words in out
    assert call(capsys, 'graph')[0] == 0


def test_given_a_guard_without_a_graph_when_typed_then_it_is_refused(capsys, monkeypatch) -> None:
    code, out, err = call(capsys, 'physics', '--guard')
    assert (code, out) == (2, '')
    assert err == (
        'taxinet: error: bench: --guard checks the ratios of the graph; name graph or all\n'
    )
    report = {'machine': {}, 'figures': {}, 'left_out': {'graph': 'no rclpy'}}
    monkeypatch.setattr('taxinet_ros.cli.bench.subjects.run_subjects', lambda *args: report)
    code, _, err = call(capsys, '--guard')
    assert code == 2
    assert 'no guarded ratio was measured; the graph needs ROS 2' in err
