"""Child processes: their environment, limits that they set themselves, their parent's death.

Limits of the operating system (setrlimit(2)) hold in native code, too, which no timer of Python's
interrupts. A process sets them before it touches what it is to be protected from. A child can ask
Linux to end it when its parent goes, however it goes (prctl(2)).
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
from pathlib import Path

import taxinet_ros


def child_environment() -> dict[str, str]:
    """This very package, the same hash order every time, and no idle threads for matrices."""
    here = str(Path(taxinet_ros.__file__).resolve().parents[1])
    path = os.pathsep.join(part for part in (here, os.environ.get('PYTHONPATH', '')) if part)
    fixed = {'PYTHONPATH': path, 'PYTHONHASHSEED': '0'}
    return {**os.environ, **fixed, 'OPENBLAS_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1'}


def fill_standard_descriptors() -> None:
    """Have 0, 1 and 2 be open, so that no file or pipe of ours becomes a standard stream."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)


def limit_memory(most_bytes: int) -> None:
    """Let this process have at most so much address space; beyond it, asking for more fails."""
    _lower(resource.RLIMIT_AS, most_bytes)


def limit_cpu(most_s: int) -> None:
    """Let this process take at most so much processor time in all; SIGXCPU ends it then."""
    _lower(resource.RLIMIT_CPU, most_s)


def _lower(limit: int, value: int) -> None:
    _, hard = resource.getrlimit(limit)
    resource.setrlimit(limit, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))


_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
_prctl = ctypes.CDLL(None).prctl
"""Looked up here, for between fork and exec there is no time for it."""


def die_with_parent(number: signal.Signals) -> None:
    """Have this process sent a signal once its parent has gone; not if it went before."""
    _prctl(_PR_SET_PDEATHSIG, number)


def adopt_orphans() -> None:
    """Have whatever this process's descendants leave behind become its children, not init's."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
