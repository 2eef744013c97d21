"""What is measured of processes from outside: when something is seen of them, memory, bytes."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from taxinet_ros.errors import ExitCode, InfraError, InfraKind
from taxinet_ros.processes.child import ChildProcess


def peak_memory(pids: Iterable[int]) -> int:
    """Sum of the peak resident memory of these processes so far [bytes].

    Shared memory is counted in each of them. A process that has ended counts as 0.
    """
    # getrusage is unsuitable: on Linux a child inherits its parent's peak from before the exec.
    # psutil only reports current memory.
    return sum(_peak(pid) for pid in pids)


def _peak(pid: int) -> int:
    try:
        lines = Path(f'/proc/{pid}/status').read_text(encoding='utf-8').splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return 0
    return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith('VmHWM:'))


VERDICTS = (ExitCode.OK, ExitCode.VIOLATED)
"""Exit codes of a command whose runs were all judged."""
TAXINET = (sys.executable, '-P', '-c', 'from taxinet_ros.cli.main import main; main()')
"""Command that starts ``taxinet`` with this Python, as a shell would."""
LIMIT_S = 120.0
"""Maximum time to wait for a condition [s]."""
POLL_S = 0.003
"""Polling period [s]."""


def wait_for(process: ChildProcess, there: Callable[[], bool]) -> int:
    """Poll until a condition holds.

    Returns:
        Time at which it held, on the clock of :func:`time.perf_counter_ns`.

    Raises:
        InfraError: the process has ended, or the wait timed out.
    """
    deadline = time.monotonic() + LIMIT_S
    while not there():
        if process.dead and not there():
            raise InfraError(InfraKind.DIED, process.name, -1, process.how_it_ended())
        if time.monotonic() > deadline:
            raise InfraError(
                InfraKind.NOT_READY, process.name, -1, f'nothing to be seen after {LIMIT_S:g} s'
            )
        time.sleep(POLL_S)
    return time.perf_counter_ns()


Amounts = dict[str, Callable[[], float]]
"""Functions that return an amount [bytes] after the measurement, by name; NaN if there is none."""


def folder_bytes(folder: Path) -> int:
    """Total size of the files in a folder [bytes]."""
    return sum(file.stat().st_size for file in folder.rglob('*') if file.is_file())
