"""Find causes of failures one by one until the remaining failures are consistent with chance.

The most significant region of failures (:mod:`.scan`) has its limits refined, to single runs and
then to round values, and its runs are removed; then the next one is sought among the rest. A step
is taken only if the previous one found a significant region, so if there are no causes, one is
named with a probability of at most ``alpha``.

The search and all figures of a cause use the runs as made, each scene once. If a sampler chose the
scenes, the figures are not rates of the program; :mod:`.program` gives these, and fresh figures of
any cause.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from taxinet_ros.analysis.causes.region import (
    Either,
    Interval,
    Kinds,
    Part,
    Region,
    Slant,
    interval_cells,
    subsets,
)
from taxinet_ros.analysis.causes.scan import (
    Scan,
    SearchScan,
    goes_round,
    interval_of,
    least_runs,
    likelihood_ratio,
)
from taxinet_ros.analysis.runs.campaign import CampaignRuns, rate_words
from taxinet_ros.analysis.runs.features import (
    BY_NAME,
    Floats,
    Mask,
    features_of,
    kinds_present,
)

_CELLS, _CELLS_OF_HALVES = 250, 60
_ROUNDS = 6


def refine_limits(region: Region, frame: pd.DataFrame) -> Region:
    """Refine the region's limits in turn until none improves its score.

    Args:
        region: region with limits on a coarse grid.
        frame: runs with features and ``failed``; the region is compared with all others.
    """
    for _ in range(_ROUNDS):
        before = region
        for old in before.parts:
            if old not in region.parts:
                continue
            others = tuple(part for part in region.parts if part is not old)
            best = _best_part(old, Region(parts=others), frame)
            region = Region(parts=others if best is None else tuple(
                best if part is old else part for part in region.parts))
        if region == before:
            break
    return region


def round_limits(region: Region, frame: pd.DataFrame) -> Region:
    """Round the region's limits, and drop limits beyond which no run lies.

    Args:
        region: any region.
        frame: all runs of the campaign.
    """
    order = [feature.name for feature in features_of(frame.columns)]
    parts = [_rounded(part, frame) for part in region.parts]
    return Region(parts=tuple(sorted(parts, key=lambda part: order.index(part.feature))))


def _best_part(part: Part, others: Region, frame: pd.DataFrame) -> Part | None:
    """The part with the best limits in combination with ``others``; None if it adds nothing."""
    if isinstance(part, Either):
        return _best_halves(part, frame)
    among = others.mask(frame)
    if isinstance(part, Kinds):
        return _best_kinds(part.feature, among, frame)
    failed = frame['failed'].to_numpy(dtype=bool)
    every = (part.values(frame) if isinstance(part, Slant)
             else frame[part.feature].to_numpy(dtype=np.float64))
    firsts, lasts, places = interval_cells(every[among], _CELLS)
    cells = len(firsts)
    runs = np.concatenate([[0.0], np.bincount(places, minlength=cells).cumsum()])
    failures = np.bincount(places, weights=failed[among], minlength=cells)
    failures = np.concatenate([[0.0], failures.cumsum()])
    low, high = np.triu_indices(cells + 1, 1)
    inside, within = runs[high] - runs[low], failures[high] - failures[low]
    ratio = _ratio(within, inside, failed)
    if isinstance(part, Interval) and goes_round(part.feature, every):
        around = _ratio(failures[-1] - within, runs[-1] - inside, failed)
        around[(low == 0) | (high == cells)] = 0.0
        best = int(around.argmax())
        if around[best] > ratio.max():
            return replace(part, low=float(firsts[high[best]]), high=float(lasts[low[best] - 1]))
    best = int(ratio.argmax())
    if inside[best] == among.sum() and others.parts:
        return None
    return replace(part, low=float(firsts[low[best]]), high=float(lasts[high[best] - 1]))


def _best_kinds(feature: str, among: Mask, frame: pd.DataFrame) -> Part | None:
    kinds = kinds_present(BY_NAME[feature], frame)
    failed = frame['failed'].to_numpy(dtype=bool)
    members = np.concatenate([subsets(len(kinds)), np.ones((1, len(kinds)), dtype=np.float32)])
    column = frame[feature].to_numpy()
    runs = np.array([(column[among] == kind).sum() for kind in kinds], dtype=np.float64)
    failures = np.array([(column[among & failed] == kind).sum() for kind in kinds])
    ratio = _ratio(members @ failures, members @ runs, failed)
    best = int(ratio.argmax())
    # A word without a run in it carries no information.
    chosen = tuple(kind for kind, one, count in zip(kinds, members[best], runs, strict=True)
                   if one and count)
    everywhere = len(chosen) == int((runs > 0).sum())
    return None if everywhere and not among.all() else Kinds(feature=feature, kinds=chosen)


def _best_halves(part: Either, frame: pd.DataFrame) -> Either:
    """Two halves cut at the best values; a run lies in exactly one of them."""
    failed = frame['failed'].to_numpy(dtype=bool)
    firsts, seconds = (list(_halves(name, frame)) for name in part.names)
    one, other = (np.array([half.mask(frame) for half in halves]) for halves in (firsts, seconds))
    both_runs, both = one.astype(float) @ other.T, (one & failed).astype(float) @ other.T
    inside = one.sum(axis=1)[:, None] + other.sum(axis=1)[None, :] - 2 * both_runs
    within = ((one & failed).sum(axis=1)[:, None] + (other & failed).sum(axis=1)[None, :]
              - 2 * both)
    ratio = _ratio(within, inside, failed)
    first, second = np.unravel_index(int(ratio.argmax()), ratio.shape)
    return Either(either=(firsts[first], seconds[second]))


def _halves(name: str, frame: pd.DataFrame) -> Iterator[Interval | Kinds]:
    """Yield the parts below and above each candidate value, or the words up to and from each."""
    feature = BY_NAME[name]
    if not feature.numeric:
        kinds = kinds_present(feature, frame)
        for cut in range(1, len(kinds)):
            yield Kinds(feature=name, kinds=kinds[:cut])
            yield Kinds(feature=name, kinds=kinds[cut:])
        return
    firsts, lasts, _ = interval_cells(frame[name].to_numpy(dtype=np.float64), _CELLS_OF_HALVES)
    for last, first in zip(lasts[:-1], firsts[1:], strict=True):
        yield Interval(feature=name, low=None, high=float(last))
        yield Interval(feature=name, low=float(first), high=None)


def _ratio(failures: npt.NDArray[Any], inside: npt.NDArray[Any], failed: Mask) -> Floats:
    ratio = likelihood_ratio(failures, inside, int(failed.sum()), len(failed))
    least = least_runs(len(failed))
    ratio[(inside < least) | (len(failed) - inside < least)] = 0.0
    return ratio


def _rounded(part: Part, frame: pd.DataFrame) -> Part:
    if isinstance(part, Either):
        first, second = (_rounded(each, frame) for each in part.either)
        assert isinstance(first, Interval | Kinds)
        assert isinstance(second, Interval | Kinds)
        return Either(either=(first, second))
    if isinstance(part, Kinds):
        return part
    feature = BY_NAME[part.feature]
    values = part.values(frame) if isinstance(part, Slant) else frame[part.feature].to_numpy(
        dtype=np.float64)
    least, most = float(values.min()), float(values.max())
    low, high = feature.rounded(
        least if part.low is None else part.low, most if part.high is None else part.high
    )
    if part.low is not None and part.high is not None and part.low > part.high:
        # The gap between its ends may be less than a step: rounded, only the gap would remain.
        return replace(part, low=low, high=high) if low > high else part
    return replace(part, low=low if low > least else None, high=high if high < most else None)


LEAST_RUNS, LEAST_FAILURES, MOST_CAUSES = 20, 5, 8
_ALIKE = 0.5
"""Share of the runs of two regions together above which, if both name them, they are one."""
_BETWEEN = 0.01
"""Most runs between two intervals, as a share of all, for which one begins where the other ends."""
_TIMES_DENSER = 2.0
"""A region is narrowed if its failure rate rises by this factor within the narrower one."""
_OF_ALL = 1.92
"""Half the 95 % quantile of chi-square: for the rate of all runs, without any selection."""
_OUTCOME_BLIND_SAMPLERS = {'', 'random', 'halton', 'sobol', 'grid'}
"""Samplers that choose scenes without regard to outcomes."""


class FoundRate(NamedTuple):
    """Failure rate of a group that was selected by the outcomes of its runs.

    Attributes:
        runs, failures: numbers in the group, of the runs as made.
        rate: share of failures among these; usually biased upwards for a found region.
        low, high: simultaneous 95 % interval over all compared regions, so valid for the selected
            one; NaN if outcomes influenced the choice of scenes, or left out undecided runs.
    """

    runs: int
    failures: int
    rate: float
    low: float
    high: float

    def words(self) -> str:
        """Rate and interval, such as ``49.9 % (43.3–56.5 %)``."""
        return rate_words(self.runs, self.rate, self.low, self.high)


@dataclass(frozen=True, kw_only=True, slots=True)
class Cause:
    """A region in which runs fail more often than elsewhere.

    Attributes:
        region: region of the scenes.
        rank: 1 for the cause found first.
        inside, outside: failure rates inside and outside the region, among the runs that lie in no
            earlier cause, nor in its rim.
        whole: failure rate of all runs in the region, including those in earlier causes.
        share: share of all failures that lie in the region.
        added: share of all failures that lie in the region and in no earlier cause.
        associated: share of all failures by which there would be fewer if the region's runs failed
            as often as all others, with its interval: the attributable fraction (Levin, Acta Unio
            Internationalis contra Cancrum 9, 1953), without adjustment for what is drawn together
            with the region, and for other causes.
        p: p value of the region among the remaining runs, under the hypothesis of no cause.
        p_is_bound: whether ``p`` is an upper bound of the true p value.
    """

    region: Region
    rank: int
    inside: FoundRate
    outside: FoundRate
    whole: FoundRate
    share: float
    added: float
    associated: tuple[float, float, float]
    p: float
    p_is_bound: bool


class Causes(NamedTuple):
    """Result of a search for causes.

    Attributes:
        found: causes, the most significant first.
        rest: failure rate of the runs outside all of them.
        why_not: reason why none were sought, or ''.
        candidates: number of regions compared in the first step.
        searched: whether outcomes may have influenced the scenes, so that there are no intervals.
        again: number of runs left out because they repeat the scene of another.
    """

    found: tuple[Cause, ...]
    rest: FoundRate
    why_not: str
    candidates: int
    searched: bool = False
    again: int = 0

    @property
    def explained(self) -> float:
        """Share of all failures that lie in some cause."""
        return sum(cause.added for cause in self.found)


def find_causes(runs: CampaignRuns, alpha: float = 0.05) -> Causes:
    """Find the causes of a campaign's failures.

    Args:
        runs: runs of the campaign.
        alpha: maximum probability of naming a cause if there is none.
    """
    # A repeated scene has the same outcome, so it is not an independent sample.
    every = features_of(runs.frame.columns)
    scene = [feature.name for feature in every if feature.name in runs.frame]
    frame = runs.frame[~runs.frame.duplicated([*scene, 'rho'])].reset_index(drop=True)
    again = len(runs.frame) - len(frame)
    failed = frame['failed'].to_numpy(dtype=bool)
    left, covered = np.ones(len(frame), dtype=bool), np.zeros(len(frame), dtype=bool)
    searched = not set(runs.sampler.split(', ')) <= _OUTCOME_BLIND_SAMPLERS
    # Neither scenes chosen by outcomes nor runs left out by theirs give intervals.
    free = not searched and not runs.undecided
    why_not = _why_not(failed)
    found: list[Cause] = []
    candidates, slack = 0, 0.0
    rng = np.random.default_rng(0)
    while not why_not and len(found) < MOST_CAUSES and not _why_not(failed[left]):
        scan = Scan(frame[left])
        candidates = candidates or scan.candidates
        test = SearchScan(frame[left]) if searched else scan
        p, bound = test.p_value(alpha, rng)
        if scan.region is None or p > alpha:
            break
        region = round_limits(_described(scan, test, frame[left], alpha, rng), frame)
        within = region.mask(frame)
        inside, beyond = within & left, ~within & left
        if not failed[inside].any() or not beyond.any():
            break
        deviance = scan.deviance(min(inside.sum(), beyond.sum())) if free else math.nan
        slack += deviance
        left = beyond
        if any(_is_rim(region, cause.region, frame) for cause in found):
            continue
        found.append(Cause(
            region=region, rank=len(found) + 1, inside=_rate(failed[inside], deviance),
            outside=_rate(failed[beyond], deviance), whole=_rate(failed[within], deviance),
            share=float(within[failed].mean()), added=float((within & ~covered)[failed].mean()),
            associated=_associated(failed, within, deviance), p=p, p_is_bound=bound,
        ))
        covered |= within
    if not found:
        slack = _OF_ALL if free else math.nan
    return Causes(
        found=tuple(found), rest=_rate(failed[~covered], slack), why_not=why_not,
        candidates=candidates, searched=searched, again=again,
    )


def _is_rim(region: Region, earlier: Region, frame: pd.DataFrame) -> bool:
    """Whether a region names the runs of an earlier cause, or lies around it in its features."""
    one, other = region.mask(frame), earlier.mask(frame)
    shared = (one & other).sum()
    if shared > _ALIKE * (one | other).sum():
        return True
    parts = {part.feature: part for part in earlier.parts}
    names = {part.feature for part in region.parts}
    if names <= set(parts) and shared > _ALIKE * other.sum():
        return True
    return names == set(parts) and all(
        _touch(part, parts[part.feature], frame) for part in region.parts
    )


def _touch(one: Part, other: Part, frame: pd.DataFrame) -> bool:
    """Whether two parts of one feature have values in common, or next to each other."""
    if not (isinstance(one, Interval) and isinstance(other, Interval)):
        return type(one) is type(other) and one.names == other.names and bool(
            (one.mask(frame) & other.mask(frame)).any())
    values = frame[one.feature].to_numpy(dtype=np.float64)
    within = one.mask(frame), other.mask(frame)
    beyond = min(float(values[each].max()) for each in within if each.any())
    before = max(float(values[each].min()) for each in within if each.any())
    return float(((values > beyond) & (values < before)).mean()) <= _BETWEEN


def _described(
    scan: Scan, test: Scan, frame: pd.DataFrame, alpha: float, rng: np.random.Generator
) -> Region:
    """The scan's region of conditions that each matter given the other, with exact limits.

    Of two features, one that does not is dropped; if neither does, both are kept unless some single
    one is significant. To one feature, another may be added. Either way has half of alpha.

    Args:
        scan: the scan that found it.
        test: the scan to test by.
        frame: the runs of both, with features and ``failed``.
        alpha: level of the tests.
        rng: generator for the permutations.
    """
    def beside(name: str) -> bool:
        """Whether another feature matters given this one."""
        return test.p_given(name, rng) <= alpha / 2

    region = scan.region
    assert region is not None
    names = {feature.name for feature in region.features}
    if len(names) == 1:
        region = refine_limits(region, frame)
        narrower = _narrowed(region, frame, type(test), alpha / 2, rng)
        added = narrower.features[-1].name
        return narrower if narrower is region or beside(added) else region
    kept = {name for name in names if all(beside(other) for other in names - {name})}
    if kept != names and (kept or test.p_single() <= alpha):
        region = scan.single(kept)
    return refine_limits(region, frame)


def _narrowed(
    region: Region, among: pd.DataFrame, kind: type[Scan], alpha: float, rng: np.random.Generator
) -> Region:
    """The region of one feature with another condition, if most of its failures satisfy it."""
    inside = among[region.mask(among)]
    failed = inside['failed'].to_numpy(dtype=bool)
    if _why_not(failed):
        return region
    scan = kind(inside)
    new = scan.region.parts if scan.region is not None else ()
    sources = {feature.source for feature in region.features}
    new = tuple(part for part in new if isinstance(part, Interval | Kinds)
                and BY_NAME[part.feature].source not in sources)
    if len(new) != 1:
        return region
    within = new[0].mask(inside)
    if within.all() or failed[within].mean() < _TIMES_DENSER * failed[~within].mean():
        return region
    if scan.p_value(alpha, rng)[0] > alpha:
        return region
    narrower = refine_limits(Region(parts=(*region.parts, *new)), among)
    return narrower if len(narrower.parts) > 1 else region


def _rate(failed: Mask, deviance: float) -> FoundRate:
    runs, failures = len(failed), int(failed.sum())
    share = failures / runs if runs else math.nan
    if math.isnan(deviance):
        return FoundRate(runs, failures, share, math.nan, math.nan)
    return FoundRate(runs, failures, share, *interval_of(failures, runs, deviance))


def _associated(failed: Mask, within: Mask, deviance: float) -> tuple[float, float, float]:
    """Share of failures associated with a region, with an interval from those of both rates."""
    part = float(within.mean())

    def share(inside: float, outside: float) -> float:
        whole = part * inside + (1 - part) * outside
        return part * (inside - outside) / whole if whole else 0.0

    inside, outside = _rate(failed[within], deviance), _rate(failed[~within], deviance)
    return (share(inside.rate, outside.rate), share(inside.low, outside.high),
            share(inside.high, outside.low))


def _why_not(failed: Mask) -> str:
    """Why no cause can be distinguished from chance, or ''."""
    runs, failures = len(failed), int(failed.sum())
    counts = f'{runs:,} {"run" if runs == 1 else "runs"}, '
    counts += 'no failure' if not failures else f'{failures:,} ' + (
        'failure' if failures == 1 else 'failures')
    if runs and failures == runs:
        return f'{counts}: all runs fail, so causes cannot be distinguished'
    if not failures:
        return f'{counts}: no causes'
    if runs < LEAST_RUNS or failures < LEAST_FAILURES or runs - failures < LEAST_FAILURES:
        few = 'too few to find causes' if runs < LEAST_RUNS or failures < LEAST_FAILURES else (
            'too few other runs to distinguish causes')
        return f'{counts}: {few}'
    return ''
