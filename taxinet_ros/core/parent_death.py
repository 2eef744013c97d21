"""Linux's way to end a process when its parent goes, however it goes, see prctl(2)."""

from __future__ import annotations

import ctypes
import signal

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36

_prctl = ctypes.CDLL(None).prctl
"""Looked up here, for between fork and exec there is no time for it."""


def die_with_parent(number: signal.Signals) -> None:
    """Have this process sent a signal once its parent has gone; not if it went before."""
    _prctl(_PR_SET_PDEATHSIG, number)


def adopt_orphans() -> None:
    """Have whatever this process's descendants leave behind become its children, not init's."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
