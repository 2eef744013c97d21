"""Paired comparison of two arms on the same scenes: rates and medians with intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import binomtest, norm, rankdata, wilcoxon

from taxinet_ros.analysis.runs.campaign import ConfidenceInterval

CONFIDENCE = 0.95

_MOST_EXACT, _MOST_RANKED = 60, 4000
"""Maximum numbers of (changed) pairs for exact rank counts, and for ranking all pairs."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PairedRates:
    """A binary result of the same scenes in two arms.

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
        """Number of positive results in the first arm."""
        return self.both + self.only_first

    @property
    def second(self) -> int:
        """Number of positive results in the second arm."""
        return self.both + self.only_second

    @property
    def p_value(self) -> float:
        """McNemar's exact test of whether the two arms differ.

        Only discordant pairs count; under the null both ways are equally likely (Psychometrika
        12, 1947; exact by the binomial distribution). NaN without pairs.
        """
        if not self.pairs:
            return math.nan
        differing = self.only_first + self.only_second
        if not differing:
            return 1.0
        return float(binomtest(self.only_first, differing, 0.5).pvalue)

    def p_at_most(self, unknown: int) -> float:
        """Greatest p value that so many further pairs can leave, whatever their results."""
        first, second = self.only_first, self.only_second
        return replace(
            self, only_first=max(first, min(first + unknown, second)),
            only_second=max(second, min(second + unknown, first)),
        ).p_value

    @property
    def difference(self) -> ConfidenceInterval:
        """Rate of the second arm minus that of the first, with its 95 % interval.

        The interval combines the Wilson intervals of the two rates, with their correlation
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
            excess = max(excess - n / 2, 0.0)  # the method's continuity correction
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
    """Change of a quantity from the first arm to the second.

    Attributes:
        pairs: number of pairs that have it in both arms.
        change: typical difference, second minus first, with its interval.
        more, less: number of pairs in which it grows or shrinks; it is equal in the others.
        grows: whether growth outweighs in the signed ranks; the typical change may be 0.
        p_value: p value of the hypothesis of no change; NaN without pairs.
    """

    pairs: int
    change: ConfidenceInterval
    more: int
    less: int
    grows: bool
    p_value: float


def paired_shift(first: Sequence[float], second: Sequence[float]) -> PairedShift:
    """Compare a quantity over pairs; pairs without it (NaN) in either arm are left out.

    Uses the signed ranks of the differences, so that many negligible ones do not outvote a few
    large ones: Wilcoxon's signed-rank test, the Hodges-Lehmann estimate (the median of the means of
    all two differences) and Tukey's interval (Hollander, Wolfe and Chicken, Nonparametric
    Statistical Methods, 2014, chapter 3). They assume that without a change the differences are
    symmetric about zero. Pairs that are equal in both arms are in no p value, which is exact.
    """
    differences = np.array(second, dtype=np.float64) - np.array(first, dtype=np.float64)
    differences = differences[np.isfinite(differences)]
    more, less = int((differences > 0).sum()), int((differences < 0).sum())
    changes = differences[differences != 0]
    return PairedShift(
        pairs=len(differences), change=_typical(differences), more=more, less=less,
        grows=bool(np.dot(np.sign(changes), rankdata(np.abs(changes))) > 0),
        p_value=_signed_rank_p(changes) if len(differences) else math.nan,
    )


def _signed_rank_p(changes: np.ndarray) -> float:
    """Two-sided p value of Wilcoxon's test of changes other than 0, exact unless many.

    Their ranks, with means for ties, are fixed; under the null each sign is a fair coin.
    """
    if len(changes) > _MOST_EXACT:
        return float(wilcoxon(changes, method='approx').pvalue)
    doubled = np.rint(2 * rankdata(np.abs(changes))).astype(np.int64)
    positive = int(doubled[changes > 0].sum())
    least = min(positive, int(doubled.sum()) - positive)
    return min(1.0, 2 * float(_rank_sums(doubled)[:least + 1].sum()))


def _rank_sums(ranks: np.ndarray) -> np.ndarray:
    """Probability of each sum of the ranks chosen by fair coins; ranks are whole numbers."""
    chance = np.zeros(int(ranks.sum()) + 1)
    chance[0] = 1.0
    for rank in ranks:
        chosen = np.roll(chance, rank)
        chance = (chance + chosen) / 2
    return chance


def _typical(differences: np.ndarray) -> ConfidenceInterval:
    count = len(differences)
    if not count:
        return ConfidenceInterval(math.nan, math.nan, math.nan)
    if count > _MOST_RANKED:  # the means of all two would not fit into memory
        differences = differences[:: -(-count // _MOST_RANKED)]
        count = len(differences)
    one, other = np.triu_indices(count)
    means = np.sort((differences[one] + differences[other]) / 2)
    cut = _rank_cut(count)
    if cut < 0:  # too few for any interval
        return ConfidenceInterval(float(np.median(means)), math.nan, math.nan)
    return ConfidenceInterval(float(np.median(means)), float(means[cut]), float(means[-1 - cut]))


def _rank_cut(count: int) -> int:
    """Number of the smallest means outside the interval; -1 if there is no interval.

    The greatest k with P(signed-rank statistic <= k) at most the tail probability.
    """
    tail = (1 - CONFIDENCE) / 2
    total = count * (count + 1) // 2
    if count > _MOST_EXACT:
        spread = math.sqrt(count * (count + 1) * (2 * count + 1) / 24)
        return math.floor(total / 2 - float(norm.ppf(1 - tail)) * spread - 0.5)
    chance = np.cumsum(_rank_sums(np.arange(1, count + 1)))
    return int(np.searchsorted(chance, tail, side='right')) - 1


def _wilson(k: int, n: int) -> ConfidenceInterval:
    """A share with its Wilson score interval."""
    z = float(norm.ppf((1 + CONFIDENCE) / 2))
    share = k / n
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return ConfidenceInterval(share, min(middle - half, share), max(middle + half, share))


def _joined(one: float, other: float, phi: float) -> float:
    return math.sqrt(max(one * one - 2 * phi * one * other + other * other, 0.0))
