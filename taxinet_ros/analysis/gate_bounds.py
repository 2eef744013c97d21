"""Shares of runs with one-sided bounds, and how many more runs it takes to decide."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from taxinet_ros.campaign.rates import share_bounds
from taxinet_ros.campaign.samplers.estimate import weighted_share

MOST_RUNS = 10**7
"""Beyond so many further runs nobody waits for an answer."""


class Bounds(NamedTuple):
    """A share of runs with its one-sided bounds, as fractions; NaN, 0 and 1 without a run."""

    share: float
    low: float
    high: float


def bounds(good: Sequence[bool], weights: Sequence[float], confidence: float) -> Bounds:
    """Share of good runs under the program's distribution, with one-sided bounds.

    Args:
        good: of each run.
        weights: of each run, above 0.
        confidence: of each bound.
    """
    share, runs = _share(np.array(good, dtype=bool), np.array(weights, dtype=np.float64))
    return Bounds(share, *_one_sided(share, runs, confidence))


def further_runs(
    good: Sequence[bool], weights: Sequence[float], threshold: float, confidence: float
) -> int | None:
    """About how many further runs decide whether the share of good ones is ``threshold``.

    It supposes that the share stays as it is; without a run, that all are good.

    Returns:
        None where the share is the threshold, or more than :data:`MOST_RUNS` would be needed.
    """
    share, runs = _share(np.array(good, dtype=bool), np.array(weights, dtype=np.float64))
    share = 1.0 if math.isnan(share) else share

    def decided(number: float) -> bool:
        low, high = _one_sided(share, number, confidence)
        return low >= threshold or high < threshold

    low, high = int(runs), MOST_RUNS
    if not decided(high):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if decided(middle) else (middle, high)
    # As many as now say as much as ``runs`` independent ones do.
    return math.ceil((high - runs) * (len(good) / runs if runs else 1.0))


def _share(good: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """Weighted share of good runs, and the number of independent runs that know it as well."""
    if not len(weights):
        return math.nan, 0.0
    share, runs = weighted_share(weights, good)
    return share, float(len(weights)) if np.all(weights == 1) else runs


def _one_sided(share: float, runs: float, confidence: float) -> tuple[float, float]:
    if not runs:
        return 0.0, 1.0
    return share_bounds(share * runs, (1 - share) * runs, 1 - confidence)
