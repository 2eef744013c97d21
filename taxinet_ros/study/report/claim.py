"""How statements of the paper are judged on our runs: tests of each, and Holm's rule over all.

Figures of two different worlds need not agree. What can be compared is the kind: which of two
things is greater, or whether something happens mostly. Each statement is either true or false of
our networks in our world, and is tested from both sides: how likely are runs like ours, at most, if
it is false, and if it is true? All these tests are one family (Holm, Scandinavian Journal of
Statistics 6, 1979, pp. 65-70), so that in at most 5 % of studies any verdict at all is wrong,
however the tests depend on each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.stats import binom, brunnermunzel, hypergeom, mannwhitneyu, norm
from scipy.stats import t as student

from taxinet_ros.analysis.experiment.pairs import PairedRates

SIGNIFICANT = 0.05
"""Probability that any verdict of a study is wrong."""


_LEAST_VALUES = 3
_LEAST_ERROR = 1e-9
"""Standard error of a mean below which values are the same but for rounding."""


class Verdict(Enum):
    """How our runs stand to a statement of the paper."""

    AGREES = 'in kind as in the paper'
    DIFFERS = 'not as in the paper'
    UNCLEAR = 'not clear from these runs'


class Sides(NamedTuple):
    """Greatest probability of runs like ours, or plainer ones, if a statement is false or true.

    Attributes:
        if_false: a small one speaks for the statement.
        if_true: a small one speaks against it.
    """

    if_false: float
    if_true: float

    @property
    def opposite(self) -> Sides:
        """Those of the opposite statement."""
        return Sides(self.if_true, self.if_false)


NOTHING_KNOWN = Sides(1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Question:
    """A statement of the paper, and what our runs say of it.

    Attributes:
        name: unique, for files.
        statement: what the paper says, with its figures, as it is tested.
        source: where it stands there.
        evidence: our figures, with 95 % intervals and numbers of runs.
        sides: its tests.
    """

    name: str
    statement: str
    source: str
    evidence: str
    sides: Sides


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A statement of the paper, judged.

    Attributes:
        name, statement, source, evidence: as of its :class:`Question`.
        verdict: ours.
        p_value: of the nearer verdict, adjusted for all statements (Holm).
    """

    name: str
    statement: str
    source: str
    verdict: Verdict
    evidence: str
    p_value: float

    def sentence(self) -> str:
        """The whole in words."""
        verdict = self.verdict.value[0].upper() + self.verdict.value[1:]
        return (
            f'{verdict} (p {p_words(self.p_value)}): {self.statement} ({self.source}). '
            f'Here: {self.evidence}'
        )


def judge(questions: Sequence[Question]) -> tuple[Claim, ...]:
    """The verdicts of all questions of a study together."""
    sides = [side for question in questions for side in question.sides]
    adjusted = holm(sides)
    claims = []
    for question, if_false, if_true in zip(
        questions, adjusted[::2], adjusted[1::2], strict=True
    ):
        p_value = min(if_false, if_true)
        verdict = Verdict.AGREES if if_false < if_true else Verdict.DIFFERS
        claims.append(Claim(
            name=question.name, statement=question.statement, source=question.source,
            evidence=question.evidence, p_value=p_value,
            verdict=verdict if p_value <= SIGNIFICANT else Verdict.UNCLEAR,
        ))
    return tuple(claims)


def holm(p_values: Sequence[float]) -> list[float]:
    """The p values of a family, adjusted by Holm's step-down rule."""
    found = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(found, kind='stable')
    stepped = found[order] * np.arange(len(found), 0, -1)
    adjusted = np.empty_like(found)
    adjusted[order] = np.minimum(np.maximum.accumulate(stepped), 1.0)
    return [float(one) for one in adjusted]


# Tests -------------------------------------------------------------------------------------------


def share_above(hits: int, count: int, share: float) -> Sides:
    """Whether a probability is above ``share``: the binomial test, exact."""
    return Sides(
        float(binom.sf(hits - 1, count, share)), float(binom.cdf(hits, count, share))
    ) if count else NOTHING_KNOWN


