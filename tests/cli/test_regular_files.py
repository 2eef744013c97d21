"""Pipes, sockets and devices in the place of a file that is read: one line, and nothing hangs."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from pathlib import Path

import pytest
from taxinet_process import TAXINET, taxinet_apart

pytestmark = [pytest.mark.nightly, pytest.mark.ros]


@pytest.fixture(scope='module')
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('strange')
    words = ('run', 'nominal', '--perception', 'truth', '--images', 'none', '--set', 'duration=1')
    assert taxinet_apart(*words, '--out', 'c', cwd=folder).returncode in (0, 1)
    return folder / 'c'


FROM_NNET = (
    'network', 'from-nnet', 'n.nnet', '--out', 'n.onnx', '--description', 'tinytaxinet',
)


def pipe(path: Path) -> None:
    os.mkfifo(path)


def device(path: Path) -> None:
    path.symlink_to('/dev/zero')


def a_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        before = Path.cwd()
        os.chdir(path.parent)  # the path of a socket is to be short
        one.bind(path.name)
        os.chdir(before)


@pytest.mark.parametrize(('make', 'name', 'words'), [
    (pipe, 'c/ledger.jsonl', ('falsify', 'nominal', '--out', 'c', '--resume')),
    (pipe, 'c/campaign.json', ('analyze', 'c')),
    (device, 'c/campaign.json', ('gate', 'c', '--min-satisfaction', '0.5')),
    (pipe, 'c/runs.parquet', ('analyze', 'c')),
    (pipe, 'mine.py', ('run', 'nominal', '--controller', 'mine.py:steer')),
    (a_socket, 'mine.py', ('run', 'nominal', '--controller', 'mine.py:steer')),
    (device, 'mine.py', ('run', 'nominal', '--controller', 'mine.py:steer')),
    (pipe, 'n.nnet', FROM_NNET),
    (device, 'n.nnet', FROM_NNET),
])
def test_given_what_may_never_end_in_the_place_of_a_file_then_one_line_says_so(
    made, tmp_path, make, name, words
):
    shutil.copytree(made, tmp_path / 'c')
    (tmp_path / name).unlink(missing_ok=True)
    make(tmp_path / name)
    done = taxinet_apart(*words, cwd=tmp_path)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stdout + done.stderr
    assert Path(name).name in done.stderr


def test_given_what_a_shell_offers_as_a_file_then_it_is_read(made):
    words = ['monitor', str(made), '--spec', '/dev/stdin']
    done = subprocess.run(
        [*TAXINET, *words], input='near=always(cte < 100)\n', capture_output=True, text=True,
        check=False,
    )
    assert 'not a regular file' not in done.stderr


@pytest.mark.parametrize('words', [
    ('/dev/zero', '--description', 'tinytaxinet'), ('n.nnet', '--description', '/dev/zero'),
    ('/dev/urandom', '--description', 'tinytaxinet'), ('n.nnet', '--description', '/dev/urandom'),
])
def test_given_a_device_by_its_own_name_then_one_line_says_so_and_little_is_read(tmp_path, words):
    (tmp_path / 'n.nnet').write_text('1,1,1,1,\n')
    done = taxinet_apart('network', 'from-nnet', *words, '--out', 'n.onnx', cwd=tmp_path)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stdout + done.stderr
    assert 'is a device, not a regular file' in done.stderr
    assert not (tmp_path / 'n.onnx').exists()
