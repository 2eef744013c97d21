"""How near to the centreline runs keep once they have had time to get there."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.reader import decoded_messages
from taxinet_ros.bag.run.topics import SCENARIO, TRUTH, is_topic
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError

SETTLED_AFTER_S = 10.0
"""The ten seconds that phi_eventually gives a run to reach the centreline (paper, section 3.2)."""


def settled_cross_track_m(folder: Path, runs: Iterable[str]) -> np.ndarray:
    """Median |cross-track error| [m] of each run after its first ten seconds, from its bag.

    Args:
        folder: of the campaign.
        runs: their ids.

    Returns:
        One value for each run; NaN where the bag is gone or damaged, or the run was shorter.

    Raises:
        UsageError: a bag is of another run.
    """
    return np.array([_settled_m(folder / run) for run in runs], dtype=np.float64)


def _settled_m(bag: Path) -> float:
    if not bag.is_dir():
        return math.nan
    try:
        late = [
            abs(message.cross_track_error)
            for topic, stamp_ns, message in decoded_messages(bag, _is_wanted)
            if _is_of(bag, topic, message) and stamp_ns >= SETTLED_AFTER_S * NS_PER_S
        ]
    except (BagError, AttributeError):
        return math.nan
    return float(np.median(late)) if late else math.nan


def _is_wanted(topic: str) -> bool:
    return is_topic(topic, TRUTH) or is_topic(topic, SCENARIO)


def _is_of(bag: Path, topic: str, message: Any) -> bool:
    """Whether a message is a truth; raises where another says that the bag is of another run."""
    if is_topic(topic, TRUTH):
        return True
    if str(message.run_id) != bag.name:
        raise UsageError(
            f'{bag}: is of run {message.run_id}; was the folder moved here? taxinet doctor '
            f'{bag.parent} checks all of them'
        )
    return False
