"""What a process holds at one moment: memory, open files, threads, shared memory."""

from __future__ import annotations

from typing import NamedTuple

import psutil

from taxinet_ros.core.errors import UsageError

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
    try:
        process = psutil.Process(pid)
        if process.status() in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD):
            return None
        family = [process, *process.children(recursive=True)]
    except psutil.NoSuchProcess:
        return None
    found = [told for member in family if (told := _told(member)) is not None]
    if not found:
        return None
    memory, files, threads, names = zip(*found, strict=True)
    return Holdings(
        sum(memory), sum(files), sum(threads), len(frozenset[str]().union(*names)), len(found)
    )


def _told(process: psutil.Process) -> tuple[int, int, int, frozenset[str]] | None:
    """Memory, files, threads and shared-memory names of one process; None if it ends meanwhile."""
    try:
        with process.oneshot():
            shared = frozenset(
                part.path for part in process.memory_maps() if part.path.startswith(_SHARED)
            )
            return process.memory_info().rss, process.num_fds(), process.num_threads(), shared
    except psutil.NoSuchProcess:
        return None
    except psutil.AccessDenied:
        raise UsageError(
            f"--pid {process.pid}: is another user's, so Linux does not tell what it holds"
        ) from None
