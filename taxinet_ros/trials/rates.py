"""Failure rates of a program with confidence intervals. All rates are computed here.

**Which runs count.** A sampler chooses runs by earlier results, so neither their share of failures
nor a weighted share has a guaranteed error: importance weights are unbiased, but say nothing about
regions without runs. So a rate uses only runs drawn by *the program itself*: independently, and
marked as such by seed and index before any result
(:meth:`~taxinet_ros.samplers.sampler.Sampler.drawn`). Whatever a sampler does with its
other runs, these are independent, identically distributed draws: a plain Monte Carlo stratum of any
search. The interval below is then exact for every sampler and number of runs. Evenly spread runs
(Halton, Sobol, grid) are dependent and do not count either; binomial intervals of them are usually
too wide and sometimes much too narrow.

**Which interval.** If the number of runs equals the number planned before the first one, it is the
Clopper-Pearson interval (Biometrika 26, 1934). If the number of runs depends on their results
(``--until``, a budget, Ctrl-C, further runs after inconclusive ones), it is a *confidence
sequence*, which holds at all numbers of runs simultaneously: it contains the probabilities against
which a gambler betting on each run would not have multiplied the stake by 1/tail (Ville, Étude
critique de la notion de collectif, 1939; Robbins, Annals of Mathematical Statistics 41, 1970;
Ramdas et al., Statistical Science 38, 2023). ``benchmarks/intervals.py`` measures both.

Also here: texts on counts of outcomes and kinds of infrastructure errors.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.trials.record.row import RunRow

CONFIDENCE = 0.95
TAIL = (1 - CONFIDENCE) / 2
"""Tail probability at each end of an interval."""
NO_RATE = 'no rate from this search'


class Rate(NamedTuple):
    """A share of runs with its confidence interval, all as fractions 0..1."""

    rate: float
    low: float
    high: float

    @property
    def other(self) -> Rate:
        """The share of the other runs."""
        return Rate(1 - self.rate, 1 - self.high, 1 - self.low)

    def words(self) -> str:
        """Display text such as ``85.0% [78.1%, 90.4%]``."""
        return f'{self.rate:.1%} [{self.low:.1%}, {self.high:.1%}]'


def share_bounds(hits: float, misses: float, tail: float) -> tuple[float, float]:
    """Ends of the Clopper-Pearson interval of a share, for a number of runs fixed beforehand.

    Args:
        hits: number of hits.
        misses: number of misses.
        tail: tail probability at each end, 0.025 for a 95 % interval.
    """
    if {hits, misses} == {0, 1}:  # a single run, whose quantiles are the probabilities themselves
        return (tail, 1.0) if hits else (0.0, 1 - tail)
    # Imported here because it takes 0.3 s, as long as a short run. It is bit-identical to the
    # quantile of scipy.stats.beta, whose import takes ten times as long.
    from scipy.special import betaincinv

    low = float(betaincinv(hits, misses + 1, tail)) if hits > 0 else 0.0
    high = float(betaincinv(hits + 1, misses, 1 - tail)) if misses > 0 else 1.0
    return low, high


def anytime_bounds(hits: float, misses: float, tail: float) -> tuple[float, float]:
    """Ends of an interval that is valid at any stopping time.

    Each end is that of a one-sided confidence sequence: the upper one excludes the probabilities
    against which Jeffreys' mixture of all smaller ones has a likelihood ratio of 1/tail or more.

    Args:
        hits: number of hits.
        misses: number of misses.
        tail: probability, for each end, that it ever excludes the true value.
    """
    return 1 - _anytime_upper(misses, hits, tail), _anytime_upper(hits, misses, tail)


@lru_cache(maxsize=1 << 14)
def _anytime_upper(hits: float, misses: float, tail: float) -> float:
    if misses <= 0:
        return 1.0
    low, high = hits / (hits + misses), 1.0
    for _ in range(36):  # to ten digits
        middle = (low + high) / 2
        seen = log_evidence_below(hits, misses, middle)
        low, high = (low, middle) if seen >= -math.log(tail) else (middle, high)
    return high


def log_evidence_below(hits: float, misses: float, limit: float) -> float:
    """Natural logarithm of the evidence that hits are rarer than ``limit``.

    It is the stake of a gambler who began with 1 and bets on every run that hits are rarer, by the
    likelihood ratio of Jeffreys' mixture of all smaller probabilities. If they are not rarer, it
    ever reaches 1/tail with a probability of at most ``tail`` (Ville, 1939).

    Args:
        hits: number of hits.
        misses: number of misses.
        limit: probability of a hit, within 0..1 exclusively.
    """
    from scipy.special import betainc, betaln

    share = float(betainc(hits + 0.5, misses + 0.5, limit) / betainc(0.5, 0.5, limit))
    if share <= 0:  # less than the smallest number: these hits are certainly not rarer
        return -math.inf
    mixed = float(betaln(hits + 0.5, misses + 0.5) - betaln(0.5, 0.5))
    return math.log(share) + mixed - hits * math.log(limit) - misses * math.log1p(-limit)


def rate(k: int, n: int, *, anytime: bool = False) -> Rate:
    """Share ``k`` of ``n`` independent runs with its 95 % interval.

    Args:
        k: number of hits, 0..n.
        n: number of judged runs; if 0, the rate is NaN and the interval is [0, 1].
        anytime: the number of runs was not fixed beforehand.

    Raises:
        ValueError: ``k`` is not within 0..n.
    """
    if not 0 <= k <= n:
        raise ValueError(f'{k} of {n} is no share')
    low, high = (anytime_bounds if anytime else share_bounds)(k, n - k, TAIL)
    return Rate(rate=k / n if n else math.nan, low=low, high=high)


@dataclass(frozen=True, kw_only=True, slots=True)
class ProgramRate:
    """Rate of one kind of run under the program itself, estimated from a campaign.

    Attributes:
        runs, hits: number of judged runs from any source, and of those of the kind.
        drawn, drawn_hits: the same for runs that the program itself drew.
        anytime: whether the number of runs was not fixed beforehand.
        sampler: word of the sampler, or ''.
    """

    runs: int
    hits: int
    drawn: int
    drawn_hits: int
    anytime: bool
    sampler: str = ''

    @property
    def rate(self) -> Rate | None:
        """Rate under the program itself with its 95 % interval; None without drawn runs."""
        if not self.drawn:
            return None
        return rate(self.drawn_hits, self.drawn, anytime=self.anytime)

    @property
    def value(self) -> float | None:
        """The rate, or None."""
        return self.rate.rate if self.rate else None

    @property
    def low(self) -> float | None:
        """Lower end of its 95 % interval, or None."""
        return self.rate.low if self.rate else None

    @property
    def high(self) -> float | None:
        """Upper end of its 95 % interval, or None."""
        return self.rate.high if self.rate else None

    def __repr__(self) -> str:
        words = f'{self.rate.words()} of {self.drawn:,} runs' if self.rate else self.why_not
        return f'<ProgramRate {words}>'

    def __str__(self) -> str:
        return repr(self)[len('<ProgramRate '):-1]

    def bounds(self, tail: float) -> tuple[float, float]:
        """Ends of the interval with tail probability ``tail`` at each end."""
        ends = anytime_bounds if self.anytime else share_bounds
        return ends(self.drawn_hits, self.drawn - self.drawn_hits, tail)

    @property
    def why_not(self) -> str:
        """Sentence on why there is no rate, and what to do; '' if there is one."""
        if self.drawn:
            return ''
        if not self.runs:
            return f'{NO_RATE}: no run was judged'
        return (
            f'{NO_RATE}: {self.sampler or "a sampler"} chose all of its {self.runs:,} runs, and '
            'the program itself drew none of them; use the sampler option floor=0.3, or sampler '
            'random'
        )

    @property
    def rests_on(self) -> str:
        """The runs that the interval is based on, and its validity; for parentheses."""
        words = '95 % intervals'
        if self.drawn < self.runs:
            words += f' of the {self.drawn:,} runs that the program itself drew'
        if self.anytime:
            words += ', valid whenever a search stops'
        return words


@dataclass(frozen=True, slots=True)
class Verdict:
    """What rates need of a row, which has more."""

    index: int
    outcome: Outcome
    left_runway: bool | None
    from_program: bool
    sampler: str


Planned = int | range | None
"""Runs fixed before the first one: their number, or their indices; None for those there are."""


def rate_of(
    rows: Sequence[RunRow | Verdict], hit: Callable[[Any], bool], planned: Planned = None
) -> ProgramRate:
    """Rate of one kind of judged run under the program itself.

    Runs count in index order up to the first without a result: runs that finish early are a biased
    sample.

    Args:
        rows: rows of a campaign.
        hit: whether a judged run is of the kind.
        planned: runs fixed before the first one.
    """
    outcomes = {row.index: row.outcome for row in rows}
    counted = without_gaps(outcomes, planned)
    judged = [row for row in rows if row.index < counted and row.outcome.judged]
    drawn = [row for row in judged if row.from_program]
    return ProgramRate(
        runs=len(judged), hits=sum(map(hit, judged)),
        drawn=len(drawn), drawn_hits=sum(map(hit, drawn)),
        anytime=not sample_size_was_fixed(outcomes, planned),
        sampler=next((row.sampler for row in judged if row.sampler), ''),
    )


def failure_rate(rows: Sequence[RunRow | Verdict], planned: Planned = None) -> ProgramRate:
    """Failure rate of the program; see :func:`rate_of`."""
    return rate_of(rows, lambda row: row.outcome is Outcome.FAIL, planned)


def off_runway_rate(
    rows: Sequence[RunRow | Verdict], planned: Planned = None
) -> ProgramRate | None:
    """Off-runway rate; None if a run was stopped before it could be determined."""
    if any(row.outcome.judged and row.left_runway is None for row in rows):
        return None
    return rate_of(rows, lambda row: bool(row.left_runway), planned)


def without_gaps(outcomes: Mapping[int, str], planned: Planned = None) -> int:
    """Index of the first run, in planned order, that has no result or was interrupted.

    Args:
        outcomes: outcome by run index.
        planned: see :data:`Planned`; after the last planned one, indices go on in the same steps.
    """
    order = _indices(planned)
    index = order.start
    while outcomes.get(index, Outcome.INTERRUPTED) != Outcome.INTERRUPTED:
        index += order.step
    return index


def _indices(planned: Planned) -> range:
    return planned if isinstance(planned, range) else range(planned or 0)


def sample_size_was_fixed(outcomes: Mapping[int, str], planned: Planned) -> bool:
    """Whether the number of runs equals the number planned before the first one.

    A rejected scene uses up its run. Which ones are rejected depends on no result, so the judged
    ones are as good as fixed in number.

    Args:
        outcomes: outcome by run index.
        planned: see :data:`Planned`.
    """
    order = _indices(planned)
    whole = len(range(order.start, without_gaps(outcomes, planned), order.step)) == len(outcomes)
    return whole and (planned is None or len(order) == len(outcomes))


def count_kinds(kinds: Iterable[str]) -> dict[str, int]:
    """Number of infrastructure errors by kind, the most frequent first."""
    return dict(sorted(Counter(kinds).items(), key=lambda kind: (-kind[1], kind[0])))


def count_words(counts: Mapping[str, int], kinds: Mapping[str, int]) -> str:
    """Counts by outcome as text, without zero counts.

    Args:
        counts: number of runs by outcome, in display order.
        kinds: number of infrastructure errors by kind.
    """
    how = f' ({kind_words(kinds)})' if kinds else ''
    return ', '.join(
        f'{number:,} {name}{how if name == Outcome.INFRA_ERROR else ""}'
        for name, number in counts.items() if number
    )


def kind_words(kinds: Mapping[str, int]) -> str:
    """Number of infrastructure errors by kind, as text."""
    return ', '.join(f'{number:,} {kind}' for kind, number in kinds.items())
