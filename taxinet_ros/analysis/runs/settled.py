"""Cross-track error of runs after they have had time to reach the centreline."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.types import NS_PER_S

_AFTER_S, _LEAST_S = 1.0, 2.0
SETTLED_AFTER_S = 10.0
"""The ten seconds that phi_eventually gives a run to reach the centreline (paper, section 3.2)."""


def deciding_steps(cte_m: NDArray[np.float64], t_s: NDArray[np.float64]) -> int:
    """Number of steps that decided whether an aircraft stays at its line.

    They end a second after it was last on the line, or nearest to it, and not within two seconds:
    what is seen from farther away is a consequence.

    Args:
        cte_m: true cross-track error at each step, while on the pavement.
        t_s: simulated times.
    """
    away = np.abs(cte_m)
    near = np.flatnonzero(away <= max(CENTRELINE_TOLERANCE_M, np.nanmin(away, initial=np.inf)))
    if not len(near):
        return len(away)
    last_s = max(t_s[near[-1]] + _AFTER_S, t_s[0] + _LEAST_S)
    return int(np.searchsorted(t_s[:len(away)], last_s, side='right'))


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
