"""Whether what a process holds stays as it is: a slope through samples, once it has warmed up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

WARM_UP = 0.2
"""Share of the runs, or of the time, at the beginning that do not count: caches fill there."""

LEAST_SAMPLES = 12
"""Samples after the warm-up without which nothing is concluded."""

MOST_SAMPLES = 400
"""Samples that are kept; beyond them every other one goes, so that looking costs nothing more."""

FLAT, GROWS, UNSETTLED = 'flat', 'grows', 'too short to tell'


@dataclass(frozen=True, kw_only=True)
class Trend:
    """How one quantity went.

    Attributes:
        first, warm, last, most: at the beginning, after the warm-up, at the end, and at most.
        slope: after the warm-up, per run or per second.
        growth: by this slope, from the warm-up to the end.
        verdict: :data:`FLAT`, :data:`GROWS` or :data:`UNSETTLED`.
    """

    first: float
    warm: float
    last: float
    most: float
    slope: float
    growth: float
    verdict: str


class Series:
    """Samples along an axis, evenly thinned out so that there are never very many."""

    def __init__(self) -> None:
        """Begin without samples."""
        self.at: list[float] = []
        self.rows: list[tuple[float, ...]] = []
        self._every = 1
        self._asked = 0

    def add(self, at: float, row: Sequence[float]) -> None:
        """Take a sample, unless it would be one of those that are thinned out."""
        if self._asked % self._every == 0:
            self.at.append(at)
            self.rows.append(tuple(row))
        self._asked += 1
        if len(self.at) > MOST_SAMPLES:
            self.at, self.rows = self.at[::2], self.rows[::2]
            self._every *= 2


def trend(at: Sequence[float], values: Sequence[float], *, per_unit: float, once: float) -> Trend:
    """The trend of one quantity.

    Args:
        at: runs or seconds, ascending, one or more.
        values: as many.
        per_unit: slope that still counts as flat.
        once: growth that still counts as flat, however steep.
    """
    x, y = np.asarray(at, float), np.asarray(values, float)
    warm = x >= x[0] + WARM_UP * (x[-1] - x[0])
    x, y = x[warm], y[warm]
    # Theil's and Sen's: the median slope between pairs of points, which a few outliers do not move.
    slope = float(stats.theilslopes(y, x).slope) if x[-1] > x[0] else 0.0
    growth = slope * float(x[-1] - x[0])
    if len(x) < LEAST_SAMPLES:
        verdict = UNSETTLED
    else:
        verdict = GROWS if slope > per_unit and growth > once else FLAT
    return Trend(
        first=float(values[0]), warm=float(y[0]), last=float(y[-1]), most=float(max(values)),
        slope=slope, growth=growth, verdict=verdict,
    )
