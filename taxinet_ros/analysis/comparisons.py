"""What another network does in the same scenes: rates, their difference, and runs that changed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from taxinet_ros.analysis.campaign_runs import CampaignRuns
from taxinet_ros.analysis.causes import Causes
from taxinet_ros.analysis.group_rates import Difference, GroupRate, difference
from taxinet_ros.analysis.run_features import PLAIN

_DIGITS = 6
_SCENE = [feature.name for feature in PLAIN]


class Changed(NamedTuple):
    """Scenes that both networks were run in.

    Attributes:
        scenes: how many there are.
        worse: failed here, satisfied by the baseline.
        better: satisfied here, failed by the baseline.
        p: of so uneven a change if both fail alike (McNemar's test, exact).
    """

    scenes: int
    worse: int
    better: int
    p: float


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A campaign beside a baseline.

    Attributes:
        baseline: the other campaign.
        rate: its failure rate.
        difference: that of the campaign less it.
        changed: in scenes that both have, or None if there are none.
        in_causes: failure rate of the baseline in each of the campaign's causes.
        off_causes: its failure rate outside all of them.
    """

    baseline: CampaignRuns
    rate: GroupRate
    difference: Difference
    changed: Changed | None
    in_causes: tuple[GroupRate, ...]
    off_causes: GroupRate

    def sentence(self, label: str, rate: GroupRate) -> str:
        """The comparison for people.

        Args:
            label: of the campaign.
            rate: its failure rate.
        """
        gap = self.difference
        text = (f'{label} fails in {rate.words()}, {self.baseline.label} in {self.rate.words()}')
        if np.isfinite(gap.low):
            value, low, high = (f'{100 * part:+.1f}'.replace('-', '−') for part in gap)
            text += f': {value} points ({low} to {high})'
            text += '' if gap.clear else ', which may be chance'
        if self.changed is not None:
            same = self.changed
            text += (f'. Of {same.scenes:,} scenes that both were run in, {same.worse:,} fail with '
                     f'{label} only and {same.better:,} with {self.baseline.label} only')
        return text + '.'


def compare(runs: CampaignRuns, baseline: CampaignRuns, causes: Causes) -> Comparison:
    """Hold a campaign against a baseline, whole and in each cause."""
    masks = [cause.region.mask(baseline.frame) for cause in causes.found]
    rate = baseline.rate()
    elsewhere = ~np.logical_or.reduce([np.zeros(len(baseline.frame), dtype=bool), *masks])
    return Comparison(
        baseline=baseline, rate=rate, difference=difference(runs.rate(), rate),
        changed=_changed(runs.frame, baseline.frame),
        in_causes=tuple(baseline.rate(mask) for mask in masks),
        off_causes=baseline.rate(elsewhere),
    )


def _changed(one: pd.DataFrame, other: pd.DataFrame) -> Changed | None:
    """The scenes of both, each once: the same features to the last digit that is kept."""
    here, there = (
        frame[[*_SCENE, 'failed']].round(_DIGITS).drop_duplicates(_SCENE) for frame in (one, other)
    )
    both = here.merge(there, on=_SCENE, suffixes=('', '_there'))
    if both.empty:
        return None
    worse = int((both['failed'] & ~both['failed_there']).sum())
    better = int((~both['failed'] & both['failed_there']).sum())
    p = float(binomtest(worse, worse + better).pvalue) if worse + better else 1.0
    return Changed(len(both), worse, better, p)
