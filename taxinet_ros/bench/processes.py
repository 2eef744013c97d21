"""Processes watched from outside: start-up, processor time, memory, and bytes on disk."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import psutil

from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import ExitCode, InfraError, InfraKind
from taxinet_ros.processes.child import ChildProcess


def processor_time_ns(pid: int) -> int:
    """Processor time that all threads of a process have used [ns], in steps of 10 ms."""
    spent = psutil.Process(pid).cpu_times()
    return round((spent.user + spent.system) * NS_PER_S)


def peak_memory(pids: Iterable[int]) -> int:
    """Most resident memory that each of these processes has had so far, added up [bytes].

    What they share is counted in each of them. A process that is gone counts nothing.
    """
    # getrusage would not do: Linux has a child inherit what its parent had before the exec. Nor
    # does psutil tell it, which knows what a process has now.
    return sum(_peak(pid) for pid in pids)


def _peak(pid: int) -> int:
    try:
        lines = Path(f'/proc/{pid}/status').read_text(encoding='utf-8').splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return 0
    return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith('VmHWM:'))


VERDICTS = (ExitCode.OK, ExitCode.VIOLATED)
"""Exit codes of a command whose runs have all been judged."""
TAXINET = (sys.executable, '-P', '-c', 'from taxinet_ros.cli.main import main; main()')
"""What starts ``taxinet`` as people's shells do, with this Python."""
LIMIT_S = 120.0
"""Longest time to wait for something to be seen [s]."""
LOOK_S = 0.003
"""Time between two looks [s]."""


def wait_for(process: ChildProcess, there: Callable[[], bool]) -> int:
    """Look until something is there.

    Returns:
        When that was, on the clock of :func:`time.perf_counter_ns`.

    Raises:
        InfraError: the process has ended, or too much time has passed.
    """
    deadline = time.monotonic() + LIMIT_S
    while not there():
        if process.dead and not there():
            raise InfraError(InfraKind.DIED, process.name, -1, process.how_it_ended())
        if time.monotonic() > deadline:
            raise InfraError(
                InfraKind.NOT_READY, process.name, -1, f'nothing to be seen after {LIMIT_S:g} s'
            )
        time.sleep(LOOK_S)
    return time.perf_counter_ns()


Amounts = dict[str, Callable[[], float]]
"""What tells an amount [bytes] once all is measured, by name; NaN where there is none."""


def folder_bytes(folder: Path) -> int:
    """Size of all the files in a folder [bytes]."""
    return sum(file.stat().st_size for file in folder.rglob('*') if file.is_file())
