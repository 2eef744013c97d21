"""Cross-track error of runs after they have had time to reach the centreline."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.types import NS_PER_S

SETTLED_AFTER_S = 10.0
"""The ten seconds that phi_eventually gives a run to reach the centreline (paper, section 3.2)."""


def settled_cross_track_m(folder: Path, runs: Iterable[str]) -> np.ndarray:
    """Median |cross-track error| [m] of each run after its first ten seconds, from its bag.

    Args:
        folder: folder of the campaign.
        runs: run ids.

    Returns:
        One value per run; NaN if the bag is missing or damaged, or the run was shorter.

    Raises:
        UsageError: a bag belongs to another run.
    """
    return np.array([_settled_m(folder / run) for run in runs], dtype=np.float64)


def _settled_m(bag: Path) -> float:
    if not bag.is_dir():
        return math.nan
    try:
        recording = open_recording(bag)
        recording.check_is(bag.name)
        trace = recording.columns
    except BagError:
        return math.nan
    late = trace['t_ns'].astype(np.int64) >= SETTLED_AFTER_S * NS_PER_S
    return float(np.median(np.abs(trace['cte_m'][late]))) if late.any() else math.nan
