"""Options that would have no effect are refused by name, before anything is done."""

from __future__ import annotations

from pathlib import Path

import pytest

from taxinet_ros.cli.main import _exit_code, app

GOLDEN = Path(__file__).resolve().parents[2] / 'bags' / 'golden'
BAG = str(GOLDEN / 'truth-nominal')
TRAIN = ('train', '--data', 'd', '--out', 'n.safetensors')
RESUMED = ('improve', '--resume', '--out', '.')
REPORT = ('case-study', '--report-only', '--out', '.')
UNREAD = [
    ((*TRAIN, '--images', '12000'), '--images: for rendered scenes; with --data'),
    ((*TRAIN, '--sampler', 'random'), '--sampler: for rendered scenes; with --data'),
    ((*TRAIN, '--validation-data', 'v', '--validation', '3'), '--validation: with --validation-'),
    (('evaluate', '--data', 'd', '--images', '3'), '--images: for rendered scenes; with --data'),
    (('evaluate', '--data', 'd', '--seed', '2'), '--seed: for rendered scenes; with --data'),
    (('evaluate', '--data', 'd', '--workers', '2'), '--workers: for rendered scenes; with'),
    (('bag', 'export', BAG, '--topics', 'tf', '--run', 'x', '--out', 'tf.csv'),
     '--run x: has no effect on --topics tf, which belongs to no run'),
    (('monitor', BAG, '--rate', 'he=3'), '--rate he: has no effect: no requirement reads he'),
    (('monitor', str(GOLDEN), '--bound', 'he=-1:1'), '--bound he: has no effect: no requirement'),
    (('up', '--no-record', '--images', 'none'), '--images: has no effect with --no-record'),
    (('check-node', '--external', '--log', 'node.log'), '--log: the output of a node that you'),
    ((*RESUMED, '--rounds', '3'), '--rounds: is taken from the folder that --resume continues'),
    ((*RESUMED, 's_falsif'), 'program: is taken from the folder that --resume continues'),
    ((*REPORT, '--runs', '3'), '--runs: has no effect with --report-only'),
    ((*REPORT, '--list'), '--list: has no effect with --report-only'),
    (('case-study', '--tables', '.', '--resume'), '--resume: has no effect with --tables'),
    (('case-study', '--tables', '.', '--workers', '2'), '--workers: has no effect with --tables'),
]


@pytest.mark.ros
@pytest.mark.parametrize(('words', 'complaint'), UNREAD)
def test_given_an_option_that_nothing_would_read_then_it_is_refused_by_name(
    words, complaint, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert _exit_code(lambda: app(list(words), standalone_mode=False)) == 2
    out, err = capsys.readouterr()
    assert out == ''
    assert err.startswith(f'taxinet: error: {complaint}')
    assert err.count('\n') == 1
    assert list(tmp_path.iterdir()) == []
