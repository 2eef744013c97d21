"""Names of the nodes a run needs, without importing ROS."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from taxinet_ros.core.topics import CHAIN, MTL_MONITOR, SIMULATOR
from taxinet_ros.errors import UsageError

REQUIRED = (*CHAIN, MTL_MONITOR)
"""Participants required to execute and judge a run."""


def perception_executable(word: str) -> tuple[str, dict[str, Any]]:
    """Executable and parameters of the shipped node for a perception word or file."""
    return ('ground_truth_perception', {}) if word == 'truth' else (
        'taxinet_perception', {'weights': word}
    )


def check_participants(names: Sequence[str]) -> None:
    """Check that a run has the required participants.

    Raises:
        UsageError: a participant is missing, or one is invalid.
    """
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        given = ', '.join(names) or 'nobody'
        raise UsageError(
            f'participants: a run needs {", ".join(missing)} as well, got only {given}'
        )
    if odd := [name for name in names if not name or name == SIMULATOR]:
        raise UsageError(f'participants: {odd[0]!r} cannot take part in a run; leave it out')
