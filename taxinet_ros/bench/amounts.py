"""What is no time: bytes on disk and in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

Amounts = dict[str, Callable[[], float]]
"""What tells an amount [bytes] once all is measured, by name; NaN where there is none."""


def folder_bytes(folder: Path) -> int:
    """Size of all the files in a folder [bytes]."""
    return sum(file.stat().st_size for file in folder.rglob('*') if file.is_file())


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
