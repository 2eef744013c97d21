"""``taxinet`` to its end: in this process, or in one of its own, as a shell starts it."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

from taxinet_ros.cli.main import main

TAXINET = [sys.executable, '-c', 'from taxinet_ros.cli.main import main; main()']


def taxinet(*words: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command in this process, which has imported long ago what it takes a second to.

    What it and the processes that it starts write is caught below Python, as a pipe would.
    """
    text = [str(word) for word in words]
    with (
        tempfile.TemporaryFile('w+') as out,
        tempfile.TemporaryFile('w+') as err,
        contextlib.chdir(cwd or Path.cwd()),
        mock.patch.dict(os.environ, COLUMNS='80'),
        mock.patch.object(sys, 'argv', ['taxinet', *text]),
    ):
        with _written_to(1, out.fileno()), _written_to(2, err.fileno()):
            try:
                main()
            except SystemExit as end:
                code = int(end.code or 0)
        found = [file.seek(0) or file.read() for file in (out, err)]
    return subprocess.CompletedProcess(text, code, *found)


@contextlib.contextmanager
def _written_to(stream: int, file: int) -> Iterator[None]:
    """Have a standard stream, the descriptor and Python's object alike, lead into a file."""
    name = {1: 'stdout', 2: 'stderr'}[stream]
    getattr(sys, name).flush()
    before = os.dup(stream)
    os.dup2(file, stream)
    try:
        with os.fdopen(stream, 'w', closefd=False) as ours, mock.patch.object(sys, name, ours):
            yield
    finally:
        os.dup2(before, stream)
        os.close(before)


def taxinet_apart(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command in a process of its own."""
    return subprocess.run(
        [*TAXINET, *words], capture_output=True, text=True, cwd=cwd,
        env={**os.environ, 'COLUMNS': '80'},
    )


@contextlib.contextmanager
def begun(
    *words: str, cwd: Path | None = None, stderr: int | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A command under way, which does not outlive the test."""
    with subprocess.Popen(
        [*TAXINET, *words], stdout=subprocess.PIPE, stderr=stderr, text=True, cwd=cwd
    ) as process:
        try:
            yield process
        finally:
            process.kill()
