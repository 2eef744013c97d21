"""How a statement of the paper is judged on our runs.

Figures of two different worlds need not agree. What can be compared is which of two things is
greater; that is judged by the 95 % interval of their difference on our runs alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.stats import chi2_contingency

from taxinet_ros.analysis.group_rates import Difference, difference
from taxinet_ros.analysis.paired_rates import Interval, PairedRates
from taxinet_ros.study.paper import CROSSING_M
from taxinet_ros.study.results import Network, Results

SIGNIFICANT = 0.05
_LEAST_PER_BIN, _MOST_SMALL = 5, 0.2


class Verdict(Enum):
    """How our runs stand to a statement of the paper."""

    AGREES = 'in kind as in the paper'
    DIFFERS = 'not as in the paper'
    UNCLEAR = 'not clear from these runs'


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A statement of the paper, and what our runs say of it.

    Attributes:
        name: unique, for files.
        statement: the paper's, with its figures.
        source: where it stands there.
        verdict: ours.
        evidence: our figures, with intervals and numbers of runs.
    """

    name: str
    statement: str
    source: str
    verdict: Verdict
    evidence: str

    def sentence(self) -> str:
        """The whole in words."""
        verdict = self.verdict.value[0].upper() + self.verdict.value[1:]
        return f'{verdict}: {self.statement} ({self.source}). Here: {self.evidence}'


def paired(
    results: Results, first: str, second: str, sign: int, name: str, source: str, statement: str, *,
    off: bool = False, where: str = '',
) -> Iterator[Claim]:
    """Whether the second network does better (+1) or worse, or leaves the runway less (-1)."""
    pair = results.pair(first, second)
    if pair is None:
        return
    at = pair.at(*CROSSING_M)
    among = {'at': at, 'off': ~at}.get(where)
    rates = pair.off_runway() if off else pair.satisfied(among)
    verb = 'leave the runway' if off else 'satisfy'
    place = {'at': ' that start at 1,200-1,600 m', 'off': ' that start elsewhere'}.get(where, '')
    yield Claim(
        name=name, statement=statement, source=source, verdict=_verdict(rates.difference, sign),
        evidence=_pair_words(rates, first, second, verb, place),
    )


def by_groups(
    network: Network, worse: np.ndarray, better: np.ndarray, there: str, elsewhere: str, name: str,
    source: str, statement: str,
) -> Claim:
    """Whether a network fails more in one group of runs than in another."""
    rates = network.runs.rate(worse), network.runs.rate(better)
    if not (rates[0].runs and rates[1].runs):
        verdict, evidence = Verdict.UNCLEAR, 'one of the two groups has no run.'
    else:
        verdict = _verdict(difference(*rates), +1)
        evidence = f'{rates[0].words()} of {rates[0].runs:,} runs {there} fail, '
        evidence += f'{rates[1].words()} of {rates[1].runs:,} {elsewhere}.'
    return Claim(name=name, statement=statement, source=source, verdict=verdict, evidence=evidence)


def even_p(counts: np.ndarray) -> float:
    """How likely rows of counts differ as much if all have the same shares; NaN for too few.

    Pearson's chi-square test, whose approximation asks for five expected in most cells (Cochran,
    Biometrics 10, 1954, pp. 417-451).
    """
    if len(counts) < 2 or not (counts.sum(axis=0) > 0).all():
        return math.nan
    found = chi2_contingency(counts, correction=False)
    if (found.expected_freq < _LEAST_PER_BIN).mean() > _MOST_SMALL or found.expected_freq.min() < 1:
        return math.nan
    return float(found.pvalue)


def _verdict(found: Interval | Difference, sign: int) -> Verdict:
    low, high = sorted((sign * found.low, sign * found.high))
    if low > 0:
        return Verdict.AGREES
    return Verdict.DIFFERS if high < 0 else Verdict.UNCLEAR


def _pair_words(rates: PairedRates, first: str, second: str, verb: str, place: str) -> str:
    if not rates.pairs:
        return f'no scene{place} was judged with both.'
    value, low, high = (100 * part for part in rates.difference)
    return (
        f'of {rates.pairs:,} scenes{place} {100 * rates.first / rates.pairs:.1f} % {verb} with '
        f'{first} and {100 * rates.second / rates.pairs:.1f} % with {second}: {value:+.1f} points '
        f'({low:+.1f} to {high:+.1f}, McNemar p = {rates.p_value:.2g}).'
    )
