"""``taxinet`` as a process of its own, as a shell starts it."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

TAXINET = [sys.executable, '-c', 'from taxinet_ros.cli.main import main; main()']


def taxinet(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    environment = {**os.environ, 'COLUMNS': '80'}
    return subprocess.run(
        [*TAXINET, *words], capture_output=True, text=True, cwd=cwd, env=environment,
    )


@contextlib.contextmanager
def begun(
    *words: str, cwd: Path, stderr: int | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A command under way, which does not outlive the test."""
    with subprocess.Popen(
        [*TAXINET, *words], stdout=subprocess.PIPE, stderr=stderr, text=True, cwd=cwd
    ) as process:
        try:
            yield process
        finally:
            process.kill()
