"""Acceptance test of a retrained network against its predecessor on the same unseen scenes.

It must be better in some respect, and *not worse* in failures anywhere examined. A small observed
increase is no proof of that: the increase must be shown to be smaller than a margin
(non-inferiority), over all scenes and in each place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import norm

from taxinet_ros.analysis.causes.region import Interval, Kinds, Region, interval_cells
from taxinet_ros.analysis.experiment.arms import ArmComparison, compare_arms
from taxinet_ros.analysis.runs.features import (
    CLOUDS_KIND,
    CROSS_TRACK,
    DISTANCE,
    HEADING,
    RAIN,
    TIME_OF_DAY,
    Mask,
    feature_columns,
)
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.trials.rates import rate, share_bounds
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import table

INCUMBENT, CANDIDATE = 'incumbent', 'candidate'
MARGIN, PLACE_MARGIN = 0.01, 0.05

_PARTS = 4
_DARK = ('broken', 'overcast', 'stratus')


@dataclass(frozen=True, kw_only=True)
class Decision:
    """Result of the acceptance test.

    Attributes:
        accepted: whether the candidate replaces the incumbent.
        why: text with the reason.
        pairs: number of scenes judged with both.
        failed_before, failed_now: failures among them, with the incumbent and with the candidate.
        only_before, only_now: failures with only one of them.
        failures_p: p value of the two-sided exact McNemar test for equal failure rates.
        more_failures: upper bound, at the level of the test, of the candidate's failure rate minus
            the incumbent's.
        rho_change: typical change of the headline's robustness [m, or the unit of its predicate].
        rho_low, rho_high: its 95 % interval.
        rho_p: p value of the two-sided Wilcoxon test for no change.
        off_before, off_now: number of runs that left the runway.
        satisfied_low: lower end of the candidate's 95 % Clopper-Pearson interval.
        worse: places in which non-inferiority by the margin is not shown.
    """

    accepted: bool
    why: str
    pairs: int
    failed_before: int
    failed_now: int
    only_before: int
    only_now: int
    failures_p: float
    more_failures: float
    rho_change: float
    rho_low: float
    rho_high: float
    rho_p: float
    off_before: int
    off_now: int
    satisfied_low: float
    worse: tuple[str, ...]

    def lines(self) -> list[str]:
        """What is printed of it."""
        now = rate(self.pairs - self.failed_now, self.pairs)
        change = f'{self.rho_change:+.3f}'
        if not math.isnan(self.rho_low):  # else too few pairs for an interval
            change += f' ({self.rho_low:+.3f} to {self.rho_high:+.3f})'
        return [
            f'  on {self.pairs} scenes new to both: {self.failed_before} failures before, '
            f'{self.failed_now} now ({self.only_before} only before, {self.only_now} only now); '
            f'{self.off_before} and {self.off_now} left the runway',
            f'  now satisfied: {100 * now.rate:.1f} % ({100 * now.low:.1f}-{100 * now.high:.1f} '
            f'%); rho {change}',
            f'  failure rate higher by at most {100 * max(self.more_failures, 0):.1f} points',
            f'  {"ACCEPTED" if self.accepted else "REJECTED"}: {self.why}',
        ]


def decide(
    before: Sequence[RunRow], now: Sequence[RunRow], alpha: float, *, margin: float = MARGIN,
    place_margin: float = PLACE_MARGIN, causes: Sequence[Region] = (),
) -> Decision:
    """Compare the runs of two networks over the scenes judged with both.

    The candidate is accepted if, at level ``alpha``, it fails less often, or fails no more often
    and keeps to the centreline better (robustness). It must also be shown, each at this level, that
    it neither fails nor leaves the runway more often by ``margin`` or more, and that it does not
    fail more often by ``place_margin`` or more in any quarter of the scenes along the runway,
    over the day, by offset or by heading of the start; in rain, or dry under light or dark skies;
    in a cause of the incumbent's failures, or outside all causes. Since all of this must be shown,
    a network that is worse by a margin in any of it is accepted with a probability of at most
    ``alpha`` (intersection-union test: Berger, Technometrics 24, 1982). That is for one decision:
    each round of a loop has its own.

    Args:
        before: runs of the incumbent.
        now: runs of the candidate on the same scenes.
        alpha: probability, for either reason, of accepting a network that is no better.
        margin: tolerated increase of the failure rate over all scenes.
        place_margin: tolerated increase in a place, where there are fewer runs.
        causes: regions of the incumbent's failures.
    """
    found = compare_arms(INCUMBENT, before, CANDIDATE, now)
    satisfied, off, rho = found.satisfied, found.off_runway, found.rho
    bounds = _places(found, causes, alpha, place_margin)
    worse = {name: bound for name, bound in bounds.items() if bound >= place_margin}
    more = _bound(satisfied.only_first, satisfied.only_second, satisfied.pairs, alpha)
    more_off = _bound(off.only_second, off.only_first, off.pairs, alpha)
    better = _better(found, alpha)
    refusal = _refusal(found, more, more_off, margin, worse) if found.pairs else ''
    why = refusal if better or satisfied.second < satisfied.first else ''
    return Decision(
        accepted=bool(better) and not refusal, why=why or better or 'not significantly better',
        pairs=satisfied.pairs, failed_before=satisfied.pairs - satisfied.first,
        failed_now=satisfied.pairs - satisfied.second,
        only_before=satisfied.only_second, only_now=satisfied.only_first,
        failures_p=satisfied.p_value, more_failures=more, rho_change=rho.change.value,
        rho_low=rho.change.low, rho_high=rho.change.high, rho_p=rho.p_value, off_before=off.first,
        off_now=off.second,
        satisfied_low=rate(satisfied.second, satisfied.pairs).low if found.pairs else 0.0,
        worse=tuple(sorted(worse)),
    )


def _better(found: ArmComparison, alpha: float) -> str:
    """Text on what the candidate does significantly better, or ''."""
    satisfied, rho = found.satisfied, found.rho
    if satisfied.second > satisfied.first and satisfied.p_value <= alpha:
        return f'fails less often (p {satisfied.p_value:.2g})'
    if satisfied.second >= satisfied.first and rho.change.value > 0 and rho.p_value <= alpha:
        return f'does not fail more often and stays closer to the centreline (p {rho.p_value:.2g})'
    return ''


def _refusal(
    found: ArmComparison, more: float, more_off: float, margin: float, worse: Mapping[str, float],
) -> str:
    """Why the candidate may be worse, or ''."""
    satisfied, off = found.satisfied, found.off_runway
    if off.second > off.first:
        return f'leaves the runway more often ({off.second} runs, not {off.first})'
    if satisfied.second < satisfied.first:
        return 'fails more often'
    if more >= margin:
        return (f'may fail up to {100 * more:.1f} points more often on {satisfied.pairs} scenes; '
                f'the margin is {100 * margin:g}')
    if more_off >= margin:
        return (f'may leave the runway up to {100 * more_off:.1f} points more often on '
                f'{off.pairs} scenes; the margin is {100 * margin:g}')
    if worse:
        most = max(worse, key=lambda name: worse[name])
        others = f', and in {len(worse) - 1} more places' if len(worse) > 1 else ''
        return (f'may fail up to {100 * worse[most]:.1f} points more often where it is about '
                f'"{most}"{others}')
    return ''


def _places(
    found: ArmComparison, causes: Sequence[Region], alpha: float, place_margin: float
) -> dict[str, float]:
    """Upper bound of the increase of the failure rate in each place.

    Improvements in a cause must not compensate for new failures outside it, so of every other place
    only the part outside the causes counts. Parts that are too small for a conclusion are covered
    by the places that contain them.
    """
    if not found.pairs:
        return {}
    frame = feature_columns(table([one for one, _ in found.pairs]))
    before, now = np.array([
        [run.outcome is Outcome.FAIL for run in pair] for pair in found.pairs]).T
    # With this many pairs and no new failure, the bound is below the margin.
    least = math.ceil(math.log(alpha) / math.log1p(-place_margin))
    inside = np.zeros(len(frame), dtype=bool)
    masks = {'no cause found': inside}
    for cause in causes:
        masks[cause.words()] = mask = cause.mask(frame)
        inside |= mask
    np.logical_not(inside, out=inside)
    for words, mask in _parts(frame, min(_PARTS, len(frame) // least)):
        outside = mask & inside
        masks[words] = outside if outside.sum() >= least else mask
    return {
        words: _bound(int((~before & now)[mask].sum()), int((before & ~now)[mask].sum()),
                      int(mask.sum()), alpha)
        for words, mask in masks.items() if mask.sum() >= least
    }


def _parts(frame: pd.DataFrame, most: int) -> Iterator[tuple[str, Mask]]:
    """Yield quantile ranges of runway, time of day and start pose, and kinds of sky."""
    for feature in (DISTANCE, TIME_OF_DAY, CROSS_TRACK, HEADING):
        values = frame[feature.name].to_numpy(dtype=np.float64)
        for low, high in zip(*interval_cells(values, max(most, 1))[:2], strict=True):
            part = Interval(feature=feature.name, low=float(low), high=float(high))
            yield part.words(), part.mask(frame)
    dry = Interval(feature=RAIN.name, low=None, high=0.0).mask(frame)
    dark = Kinds(feature=CLOUDS_KIND.name, kinds=_DARK).mask(frame)
    yield 'rain', ~dry
    yield 'dark clouds, no rain', dry & dark
    yield 'light clouds or none, no rain', dry & ~dark


def _bound(more: int, fewer: int, pairs: int, alpha: float) -> float:
    """Upper bound of a difference of paired rates, from the discordant pairs.

    The greatest difference that the score test of Tango (Statistics in Medicine 17, 1998) does not
    reject in favour of a smaller one, at a one-sided level; 1 without pairs. Where all discordant
    pairs are new failures, their exact bound, as that test then rejects too often.
    """
    if not pairs:
        return 1.0
    if not fewer:
        return share_bounds(more, pairs - more, alpha)[1]
    quantile = float(norm.ppf(1 - alpha))
    low, high = (more - fewer) / pairs, 1.0
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if _score(more, fewer, pairs, middle) > -quantile else (
            low, middle)
    return high


def _score(more: int, fewer: int, pairs: int, difference: float) -> float:
    """Tango's statistic: observed minus given difference, in standard errors."""
    b = -more - fewer + (2 * pairs - more + fewer) * difference
    c = -fewer * difference * (1 - difference)
    fewer_rate = (math.sqrt(max(b * b - 8 * pairs * c, 0.0)) - b) / (4 * pairs)
    variance = pairs * (2 * fewer_rate + difference * (1 - difference))
    gap = more - fewer - pairs * difference
    if variance <= 0:
        return math.copysign(math.inf, gap) if gap else 0.0
    return gap / math.sqrt(variance)
