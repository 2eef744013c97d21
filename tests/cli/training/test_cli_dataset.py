"""``taxinet dataset``, ``train`` and ``evaluate`` as people type them."""

from __future__ import annotations

import json
import re
import signal
import subprocess
from pathlib import Path

import pandas as pd
import pytest
from taxinet_process import begun
from training_samples import foreign_folder
from waiting import wait_for

from taxinet_ros.cli.main import _exit_code, app


def call(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Exit code, standard output and error of a command, without the wait for a new process."""
    capsys.readouterr()
    code = _exit_code(lambda: app(list(words), standalone_mode=False))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_given_a_dataset_then_a_network_is_trained_on_it_and_measured_on_it(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    words = ['dataset', 'nominal', '--count', '8', '--seed', '3', '--workers', '1', '--out', 'set']
    assert call(capsys, *words) == (
        0, '8 images in set, 8 of them rendered now; labels: set/labels.parquet\n', ''
    )
    assert call(capsys, *words, '--resume')[1].startswith('8 images in set, 0 of them')
    table = pd.read_parquet('set/labels.parquet')
    assert len(table) == len(list(Path('set/images').iterdir())) == 8

    code, out, err = call(
        capsys, 'train', 'set', '--validation', '3', '--epochs', '2', '--batch', '2',
        '--augment', '--out', 'net.safetensors',
    )
    assert (code, err) == (0, '')
    assert out.splitlines()[-1].startswith('weights: net.safetensors (epoch ')
    assert sorted(path.suffix for path in tmp_path.glob('net.*')) == [
        '.csv', '.json', '.png', '.safetensors'
    ]

    words = ['evaluate', 'set', '--perception', 'net.safetensors']
    facts = json.loads(call(capsys, *words, '--json')[1])
    (whole,) = facts['slices']
    assert (whole['name'], whole['images'], whole['without_estimate']) == ('all', 8, 0)
    assert facts['fingerprint'] == json.loads(Path('net.json').read_text())['weights_sha256']
    assert whole['half_widths']['cte_m'] > 0
    code, out, err = call(capsys, *words)
    assert (code, err) == (0, '')
    row = next(line.split() for line in out.splitlines() if line.startswith('all '))
    assert row[1:3] == ['8', '0']
    assert float(row[3]) == pytest.approx(whole['errors']['cte_m']['mae'], abs=6e-4)
    assert 0 not in {int(count) for count in re.findall(r'^.{22} *(\d+) ', out, re.MULTILINE)}


def test_given_a_network_with_a_flipped_sign_when_measured_then_a_line_says_so(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    foreign_folder(tmp_path / 'set', images=9)  # image i stands i m to the left
    for name, sign in (('right', '-'), ('left', '')):
        Path(f'{name}.py').write_text(
            'class Eyes:\n    seen = -1\n    def __call__(self, image):\n        self.seen += 1\n'
            f'        return {sign}self.seen, 0.0\n'
        )
    words = ['evaluate', 'set', '--perception']
    code, out, err = call(capsys, *words, 'right.py:Eyes')
    assert (code, err) == (0, '')
    assert (
        'cross-track: the estimates fall where the truth rises. With the other sign, the MAE would '
        'be 0 m instead of 8: left is positive; ' in out
    )
    (whole,) = json.loads(call(capsys, *words, 'right.py:Eyes', '--json')[1])['slices']
    assert whole['mirrored'] == {'cte_m': 0.0}
    assert 'other sign' not in call(capsys, *words, 'left.py:Eyes')[1]


@pytest.mark.nightly
def test_given_an_interrupt_then_what_is_written_stays_and_the_exit_code_is_130(tmp_path):
    out = tmp_path / 'set'
    words = ['dataset', 'nominal', '--count', '2000', '--out', str(out)]
    third = out / 'images' / '000002.png'
    with begun(*words, stderr=subprocess.PIPE) as running:
        wait_for(lambda: third.exists() or running.poll() is not None)
        assert third.exists()
        running.send_signal(signal.SIGINT)
        _, errors = running.communicate()
    assert running.returncode == 130
    assert errors == f'interrupted; images in {out} are kept, continue with --resume\n'
    images = [path for path in (out / 'images').iterdir() if not path.name.startswith('.')]
    assert 3 <= len(images) < 2000
    assert all(path.read_bytes().endswith(b'IEND\xaeB`\x82') for path in images)
    assert (out / 'progress.db').exists()
    assert not (out / 'dataset.json').exists()
