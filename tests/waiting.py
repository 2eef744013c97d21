"""Waiting in tests. What hangs is ended by the suite's own limit, pytest's ``timeout``, alone."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

PATIENT_S = 600.0
"""For limits of the bench itself that are not what a test is about [s]."""


def wait_for(condition: Callable[[], object], what: Callable[[], str] = lambda: '') -> None:
    """Look until something is so; ``what`` says, where it never is, what there is instead."""
    try:
        while not condition():
            time.sleep(0.01)
    except pytest.fail.Exception as limit:
        raise AssertionError(f'it was never so: {what()}') from limit
