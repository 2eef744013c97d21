"""Paired comparison of two arms on the same scenes: rates and medians with intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest, norm, wilcoxon

CONFIDENCE = 0.95

_MOST_EXACT, _MOST_RANKED = 60, 4000
"""Pairs up to which ranks are counted and not approximated, and up to which all are ranked."""


class ConfidenceInterval(NamedTuple):
    """A figure with its 95 % interval; NaN where it has none."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True, slots=True)
class PairedRates:
    """Yes or no in two arms, of the same scenes.

    Attributes:
        both, only_first, only_second, neither: numbers of pairs.
    """

    both: int
    only_first: int
    only_second: int
    neither: int

    @property
    def pairs(self) -> int:
        """Number of pairs."""
        return self.both + self.only_first + self.only_second + self.neither

    @property
    def first(self) -> int:
        """Number of yeses in the first arm."""
        return self.both + self.only_first

    @property
    def second(self) -> int:
        """Number of yeses in the second arm."""
        return self.both + self.only_second

    @property
    def p_value(self) -> float:
        """McNemar's exact test of whether the two arms differ.

        Only pairs that differ tell, and without a difference each way is as likely (Psychometrika
        12, 1947; exact by the binomial distribution).
        """
        differing = self.only_first + self.only_second
        if not differing:
            return 1.0
        return float(binomtest(self.only_first, differing, 0.5).pvalue)

    @property
    def difference(self) -> ConfidenceInterval:
        """Rate of the second arm less that of the first, with its 95 % interval.

        The interval is put together from Wilson's of the two rates, with their correlation
        (Newcombe, Statistics in Medicine 17, 1998, pp. 2635-2650, method 10).
        """
        n = self.pairs
        if not n:
            return ConfidenceInterval(math.nan, math.nan, math.nan)
        one, other = _wilson(self.second, n), _wilson(self.first, n)
        phi = self._correlation()
        value = one.value - other.value
        below = _joined(one.value - one.low, other.high - other.value, phi)
        above = _joined(one.high - one.value, other.value - other.low, phi)
        return ConfidenceInterval(value, value - below, value + above)

    def _correlation(self) -> float:
        n, a, d = self.pairs, self.both, self.neither
        b, c = self.only_first, self.only_second
        scale = (a + b) * (c + d) * (a + c) * (b + d)
        if not scale:
            return 0.0
        excess: float = a * d - b * c
        if excess > 0:
            excess = max(excess - n / 2, 0.0)  # the method's correction for continuity
        return excess / math.sqrt(scale)


def paired_rates(first: Sequence[bool], second: Sequence[bool]) -> PairedRates:
    """Count the four kinds of pairs."""
    pairs = list(zip(first, second, strict=True))
    return PairedRates(
        both=pairs.count((True, True)), only_first=pairs.count((True, False)),
        only_second=pairs.count((False, True)), neither=pairs.count((False, False)),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class PairedShift:
    """How much a figure changes from the first arm to the second.

    Attributes:
        pairs: that have it in both arms.
        change: typical difference, second less first, with its interval.
        more, less: pairs in which it grows or shrinks; it is equal in the others.
        p_value: of whether there is any.
    """

    pairs: int
    change: ConfidenceInterval
    more: int
    less: int
    p_value: float


def paired_shift(first: Sequence[float], second: Sequence[float]) -> PairedShift:
    """Compare a figure over pairs; those without it (NaN) in either arm are left out.

    By the signed ranks of the differences, so that many that are next to nothing do not outvote a
    few that are great: the test is Wilcoxon's, the typical change is Hodges and Lehmann's, which is
    the median of the means of all two differences, and its interval is Tukey's (Hollander, Wolfe
    and Chicken, Nonparametric Statistical Methods, 2014, chapter 3). They suppose that where
    nothing is changed a difference is as likely as its opposite.
    """
    differences = np.array(second, dtype=np.float64) - np.array(first, dtype=np.float64)
    differences = differences[np.isfinite(differences)]
    more, less = int((differences > 0).sum()), int((differences < 0).sum())
    return PairedShift(
        pairs=len(differences), change=_typical(differences), more=more, less=less,
        p_value=float(wilcoxon(differences).pvalue) if more + less else 1.0,
    )


def _typical(differences: np.ndarray) -> ConfidenceInterval:
    count = len(differences)
    if not count:
        return ConfidenceInterval(math.nan, math.nan, math.nan)
    if count > _MOST_RANKED:  # the means of all two would not fit into the memory
        differences = differences[:: -(-count // _MOST_RANKED)]
        count = len(differences)
    one, other = np.triu_indices(count)
    means = np.sort((differences[one] + differences[other]) / 2)
    cut = _rank_cut(count)
    if cut < 0:  # too few for any interval
        return ConfidenceInterval(float(np.median(means)), math.nan, math.nan)
    return ConfidenceInterval(float(np.median(means)), float(means[cut]), float(means[-1 - cut]))


def _rank_cut(count: int) -> int:
    """How many of the least means lie outside the interval; -1 where there is none.

    The greatest number k with P(signed-rank statistic <= k) within the tail, less what is inside.
    """
    tail = (1 - CONFIDENCE) / 2
    total = count * (count + 1) // 2
    if count > _MOST_EXACT:
        spread = math.sqrt(count * (count + 1) * (2 * count + 1) / 24)
        return math.floor(total / 2 - float(norm.ppf(1 - tail)) * spread - 0.5)
    ways = np.zeros(total + 1)
    ways[0] = 1.0
    for rank in range(1, count + 1):
        ways[rank:] += ways[:-rank].copy()
    chance = np.cumsum(ways) / 2.0**count
    return int(np.searchsorted(chance, tail, side='right')) - 1


def _wilson(k: int, n: int) -> ConfidenceInterval:
    """A share with Wilson's score interval."""
    z = float(norm.ppf((1 + CONFIDENCE) / 2))
    share = k / n
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return ConfidenceInterval(share, min(middle - half, share), max(middle + half, share))


def _joined(one: float, other: float, phi: float) -> float:
    return math.sqrt(max(one * one - 2 * phi * one * other + other * other, 0.0))