def mostly(hits: int, others: int) -> Sides:
    """Whether something happens in more than half of the cases: the sign test, exact."""
    return share_above(hits, hits + others, 0.5)


def more_often(first: np.ndarray, second: np.ndarray) -> Sides:
    """Whether something happens more often in one group than in another: Fisher's exact test.

    Args:
        first: in which cases of the one group it happens.
        second: in which of the other.
    """
    hits, total = int(first.sum()), len(first) + len(second)
    both = hits + int(second.sum())
    return Sides(
        float(hypergeom.sf(hits - 1, total, both, len(first))),
        float(hypergeom.cdf(hits, total, both, len(first))),
    )


def pairs_more_often(rates: PairedRates) -> Sides:
    """Whether the second of two arms says yes more often: McNemar's exact test."""
    return mostly(rates.only_second, rates.only_first)


def mean_above(values: Sequence[float], level: float) -> Sides:
    """Whether a mean is above ``level``: Student's t; two values say too little of their spread."""
    if len(values) < _LEAST_VALUES:
        return NOTHING_KNOWN
    error = max(float(np.std(values, ddof=1)) / math.sqrt(len(values)), _LEAST_ERROR)
    distance = (float(np.mean(values)) - level) / error
    return Sides(
        float(student.sf(distance, len(values) - 1)), float(student.cdf(distance, len(values) - 1))
    )


def mostly_lower(first: np.ndarray, second: np.ndarray) -> Sides:
    """Whether a figure is mostly lower in one group than in another.

    True where a value of the one group is below one of the other more often than above it. The
    greater p of two tests counts: of Brunner and Munzel (Biometrical Journal 42, 2000, pp. 17-25),
    right where the groups spread differently, and of Mann and Whitney, right where they are small.
    """
    if min(len(first), len(second)) < 2:
        return NOTHING_KNOWN
    apart = 1.0 / math.comb(len(first) + len(second), len(first))  # by permutation, exact
    if first.max() < second.min():
        return Sides(apart, 1.0)
    if second.max() < first.min():
        return Sides(1.0, apart)
    if np.ptp(first) == np.ptp(second) == 0.0:
        return NOTHING_KNOWN
    below = float(brunnermunzel(first, second, alternative='less').pvalue)
    return Sides(*(
        max(one, float(mannwhitneyu(first, second, alternative=side).pvalue))
        for one, side in ((below, 'less'), (1.0 - below, 'greater'))
    ))


def evenly_often(groups: Sequence[np.ndarray], margin: float) -> Sides:
    """Whether something happens as often in each group as in the rest, but for a margin.

    Both sides of each difference are tested against the margin, with one hit and one miss added to
    each group (Agresti and Caffo, American Statistician 54, 2000, pp. 280-288). That all
    differences are within it needs each test; that one is beyond it, one of them, times their
    number.
    """
    inside, beyond = [], []
    for number, group in enumerate(groups):
        others = [other for at, other in enumerate(groups) if at != number]
        rest = np.concatenate(others) if others else np.zeros(0, bool)
        shares = [(one.sum() + 1) / (len(one) + 2) for one in (group, rest)]
        spread = math.sqrt(sum(
            share * (1 - share) / (len(one) + 2)
            for share, one in zip(shares, (group, rest), strict=True)
        ))
        for difference in (shares[0] - shares[1], shares[1] - shares[0]):
            inside.append(float(norm.cdf((difference - margin) / spread)))
            beyond.append(float(norm.sf((difference - margin) / spread)))
    return Sides(max(inside), min(1.0, len(beyond) * min(beyond)))


def all_of(parts: Sequence[Sides]) -> Sides:
    """Whether several things are true together: each has to be shown, one false one is enough."""
    return Sides(
        max(part.if_false for part in parts),
        min(1.0, len(parts) * min(part.if_true for part in parts)),
    )


def p_words(p_value: float) -> str:
    """Display text of a p value."""
    return f'{p_value:.2g}' if p_value >= 1e-4 else '< 0.0001'
