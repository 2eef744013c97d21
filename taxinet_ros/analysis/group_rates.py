"""Failure rates of groups of runs, drawn or chosen by a sampler, and how two of them differ."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from taxinet_ros.campaign.rates import CONFIDENCE, share_bounds
from taxinet_ros.campaign.samplers.estimate import Estimate, estimate_rate

_FEW = 5

Mask = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]


class GroupRate(NamedTuple):
    """How often runs of a group fail.

    Attributes:
        runs, failures: as they were made.
        rate, low, high: share of failures under the program's own distribution with its 95 %
            interval. Where the weight of a run is not known, the share of the runs as they were
            made, and NaN for the ends.
        effective: number of independent runs that would say as much; NaN where not known.
    """

    runs: int
    failures: int
    rate: float
    low: float
    high: float
    effective: float

    def words(self) -> str:
        """Rate and interval, such as ``49.9 % (48.3–51.5 %)``."""
        if not self.runs:
            return 'no run'
        if math.isnan(self.low):
            return f'{self.rate:.1%} of the runs made'.replace('%', ' %')
        return f'{self.rate:.1%} ({100 * self.low:.1f}–{self.high:.1%})'.replace('%', ' %')


def group_rate(failed: Mask, weight: Floats) -> GroupRate:
    """Rate of the runs in a group.

    Args:
        failed: of each run.
        weight: density of the program over the sampler's, NaN where it is not known.
    """
    runs, failures = len(failed), int(np.count_nonzero(failed))
    known = [None if math.isnan(one) else float(one) for one in weight]
    found = estimate_rate(np.where(failed, -1.0, 1.0).tolist(), known)
    if found is None or not runs:
        share = failures / runs if runs else math.nan
        return GroupRate(runs, failures, share, math.nan, math.nan, math.nan)
    if found.effective < runs and min(failures, runs - failures) < _FEW:
        return _of_few(runs, failures, found)
    return GroupRate(runs, failures, *found.rate, found.effective)


def _of_few(runs: int, failures: int, found: Estimate) -> GroupRate:
    """The interval that as many independent runs as these weights are worth would give.

    The variance of a weighted share is itself not known from a handful of failures.
    """
    share = found.rate.rate
    low, high = share_bounds(
        share * found.effective, (1 - share) * found.effective, (1 - CONFIDENCE) / 2
    )
    return GroupRate(runs, failures, share, low, high, found.effective)


class Difference(NamedTuple):
    """A rate less another, with its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def clear(self) -> bool:
        """Whether the interval leaves no doubt of the sign."""
        return self.low > 0 or self.high < 0


def difference(one: GroupRate, other: GroupRate) -> Difference:
    """How much higher the rate of ``one`` is than that of another, independent group.

    The interval is put together from those of the two rates (Newcombe, Statistics in Medicine 17,
    1998, method 10; for any intervals Zou and Donner, Statistics in Medicine 27, 2008).
    """
    value = one.rate - other.rate
    below = math.hypot(one.rate - one.low, other.high - other.rate)
    above = math.hypot(one.high - one.rate, other.rate - other.low)
    return Difference(value, value - below, value + above)
