"""Who is there: the processes that another one has started."""

from __future__ import annotations

import contextlib

import psutil


def children(pid: int, word: str) -> dict[int, str]:
    """Processes started by ``pid`` that have a word on their command line, and what is there."""
    found = {}
    with contextlib.suppress(psutil.NoSuchProcess):
        for child in psutil.Process(pid).children():
            with contextlib.suppress(psutil.NoSuchProcess):  # ZombieProcess is one, too
                line = ' '.join(child.cmdline())
                if word in line:
                    found[child.pid] = line
    return found


def gone(pid: int) -> bool:
    """Whether a process is there no more, or only as one that nobody has buried yet."""
    try:
        return psutil.Process(pid).status() in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
    except psutil.NoSuchProcess:
        return True
