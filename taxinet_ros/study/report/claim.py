"""Statistical tests of the paper's statements on our runs, with Holm's correction.

Numbers from two different worlds need not agree; only qualitative statements can be compared: which
of two quantities is greater, or whether something happens mostly. Each statement is either true or
false of our networks in our world and is tested from both sides: what is the greatest probability
of runs like ours if it is false, and if it is true? All these tests form one family (Holm,
Scandinavian Journal of Statistics 6, 1979, pp. 65-70), so in at most 5 % of studies any verdict is
wrong, whatever the dependence between the tests. That holds of runs whose number was fixed
beforehand, and as far as the p values do: all are exact but those of :func:`mostly_lower`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.special import xlogy
from scipy.stats import binom, brunnermunzel, hypergeom, mannwhitneyu

from taxinet_ros.analysis.experiment.pairs import PairedRates
from taxinet_ros.analysis.runs.campaign import holm

SIGNIFICANT = 0.05
"""Probability that any verdict of a study is wrong."""
_CHANCES = 501
"""Chances between 0 and 1 that are tried for one that nobody knows."""


class Verdict(Enum):
    """Verdict of our runs on a statement of the paper."""

    AGREES = 'in kind as in the paper'
    DIFFERS = 'not as in the paper'
    UNCLEAR = 'not clear from these runs'


class Sides(NamedTuple):
    """P values of both sides: greatest probability of runs at least as extreme as ours.

    Attributes:
        if_false: value if the statement is false; a small one supports the statement.
        if_true: value if it is true; a small one contradicts it.
    """

    if_false: float
    if_true: float

    @property
    def opposite(self) -> Sides:
        """The sides of the opposite statement."""
        return Sides(self.if_true, self.if_false)


NOTHING_KNOWN = Sides(1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A statement of the paper, with the evidence of our runs, and its verdict once judged.

    Attributes:
        name: unique name, for files.
        statement: the paper's statement with its figures, as tested.
        source: its place in the paper.
        evidence: our figures, with 95 % intervals and numbers of runs.
        sides: its p values.
        verdict: our verdict.
        p_value: p value of the more likely verdict, adjusted for all statements (Holm).
    """

    name: str
    statement: str
    source: str
    evidence: str
    sides: Sides
    verdict: Verdict = Verdict.UNCLEAR
    p_value: float = 1.0

    def sentence(self) -> str:
        """Display text of the claim."""
        verdict = self.verdict.value[0].upper() + self.verdict.value[1:]
        return (
            f'{verdict} (p {p_words(self.p_value)}): {self.statement} ({self.source}). '
            f'Here: {self.evidence}'
        )


def judge(claims: Sequence[Claim]) -> tuple[Claim, ...]:
    """Judge all statements of a study as one family."""
    adjusted = holm([side for claim in claims for side in claim.sides])
    judged = []
    for claim, if_false, if_true in zip(claims, adjusted[::2], adjusted[1::2], strict=True):
        p_value = min(if_false, if_true)
        verdict = Verdict.AGREES if if_false < if_true else Verdict.DIFFERS
        judged.append(replace(
            claim, p_value=p_value, verdict=verdict if p_value <= SIGNIFICANT else Verdict.UNCLEAR,
        ))
    return tuple(judged)


# Tests -------------------------------------------------------------------------------------------


def share_above(hits: int, count: int, share: float) -> Sides:
    """Test whether a probability is above ``share``: exact binomial test."""
    return Sides(
        float(binom.sf(hits - 1, count, share)), float(binom.cdf(hits, count, share))
    ) if count else NOTHING_KNOWN


def mostly(hits: int, others: int) -> Sides:
    """Test whether something happens in more than half of the cases: exact sign test."""
    return share_above(hits, hits + others, 0.5)


def more_often(first: np.ndarray, second: np.ndarray) -> Sides:
    """Test whether something happens more often in one group than in another: Fisher's exact test.

    Args:
        first: whether it happens in each case of the first group.
        second: the same for the second group.
    """
    hits, total = int(first.sum()), len(first) + len(second)
    both = hits + int(second.sum())
    return Sides(
        float(hypergeom.sf(hits - 1, total, both, len(first))),
        float(hypergeom.cdf(hits, total, both, len(first))),
    )


def pairs_more_often(rates: PairedRates) -> Sides:
    """Test whether the second arm is positive more often: McNemar's exact test."""
    return mostly(rates.only_second, rates.only_first)


def more_often_by(first: np.ndarray, second: np.ndarray, margin: float) -> Sides:
    """Test whether something happens more often in one group than in another by at least a margin.

    The exact binomial tests of both groups are combined (Fisher, Statistical Methods for Research
    Workers, 1932, section 21.1) for each chance of the second group, and the greatest p counts.

    Args:
        first: whether it happens in each case of the first group.
        second: the same for the second group.
        margin: difference of the chances, from 0 to 1.
    """
    if not (len(first) and len(second)):
        return NOTHING_KNOWN
    chance = np.linspace(0, 1 - margin, _CHANCES)
    one, other = int(first.sum()), int(second.sum())
    higher = np.minimum(chance + margin, 1)
    both = (
        binom.sf(one - 1, len(first), higher) * binom.cdf(other, len(second), chance),
        binom.cdf(one, len(first), higher) * binom.sf(other - 1, len(second), chance),
    )
    return Sides(*(float(most - xlogy(most, most)) for most in (each.max() for each in both)))


def mostly_lower(first: np.ndarray, second: np.ndarray) -> Sides:
    """Test whether values are mostly lower in one group than in another.

    This holds if a value of the first group is more often below one of the second than above it.
    The greater p of two tests counts: Brunner-Munzel (Biometrical Journal 42, 2000, pp. 17-25),
    valid for unequal spreads, and Mann-Whitney, valid for small groups.
    """
    if min(len(first), len(second)) < 2:
        return NOTHING_KNOWN
    apart = 1 / math.comb(len(first) + len(second), len(first))  # exact, by permutation
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
    """Test whether something happens equally often in each group and the rest, within a margin.

    That all differences are within it needs every test; that one is beyond it, the least p value
    times their number (Bonferroni).
    """
    if not all(map(len, groups)):
        return NOTHING_KNOWN
    parts = []
    for number, group in enumerate(groups):
        rest = np.concatenate([other for at, other in enumerate(groups) if at != number])
        parts += [more_often_by(*pair, margin).opposite for pair in ((group, rest), (rest, group))]
    return all_of(parts)


def all_of(parts: Sequence[Sides]) -> Sides:
    """Test a conjunction: each part must be shown to confirm it, one false part refutes it."""
    return Sides(
        max(part.if_false for part in parts),
        min(1.0, len(parts) * min(part.if_true for part in parts)),
    )


def p_words(p_value: float) -> str:
    """Display text of a p value."""
    return f'{p_value:.2g}' if p_value >= 1e-4 else '< 0.0001'
