"""Commands that the bench starts as people do, and watches from outside."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable

from taxinet_ros.core.errors import InfraError

TAXINET = (sys.executable, '-P', '-c', 'from taxinet_ros.cli.main import main; main()')
"""What starts ``taxinet`` as people's shells do, with this Python."""

LIMIT_S = 120.0
"""Longest time to wait for something to be seen [s]."""

LOOK_S = 0.003
"""Time between two looks [s]."""


def wait_for(process: subprocess.Popen[bytes], there: Callable[[], bool], who: str) -> int:
    """Look until something is there.

    Returns:
        When that was, on the clock of :func:`time.perf_counter_ns`.

    Raises:
        InfraError: the process has ended, or too much time has passed.
    """
    deadline = time.monotonic() + LIMIT_S
    while not there():
        if process.poll() is not None and not there():
            raise InfraError('start', who, -1, last_words(process))
        if time.monotonic() > deadline:
            raise InfraError('start', who, -1, f'nothing to be seen after {LIMIT_S:g} s')
        time.sleep(LOOK_S)
    return time.perf_counter_ns()


def last_words(process: subprocess.Popen[bytes]) -> str:
    """How a process that was started with a pipe for its errors has ended, in one line."""
    said = process.stderr.read().decode(errors='replace').split('\n') if process.stderr else []
    lines = [line for line in said if line.strip()]
    return ': '.join([f'exit code {process.returncode}', *lines[-1:]])
