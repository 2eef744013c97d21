"""Names causes of failures, one after another, until what is left looks like chance.

The strongest region of failures (:mod:`.cause_scan`) is narrowed where the failures within it have
a condition of their own, its limits are sharpened, and its runs are taken out; then the next one is
looked for among the rest. A step is taken only if the step before found something that was not
chance, so all causes together hold at the level of one test.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from taxinet_ros.analysis.campaign_runs import CampaignRuns
from taxinet_ros.analysis.cause_limits import sayable, sharpened
from taxinet_ros.analysis.cause_scan import Scan
from taxinet_ros.analysis.failure_region import Region
from taxinet_ros.analysis.group_rates import GroupRate, Mask, group_rate

LEAST_RUNS, LEAST_FAILURES, MOST_CAUSES = 20, 5, 8
_MOST_PARTS = 3
_TIMES_DENSER = 2.0
"""A region is narrowed where failures are this much denser within the narrower one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Cause:
    """A region in which runs fail more often than elsewhere.

    Attributes:
        region: of the scenes.
        rank: 1 for the one that was found first, which explains most.
        inside, outside: failure rates of the runs that causes before it have left, in the region
            and elsewhere.
        whole: failure rate of all runs in the region.
        explained: share of all failures that it explains and none before it did.
        p: of so strong a region somewhere among the runs left, if nothing mattered there.
        p_is_bound: whether the true p value may be smaller.
    """

    region: Region
    rank: int
    inside: GroupRate
    outside: GroupRate
    whole: GroupRate
    explained: float
    p: float
    p_is_bound: bool

    def sentence(self) -> str:
        """The cause for people."""
        words = self.region.words()
        left = '' if self.rank == 1 else ' that are left'
        return (
            f'{words[0].upper()}{words[1:]}: {self.inside.words()} of {self.inside.runs:,} runs'
            f'{left} fail, elsewhere {_percent(self.outside.rate)} of {self.outside.runs:,}; '
            f'{_percent(self.explained)} of all failures ({self.p_words()})'
        )

    def p_words(self) -> str:
        """The p value for people."""
        return 'p < 0.001' if self.p < 0.001 else f'p = {self.p:.3f}'


class Causes(NamedTuple):
    """What was found.

    Attributes:
        found: causes, the most important first.
        rest: failure rate of the runs outside all of them.
        why_not: why none were looked for, or ''.
        candidates: regions that were compared in the first step.
    """

    found: tuple[Cause, ...]
    rest: GroupRate
    why_not: str
    candidates: int

    @property
    def explained(self) -> float:
        """Share of all failures in some cause."""
        return sum(cause.explained for cause in self.found)


def find_causes(runs: CampaignRuns, alpha: float = 0.05) -> Causes:
    """Name the causes of a campaign's failures.

    Args:
        runs: of the campaign.
        alpha: how often causes may be named where there are none.
    """
    frame = runs.frame
    left = np.ones(len(frame), dtype=bool)
    why_not = _why_not(runs.failed)
    if why_not:
        return Causes(found=(), rest=runs.rate(), why_not=why_not, candidates=0)
    rng = np.random.default_rng(0)
    found: list[Cause] = []
    candidates = 0
    while len(found) < MOST_CAUSES and not _why_not(runs.failed[left]):
        scan = Scan(frame[left])
        candidates = candidates or scan.candidates
        p, bound = scan.p_value(alpha, rng)
        if scan.region is None or p > alpha:
            break
        region = _described(scan.region, frame, left, alpha, rng)
        cause = _cause(runs, region, left, len(found) + 1, p, bound)
        if cause is None:
            break
        found.append(cause)
        left &= ~region.mask(frame)
    return Causes(found=tuple(found), rest=runs.rate(left), why_not='', candidates=candidates)


def _why_not(failed: Mask) -> str:
    """Why no cause can be told from chance, or ''."""
    runs, failures = len(failed), int(failed.sum())
    counts = f'{runs:,} {"run" if runs == 1 else "runs"}, '
    counts += 'no failure' if not failures else f'{failures:,} ' + (
        'failure' if failures == 1 else 'failures')
    if runs and failures == runs:
        return f'{counts}: where all runs fail, nothing tells causes apart'
    if not failures:
        return f'{counts}: there are no causes to name'
    if runs < LEAST_RUNS or failures < LEAST_FAILURES or runs - failures < LEAST_FAILURES:
        few = 'too few to name causes' if runs < LEAST_RUNS or failures < LEAST_FAILURES else (
            'too few others to tell causes apart')
        return f'{counts}: {few}'
    return ''


def _described(
    region: Region, frame: pd.DataFrame, left: Mask, alpha: float, rng: np.random.Generator
) -> Region:
    """The region narrowed, sharpened and rounded.

    Each narrowing that is kept has more conditions than the one before, so there are at most
    ``_MOST_PARTS``: sharpening may drop the very condition that was added, and then it ends.
    """
    among = frame[left]
    region = sharpened(region, among)
    while (narrower := _narrowed(region, among, alpha, rng)) is not None:
        narrower = sharpened(narrower, among)
        if len(narrower.parts) <= len(region.parts):
            break
        region = narrower
    return sayable(region, frame)


def _narrowed(
    region: Region, among: pd.DataFrame, alpha: float, rng: np.random.Generator
) -> Region | None:
    """The region with a further condition, where nearly all of its failures have it."""
    inside = among[region.mask(among)]
    if _why_not(inside['failed'].to_numpy(dtype=bool)):
        return None
    scan = Scan(inside)
    if scan.region is None:
        return None
    sources = {feature.source for feature in region.features}
    new = [part for part, feature in zip(scan.region.parts, scan.region.features, strict=True)
           if feature.source not in sources]
    if not new or len(region.parts) + len(new) > _MOST_PARTS:
        return None
    narrower = Region(parts=(*region.parts, *new))
    within = narrower.mask(inside)
    failed = inside['failed'].to_numpy(dtype=bool)
    if within.all() or failed[within].mean() < _TIMES_DENSER * failed[~within].mean():
        return None
    return narrower if scan.p_value(alpha, rng)[0] <= alpha else None


def _cause(
    runs: CampaignRuns, region: Region, left: Mask, rank: int, p: float, bound: bool
) -> Cause | None:
    among = region.mask(runs.frame)
    inside, outside = runs.rate(among & left), runs.rate(~among & left)
    if not inside.failures or not outside.runs:
        return None
    return Cause(
        region=region, rank=rank, inside=inside, outside=outside, whole=runs.rate(among),
        explained=_share(runs, among & left), p=p, p_is_bound=bound,
    )


def _share(runs: CampaignRuns, among: Mask) -> float:
    """Share of the failures that are in a group, under the program where that is known."""
    failed = runs.failed
    return group_rate(among[failed], runs.weight[failed]).rate


def _percent(share: float) -> str:
    digits = 1 if share < 0.0995 or share > 0.9905 else 0
    return f'{100 * share:.{digits}f} %'
