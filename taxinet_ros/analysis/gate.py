"""A gate for continuous integration: do a campaign's runs prove what is asked of them?

A share of runs is known within an interval only, so there are three answers. PASS: the bound of
the interval that matters clears the threshold. FAIL: the whole interval is beyond it. INCONCLUSIVE:
the threshold lies within, and more runs would tell. Both bounds are one-sided, each at the stated
confidence: a system that is just as bad as the threshold passes with a probability of at most
1 - confidence, and one that is just as good fails with no more. Where several criteria are asked
for, that holds for each; the gate passes if all do and fails if any does.

Runs that were drawn, or weighted with 1, have exact binomial bounds (Clopper and Pearson,
Biometrika 26, 1934); evenly spread ones (Halton, Sobol) as a rule know a share better, so theirs
are on the safe side. Those of a biased sampler are weighted back to the program's distribution, and
their bounds are those of as many runs as would have the same variance (Korn and Graubard, Survey
Methodology 24, 1998).
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from taxinet_ros.analysis.gate_bounds import Bounds, bounds, further_runs
from taxinet_ros.campaign.outcome_words import count_kinds, kind_words
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.samplers.estimate import effective_runs
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.outcome import Outcome


class Verdict(enum.StrEnum):
    """The answer of a gate, or of one of its criteria."""

    PASS = 'PASS'
    FAIL = 'FAIL'
    INCONCLUSIVE = 'INCONCLUSIVE'


@dataclass(frozen=True, kw_only=True, slots=True)
class GateOptions:
    """What is asked of a campaign.

    Attributes:
        min_satisfaction: least share of runs that satisfy their formulas, or None.
        max_off_runway: largest share of runs that leave the runway, or None.
        max_infra: most runs that the bench broke.
        confidence: of each one-sided bound.
    """

    min_satisfaction: float | None = None
    max_off_runway: float | None = None
    max_infra: int = 0
    confidence: float = 0.95

    def __post_init__(self) -> None:
        """See that it can be asked.

        Raises:
            UsageError: a share is not within 0..1, or nothing is asked.
        """
        for name, value in (
            ('--min-satisfaction', self.min_satisfaction),
            ('--max-off-runway', self.max_off_runway),
        ):
            if value is not None and not 0 <= value <= 1:
                raise UsageError(f'{name} {value:g}: a share, so it needs to be within 0..1')
        if self.min_satisfaction is None and self.max_off_runway is None:
            raise UsageError('gate: say what is asked: --min-satisfaction or --max-off-runway')
        if not 0.5 <= self.confidence < 1:
            raise UsageError(f'--confidence {self.confidence:g}: needs to be within 0.5..1')
        if self.max_infra < 0:
            raise UsageError(f'--max-infra {self.max_infra}: needs to be 0 or more')


@dataclass(frozen=True, kw_only=True, slots=True)
class Criterion:
    """One thing that was asked, and the answer.

    Attributes:
        name: such as ``satisfied >= 0.86``.
        verdict: the answer.
        sentence: why, in figures.
        bounds: share and bounds; None for a mere count.
        more_runs: about how many further runs would give another answer than INCONCLUSIVE if the
            share stays as it is; None where no number does, or none is needed.
    """

    name: str
    verdict: Verdict
    sentence: str
    bounds: Bounds | None = None
    more_runs: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class GateAnswer:
    """What a gate says of a campaign.

    Attributes:
        verdict: FAIL if any criterion fails, else INCONCLUSIVE if any is, else PASS.
        criteria: all that were asked.
        counts: runs by outcome, all five of them.
        judged: runs with a verdict.
        effective: independent runs that would say as much; fewer than judged with weights.
        notes: what a reader has to know besides.
    """

    verdict: Verdict
    criteria: tuple[Criterion, ...]
    counts: Mapping[Outcome, int]
    judged: int
    effective: float
    notes: tuple[str, ...]


def ask_gate(rows: Sequence[RunRow], options: GateOptions, *, planned: int = 0) -> GateAnswer:
    """Hold a campaign against what is asked of it.

    Args:
        rows: its runs.
        options: what is asked.
        planned: number of runs that were to be made, 0 if not known.

    Raises:
        UsageError: the sampler's runs have no known weights, or runs were stopped before one could
            know whether they leave the runway.
    """
    counts = {outcome: sum(row.outcome is outcome for row in rows) for outcome in Outcome}
    judged = [row for row in rows if row.outcome.judged]
    weights = _weights(judged)
    effective = effective_runs(np.array(weights, dtype=np.float64))
    criteria = [*_criteria(judged, weights, options), _infra(rows, options.max_infra)]
    verdicts = {one.verdict for one in criteria}
    return GateAnswer(
        verdict=next((one for one in (Verdict.FAIL, Verdict.INCONCLUSIVE) if one in verdicts),
                     Verdict.PASS),
        criteria=tuple(criteria), counts=counts, judged=len(judged),
        effective=effective, notes=tuple(_notes(counts, weights, effective, planned)),
    )


def _criteria(
    judged: Sequence[RunRow], weights: Sequence[float], options: GateOptions
) -> list[Criterion]:
    found = []
    if options.min_satisfaction is not None:
        good = [row.outcome is Outcome.PASS for row in judged]
        found.append(_criterion(good, weights, options.min_satisfaction, options, off=False))
    if options.max_off_runway is not None:
        unknown = sum(row.left_runway is None for row in judged)
        if unknown:
            raise UsageError(
                f'--max-off-runway: {unknown} of {len(judged)} runs were stopped before one knew '
                'whether they leave the runway; run the campaign without --stop-on'
            )
        good = [not row.left_runway for row in judged]
        found.append(_criterion(good, weights, 1 - options.max_off_runway, options, off=True))
    return found


def _criterion(
    good: Sequence[bool], weights: Sequence[float], threshold: float, options: GateOptions, *,
    off: bool,
) -> Criterion:
    """Ask for a least share of good runs; ``off`` words it as a largest share of the others."""
    found = bounds(good, weights, options.confidence)
    if found.low >= threshold:
        verdict, more = Verdict.PASS, None
    elif found.high < threshold:
        verdict, more = Verdict.FAIL, None
    else:
        verdict = Verdict.INCONCLUSIVE
        more = further_runs(good, weights, threshold, options.confidence)
    name, shown, limit = 'satisfied', found, threshold
    if off:
        shown = Bounds(1 - found.share, 1 - found.high, 1 - found.low)
        name, limit = 'off the runway', options.max_off_runway or 0.0
    sign = '<=' if off else '>='
    return Criterion(
        name=f'{name} {sign} {limit:g}', verdict=verdict, bounds=shown, more_runs=more,
        sentence=_sentence(name, shown, len(good), options.confidence, verdict, more),
    )


def _sentence(
    name: str, shown: Bounds, runs: int, confidence: float, verdict: Verdict, more: int | None
) -> str:
    if not runs:
        needed = f': all good, {more:,} would do' if more else ''
        return f'no run was judged{needed}'
    text = (
        f'{_percent(shown.share)} of {runs:,} runs are {name}; with {100 * confidence:g} % '
        f'confidence each, at least {_percent(shown.low)} and at most {_percent(shown.high)}'
    )
    if verdict is not Verdict.INCONCLUSIVE:
        return text
    if more is None:
        return f'{text}; so near the threshold no number of runs that anybody makes will tell'
    return f'{text}; about {_rounded(more):,} runs more would tell if the share stays as it is'


def _percent(share: float) -> str:
    return f'{100 * share:.2f} %'


def _rounded(number: int) -> int:
    """Two digits of a number: nobody knows the others."""
    return int(float(f'{number:.1e}'))


def _infra(rows: Sequence[RunRow], most: int) -> Criterion:
    kinds = [row.kind for row in rows if row.outcome is Outcome.INFRA_ERROR]
    broken = len(kinds)
    how = f': {kind_words(count_kinds(kinds))}' if kinds else ''
    runs = 'run was' if broken == 1 else 'runs were'
    return Criterion(
        name=f'broken by the bench <= {most}',
        verdict=Verdict.PASS if broken <= most else Verdict.FAIL,
        sentence=f'{broken} {runs} broken by the bench and {"is" if broken == 1 else "are"} in no '
                 f'share{how}',
    )


def _weights(judged: Sequence[RunRow]) -> list[float]:
    """Weight of each run; 1 where the scenes were simply drawn.

    Raises:
        UsageError: a sampler chose them, and nobody knows the weights.
    """
    known = [1.0 if row.weight is None and not row.sampler else row.weight for row in judged]
    weights = [weight for weight in known if weight is not None]
    if len(weights) < len(known):
        sampler = next(row.sampler for row in judged if row.weight is None)
        raise UsageError(
            f'gate: {len(known) - len(weights)} runs were chosen by {sampler}, whose weights are '
            'not known: they say where failures are, not how many; use random, halton or ce'
        )
    return weights


def _notes(
    counts: Mapping[Outcome, int], weights: Sequence[float], effective: float, planned: int
) -> list[str]:
    notes = []
    for outcome, words in (
        (Outcome.REJECTED, 'rejected by the program'), (Outcome.INTERRUPTED, 'interrupted'),
    ):
        if counts[outcome]:
            notes.append(f'{counts[outcome]} runs were {words} and are in no share')
    missing = planned - sum(counts.values())
    if missing > 0:
        notes.append(f'{missing} of {planned} planned runs have no result')
    if any(weight != 1 for weight in weights):
        notes.append(
            f'the sampler is biased: the runs are weighted and say as much as '
            f'{effective:.0f} drawn ones; their bounds are approximate'
        )
    return notes
