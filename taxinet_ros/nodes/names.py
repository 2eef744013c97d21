"""Which nodes a run needs. That needs no ROS, whose import takes a while."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from taxinet_ros.core.topics import CHAIN, MTL_MONITOR, SIMULATOR
from taxinet_ros.errors import UsageError

REQUIRED = (*CHAIN, MTL_MONITOR)
"""Participants without which no run can go on, or be judged."""


def perception_executable(word: str) -> tuple[str, dict[str, Any]]:
    """Executable and parameters of our node that is the perception of a word or file."""
    return ('ground_truth_perception', {}) if word == 'truth' else (
        'taxinet_perception', {'weights': word}
    )


def check_participants(names: Sequence[str]) -> None:
    """See that a run has whom it needs.

    Raises:
        UsageError: names who is missing, or who cannot be one.
    """
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        given = ', '.join(names) or 'nobody'
        raise UsageError(f'participants: a run needs {", ".join(missing)} too, not only {given}')
    if odd := [name for name in names if not name or name == SIMULATOR]:
        raise UsageError(f'participants: {odd[0]!r} takes part in no run; leave it out')
