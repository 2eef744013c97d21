"""What Linux tells of processes: how long they have worked, and how much memory they have had."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import psutil

from taxinet_ros.core.types import NS_PER_S


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
