"""Pipes, sockets and devices in the place of a file that is read: one line, and nothing hangs."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest
from taxinet_process import taxinet

NNET = ('network', 'from-nnet', 'n.nnet', '--out', 'n.onnx', '--description')
RUN = ('run', 'nominal', '--controller', 'mine.py:steer')


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


@pytest.mark.timeout(60)
@pytest.mark.parametrize(('make', 'name', 'words'), [
    (pipe, 'table.parquet', ('analyze', 'table.parquet')),
    (pipe, 'mine.py', RUN), (a_socket, 'mine.py', RUN), (device, 'mine.py', RUN),
    (pipe, 'n.nnet', (*NNET, 'tinytaxinet')), (device, 'd', (*NNET, '/dev/zero')),
])
def test_given_what_may_never_end_in_the_place_of_a_file_then_one_line_says_so(
    tmp_path, make, name, words
):
    (tmp_path / 'n.nnet').write_text('1,1,1,1,\n')
    (tmp_path / name).unlink(missing_ok=True)
    make(tmp_path / name)
    done = taxinet(*words, cwd=tmp_path)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stdout + done.stderr
    assert Path(name).name in done.stderr or 'is a device, not a regular file' in done.stderr
    assert not (tmp_path / 'n.onnx').exists()
