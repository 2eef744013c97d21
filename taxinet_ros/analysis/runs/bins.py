"""Bins of a feature with round edges, and the failure rate in each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from taxinet_ros.analysis.runs.campaign import CampaignRuns, GroupRate
from taxinet_ros.analysis.runs.features import RAIN, Feature, Floats, Mask, kinds_present

MOST_BINS = 12
_RUNS_PER_BIN = 8


@dataclass(frozen=True, kw_only=True)
class Bin:
    """A bin of a feature's values.

    Attributes:
        label: display text.
        low, high: displayed ends of numbers; equal for a single value, NaN for a word.
        start, stop: a number of the bin is at least ``start`` and below ``stop``; NaN for a word.
        mask: the runs in the bin.
    """

    label: str
    low: float
    high: float
    start: float = math.nan
    stop: float = math.nan
    mask: Mask

    @property
    def middle(self) -> float:
        """Halfway between the ends."""
        return (self.low + self.high) / 2

    def holds(self, values: npt.NDArray[Any]) -> Mask:
        """Mask of the values in the bin, which may be those of other runs."""
        if math.isnan(self.low):
            return np.asarray(values == self.label, bool)
        return np.asarray((values >= self.start) & (values < self.stop), bool)


def bins(feature: Feature, frame: pd.DataFrame, most: int = MOST_BINS) -> list[Bin]:
    """Cut a feature into bins, as many as the number of runs allows; words without runs have none.

    Args:
        feature: any feature.
        frame: the runs.
        most: maximum number of bins.
    """
    if not feature.numeric:
        return [
            Bin(label=kind, low=math.nan, high=math.nan,
                mask=(frame[feature.name] == kind).to_numpy(dtype=bool))
            for kind in kinds_present(feature, frame)
        ]
    values = frame[feature.name].to_numpy(dtype=np.float64)
    dry = values == 0
    if feature.name != RAIN.name or not dry.any():
        return _numbered(feature, values, most)
    # Two thirds of the runs have no rain; they get a separate bin.
    wet = [] if dry.all() else _numbered(feature, values, most - 1, above=_ABOVE_ZERO)
    return [_single('0', 0.0, values), *wet]


def bin_rates(runs: CampaignRuns, feature: Feature) -> list[tuple[Bin, GroupRate]]:
    """The failure rate of each bin of a feature."""
    return [(one, runs.rate(one.mask)) for one in bins(feature, runs.frame)]


def medians(
    x: Floats, y: Floats, width: float, least: int | None = None
) -> tuple[Floats, Floats, Floats]:
    """Median of ``y`` in bins of ``x``.

    Args:
        x: values of the runs.
        y: values of the runs; NaN is left out.
        width: width of a bin; bin ends are multiples of it.
        least: minimum number of runs per bin; None for 5, or 1 if there are few runs in all.

    Returns:
        Centres of the bins, their medians (NaN for a gap) and numbers of runs.
    """
    known = ~np.isnan(y)
    x, y = x[known], y[known]
    if not len(x):
        return np.empty(0), np.empty(0), np.empty(0)
    if least is None:
        least = 5 if len(x) >= 10 * _RUNS_PER_BIN else 1
    # The last value of a range belongs to the bin below it.
    place = np.floor(x / width + 1e-9).astype(int)
    place[(x == x.max()) & (place > place.min()) & (place * width == x)] -= 1
    numbers = np.arange(place.min(), place.max() + 1)
    counts = np.array([(place == number).sum() for number in numbers])
    middle = np.array([
        np.median(y[place == number]) if count >= least else math.nan
        for number, count in zip(numbers, counts, strict=True)
    ])
    return (numbers + 0.5) * width, middle, counts.astype(np.float64)


_ABOVE_ZERO = math.nextafter(0.0, 1.0)
_SLACK = 1e-6
"""Share of a bin's width by which a value may lie beyond the outermost edge: a conversion of units
adds a last bit."""


def _single(label: str, value: float, values: Floats) -> Bin:
    return Bin(label=label, low=value, high=value, start=value,
               stop=math.nextafter(value, math.inf), mask=values == value)


def _numbered(
    feature: Feature, values: Floats, most: int, above: float = -math.inf
) -> list[Bin]:
    """Bins of the values from ``above`` on."""
    some = values[values >= above]
    least, greatest = float(some.min()), float(some.max())
    if least == greatest:
        return [_single(feature.value_words(least), least, values)]
    edges = _edges(feature, least, greatest, min(most, max(1, len(some) // _RUNS_PER_BIN)))
    limits = list(edges)
    limits[0] = max(edges[0] - _SLACK * (edges[1] - edges[0]), above)
    limits[-1] += _SLACK * (edges[-1] - edges[-2])
    found = []
    for ends, (start, stop) in zip(
        itertools.pairwise(edges), itertools.pairwise(limits), strict=True
    ):
        label = ' to '.join(map(feature.value_words, ends))
        found.append(Bin(
            label=label, low=ends[0], high=ends[1], start=start, stop=stop,
            mask=(values >= start) & (values < stop),
        ))
    return found


def _edges(feature: Feature, least: float, most: float, bins_at_most: int) -> Sequence[float]:
    for width in feature.widths:
        first, last = math.floor(least / width + 1e-9), math.ceil(most / width - 1e-9)
        if last - first <= bins_at_most:
            break
    else:
        # A single bin ends where the runs do, not at midnight: 06:00 to 18:00, not 00:00 to 24:00.
        width = feature.widths[0]
        ends = math.floor(least / width + 1e-9), math.ceil(most / width - 1e-9)
        return [end * width for end in ends]
    return [number * width for number in range(first, max(last, first + 1) + 1)]
