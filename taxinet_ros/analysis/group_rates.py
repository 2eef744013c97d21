"""Failure rates of groups of runs, drawn or chosen by a sampler, and how two of them differ."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from taxinet_ros.campaign.rates import rate

Mask = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]


class GroupRate(NamedTuple):
    """How often runs of a group fail.

    Attributes:
        runs, failures: as they were made.
        rate, low, high: share of failures under the program's own distribution with its 95 %
            interval, of the runs that the program itself drew. Where none was, the share of the
            runs as they were made, and NaN for the ends.
        effective: number of runs that the interval is of; NaN where there is none.
    """

    runs: int
    failures: int
    rate: float
    low: float
    high: float
    effective: float

    def words(self) -> str:
        """Rate and interval, such as ``49.9 % (48.3–51.5 %)``."""
        return rate_words(self.runs, self.rate, self.low, self.high)


def rate_words(runs: int, rate: float, low: float, high: float) -> str:
    """Rate and interval of so many runs; ``low`` is NaN where there is no interval."""
    if not runs:
        return 'no run'
    if math.isnan(low):
        return f'{rate:.1%} of the runs made'.replace('%', ' %')
    return f'{rate:.1%} ({100 * low:.1f}–{high:.1%})'.replace('%', ' %')


def group_rate(failed: Mask, weight: Floats, *, anytime: bool = False) -> GroupRate:
    """Rate of the runs in a group that was chosen without a look at who failed.

    Args:
        failed: of each run.
        weight: 1 where the program itself drew the run, else 0, or NaN where that is not known.
        anytime: the number of runs was not settled beforehand (:mod:`taxinet_ros.campaign.rates`).
    """
    runs, failures = len(failed), int(np.count_nonzero(failed))
    drawn = weight == 1
    number = int(np.count_nonzero(drawn))
    if not runs:
        return GroupRate(0, 0, *rate(0, 0), 0.0)
    if not number:
        return GroupRate(runs, failures, failures / runs, math.nan, math.nan, math.nan)
    found = rate(int(np.count_nonzero(failed & drawn)), number, anytime=anytime)
    return GroupRate(runs, failures, *found, float(number))


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
