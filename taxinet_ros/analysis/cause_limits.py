"""Where a region of failures ends: its limits to the run, then on steps that people can say."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from taxinet_ros.analysis.cause_scan import goes_round, least_runs
from taxinet_ros.analysis.failure_region import Either, Interval, Kinds, Part, Region, Slant
from taxinet_ros.analysis.group_rates import Floats, Mask
from taxinet_ros.analysis.run_features import BY_NAME, kinds_present
from taxinet_ros.analysis.scan_cells import interval_cells, subsets
from taxinet_ros.analysis.scan_statistic import likelihood_ratio

_CELLS, _CELLS_OF_HALVES = 250, 60
_ROUNDS = 6


def sharpened(region: Region, frame: pd.DataFrame) -> Region:
    """The region with the limits that tell most, changed in turn until none can be bettered.

    Args:
        region: with limits on a coarse grid.
        frame: runs with features and ``failed``; the region is held against all others of them.
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


def sayable(region: Region, frame: pd.DataFrame) -> Region:
    """The region with its limits on round values, and open where no run lies beyond.

    Args:
        region: any.
        frame: all runs of the campaign.
    """
    order = list(BY_NAME)
    parts = [_rounded(part, frame) for part in region.parts]
    return Region(parts=tuple(sorted(parts, key=lambda part: order.index(part.feature))))


def _best_part(part: Part, others: Region, frame: pd.DataFrame) -> Part | None:
    """The part with the limits that tell most together with others; None where it is idle."""
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
    # A word without a run there says nothing.
    chosen = tuple(kind for kind, one, count in zip(kinds, members[best], runs, strict=True)
                   if one and count)
    everywhere = len(chosen) == int((runs > 0).sum())
    return None if everywhere and not among.all() else Kinds(feature=feature, kinds=chosen)


def _best_halves(part: Either, frame: pd.DataFrame) -> Either:
    """Two halves of which a run lies in one only, cut where that tells most."""
    failed = frame['failed'].to_numpy(dtype=bool)
    firsts, seconds = (list(_halves(name, frame)) for name in part.names)
    one, other = (np.array([half.mask(frame) for half in halves]) for halves in (firsts, seconds))
    both_runs, both = one.astype(float) @ other.T, (one & failed).astype(float) @ other.T
    inside = one.sum(axis=1)[:, None] + other.sum(axis=1)[None, :] - 2 * both_runs
    within = ((one & failed).sum(axis=1)[:, None] + (other & failed).sum(axis=1)[None, :]
              - 2 * both)
    ratio = _ratio(within, inside, failed)
    first, second = np.unravel_index(int(ratio.argmax()), ratio.shape)
    return Either(first=firsts[first], second=seconds[second])


def _halves(name: str, frame: pd.DataFrame) -> Iterator[Interval | Kinds]:
    """Below and above each of some values, or words up to and from each."""
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
        first, second = (_rounded(each, frame) for each in (part.first, part.second))
        assert isinstance(first, Interval | Kinds)
        assert isinstance(second, Interval | Kinds)
        return Either(first=first, second=second)
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
        return replace(part, low=low, high=high)
    return replace(part, low=low if low > least else None, high=high if high < most else None)
