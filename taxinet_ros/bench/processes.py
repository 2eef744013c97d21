"""What Linux tells of processes: how long they have worked, and how much memory they have had."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from taxinet_ros.core.types import NS_PER_S

_TICKS_PER_S = os.sysconf('SC_CLK_TCK')
_USER_TIME = 11
"""Place of the processor time in user mode after the name in /proc/PID/stat, see proc(5)."""


def processor_time_ns(pid: int) -> int:
    """Processor time that all threads of a process have used [ns], in steps of 10 ms."""
    # The name, in brackets, may hold anything.
    fields = Path(f'/proc/{pid}/stat').read_text(encoding='utf-8').rpartition(')')[2].split()
    return sum(map(int, fields[_USER_TIME:_USER_TIME + 2])) * NS_PER_S // _TICKS_PER_S


def peak_memory(pids: Iterable[int]) -> int:
    """Most resident memory that each of these processes has had so far, added up [bytes].

    What they share is counted in each of them. A process that is gone counts nothing.
    """
    # getrusage would not do: Linux has a child inherit what its parent had before the exec.
    return sum(_peak(pid) for pid in pids)


def _peak(pid: int) -> int:
    try:
        lines = Path(f'/proc/{pid}/status').read_text(encoding='utf-8').splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return 0
    return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith('VmHWM:'))
