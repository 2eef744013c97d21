"""Where a region of failures ends: its limits to the run, then on steps that people can say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from taxinet_ros.analysis.cause_scan import least_runs
from taxinet_ros.analysis.failure_region import Interval, Kinds, Part, Region
from taxinet_ros.analysis.group_rates import Mask
from taxinet_ros.analysis.run_features import BY_NAME, Feature, kinds_present
from taxinet_ros.analysis.scan_cells import interval_cells, subsets
from taxinet_ros.analysis.scan_statistic import likelihood_ratio

_CELLS = 250
_ROUNDS = 6


def sharpened(region: Region, frame: pd.DataFrame) -> Region:
    """The region with the limits that tell most, changed in turn until none can be bettered.

    Args:
        region: with limits on a coarse grid.
        frame: runs with features and ``failed``; the region is held against all others of them.
    """
    for _ in range(_ROUNDS):
        before = region
        for feature in region.features:
            parts = [part for part in region.parts if part.feature != feature.name]
            best = _best_part(feature, Region(parts=tuple(parts)), frame)
            kept = [part if part.feature != feature.name else best for part in region.parts]
            region = Region(parts=tuple(part for part in kept if part is not None))
        if region == before:
            break
    return region


def sayable(region: Region, frame: pd.DataFrame) -> Region:
    """The region with its limits on round values, and open where no run lies beyond.

    Args:
        region: any.
        frame: all runs of the campaign.
    """
    parts = [_rounded(part, frame) if isinstance(part, Interval) else part
             for part in region.parts]
    order = list(BY_NAME)
    return Region(parts=tuple(sorted(parts, key=lambda part: order.index(part.feature))))


def _best_part(feature: Feature, others: Region, frame: pd.DataFrame) -> Part | None:
    """The part about ``feature`` that tells most together with the others; None for any value."""
    among = others.mask(frame)
    failed = frame['failed'].to_numpy(dtype=bool)
    if not feature.numeric:
        return _best_kinds(feature, among, frame)
    values = frame.loc[among, feature.name].to_numpy(dtype=np.float64)
    cells, places = interval_cells(values, _CELLS, feature.name)
    runs = np.concatenate([[0.0], np.bincount(places, minlength=len(cells)).cumsum()])
    failures = np.bincount(places, weights=failed[among], minlength=len(cells))
    failures = np.concatenate([[0.0], failures.cumsum()])
    low, high = np.triu_indices(len(cells) + 1, 1)
    inside = runs[high] - runs[low]
    ratio = likelihood_ratio(
        failures[high] - failures[low], inside, int(failed.sum()), len(failed)
    )
    ratio[inside < least_runs(len(failed))] = 0.0
    best = int(ratio.argmax())
    if inside[best] == len(values) and others.parts:
        return None
    first, last = cells[low[best]], cells[high[best] - 1]
    return replace(first, high=last.high)


def _best_kinds(feature: Feature, among: Mask, frame: pd.DataFrame) -> Part | None:
    kinds = kinds_present(feature, frame)
    failed = frame['failed'].to_numpy(dtype=bool)
    members = np.concatenate([subsets(len(kinds)), np.ones((1, len(kinds)), dtype=np.float32)])
    column = frame[feature.name].to_numpy()
    runs = np.array([(column[among] == kind).sum() for kind in kinds], dtype=np.float64)
    failures = np.array([(column[among & failed] == kind).sum() for kind in kinds])
    inside = members @ runs
    ratio = likelihood_ratio(members @ failures, inside, int(failed.sum()), len(failed))
    ratio[inside < least_runs(len(failed))] = 0.0
    best = int(ratio.argmax())
    # A word without a run there says nothing.
    chosen = tuple(kind for kind, one, count in zip(kinds, members[best], runs, strict=True)
                   if one and count)
    everywhere = len(chosen) == int((runs > 0).sum())
    return None if everywhere and not among.all() else Kinds(feature=feature.name, kinds=chosen)


def _rounded(part: Interval, frame: pd.DataFrame) -> Interval:
    values = frame[part.feature]
    least, most = float(values.min()), float(values.max())
    low, high = BY_NAME[part.feature].rounded(
        least if part.low is None else part.low, most if part.high is None else part.high
    )
    return replace(part, low=low if low > least else None, high=high if high < most else None)
