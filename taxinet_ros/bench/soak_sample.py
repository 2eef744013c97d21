"""What a process holds at one moment, told by Linux: memory, open files, threads, shared memory."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from taxinet_ros.core.errors import UsageError

_PROC = Path('/proc')
_SHARED = '/dev/shm/'


class Holdings(NamedTuple):
    """What one process, or several together, hold.

    Attributes:
        memory: resident memory [bytes]; what processes share counts in each of them.
        files: open file descriptors.
        threads: threads.
        segments: different files of ``/dev/shm`` mapped into memory; Fast DDS talks through them.
        processes: how many they are.
    """

    memory: int
    files: int
    threads: int
    segments: int
    processes: int


def holdings(pid: int) -> Holdings | None:
    """What a process and all its descendants hold now; None once it is gone.

    Raises:
        UsageError: it is another user's, so Linux does not tell.
    """
    if not _is_alive(pid):
        return None
    found = [told for each in family(pid) if (told := _told(each)) is not None]
    if not found:
        return None
    segments = set[str]().union(*(names for _, _, _, names in found))
    return Holdings(
        memory=sum(told[0] for told in found), files=sum(told[1] for told in found),
        threads=sum(told[2] for told in found), segments=len(segments), processes=len(found),
    )


def family(pid: int) -> list[int]:
    """A process and its descendants as they are now."""
    children: dict[int, list[int]] = {}
    for folder in _PROC.iterdir():
        if folder.name.isdecimal() and (fields := _stat(int(folder.name))):
            children.setdefault(int(fields[1]), []).append(int(folder.name))
    members = [pid]
    for member in members:
        members += children.get(member, [])
    return members


def _is_alive(pid: int) -> bool:
    fields = _stat(pid)
    return bool(fields) and fields[0] not in ('Z', 'X')


def _stat(pid: int) -> list[str]:
    """State, parent and what follows in /proc/PID/stat, see proc(5); nothing if it is gone."""
    try:
        text = (_PROC / str(pid) / 'stat').read_text(encoding='utf-8', errors='replace')
    except (FileNotFoundError, ProcessLookupError):
        return []
    return text.rpartition(')')[2].split()  # the name, in brackets, may hold anything


def _told(pid: int) -> tuple[int, int, int, frozenset[str]] | None:
    """Memory, files, threads and shared-memory names of one process; None if it ends meanwhile."""
    folder = _PROC / str(pid)
    try:
        status = (folder / 'status').read_text(encoding='utf-8', errors='replace').splitlines()
        files = len(os.listdir(folder / 'fd'))
        maps = (folder / 'maps').read_text(encoding='utf-8', errors='replace').splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return None
    except PermissionError:
        raise UsageError(
            f"--pid {pid}: is another user's, so Linux does not tell what it holds"
        ) from None
    memory, threads = _number(status, 'VmRSS:') * 1024, _number(status, 'Threads:')
    return memory, files, threads, _shared(maps)


def _number(status: Iterable[str], field: str) -> int:
    return sum(int(line.split()[1]) for line in status if line.startswith(field))


def _shared(maps: Iterable[str]) -> frozenset[str]:
    return frozenset(line[line.index(_SHARED):] for line in maps if _SHARED in line)
