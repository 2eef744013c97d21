"""How many runs satisfied the specification, and how sure that is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.outcome import Outcome

CONFIDENCE = 0.95


class Rate(NamedTuple):
    """A share of runs with its confidence interval, all as fractions 0..1."""

    rate: float
    low: float
    high: float


def share_bounds(hits: float, misses: float, tail: float) -> tuple[float, float]:
    """Ends of a Clopper-Pearson interval of a share.

    Args:
        hits: runs that count; a fraction where runs are weighted.
        misses: runs that do not.
        tail: probability that is left out at each end, 0.025 for an interval of 95 %.
    """
    # A third of a second to import, which no run's first step is to wait for. It is the quantile
    # of scipy.stats.beta, to the last bit, which would take ten times that.
    from scipy.special import betaincinv

    low = float(betaincinv(hits, misses + 1, tail)) if hits > 0 else 0.0
    high = float(betaincinv(hits + 1, misses, 1 - tail)) if misses > 0 else 1.0
    return low, high


def rate(k: int, n: int) -> Rate:
    """Share ``k`` of ``n`` independent runs with its 95 % Clopper-Pearson interval.

    The interval is the exact one (Clopper and Pearson, Biometrika 26, 1934): it holds the true
    rate at least 95 times in 100, for small ``n`` too. It is meant for runs drawn from the
    program's own distribution, not for those of an active sampler.

    Args:
        k: runs that count, 0..n.
        n: runs that were judged; with none the rate is NaN and the interval everything.

    Raises:
        ValueError: ``k`` is not within 0..n.
    """
    if not 0 <= k <= n:
        raise ValueError(f'{k} of {n} is no share')
    low, high = share_bounds(k, n - k, (1 - CONFIDENCE) / 2)
    return Rate(rate=k / n if n else math.nan, low=low, high=high)


def satisfied(rows: Sequence[RunRow]) -> Rate:
    """Share of a campaign's judged runs that passed, so that no broken run hides in it."""
    judged = [row for row in rows if row.outcome.judged]
    return rate(sum(row.outcome is Outcome.PASS for row in judged), len(judged))
