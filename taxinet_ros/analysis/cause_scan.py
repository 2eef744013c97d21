"""Where failures are denser than elsewhere: the Bernoulli scan statistic over many candidates.

A candidate is an interval of a numeric feature or a set of a feature's words, by itself or under a
condition on another feature. Its statistic is the log likelihood ratio of two failure rates, inside
and outside, against one (Kulldorff, Communications in Statistics: Theory and Methods 26, 1997). A
candidate with a condition counts for less, so that it wins only where it tells clearly more.

The p value is that of the largest statistic of the whole family, so having looked at so many is
accounted for. It is the rank among shufflings of the outcomes, or, where it is smaller than they
could ever show, a bound without them: the number of candidates times Hoeffding's bound for draws
without replacement (Journal of the American Statistical Association 58, 1963).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.sparse import csr_array

from taxinet_ros.analysis.failure_region import Interval, Kinds, Part, Region
from taxinet_ros.analysis.group_rates import Floats, Mask
from taxinet_ros.analysis.run_features import RAIN, Feature, kinds_present, varied
from taxinet_ros.analysis.scan_cells import (
    Floats32,
    Ints,
    interval_cells,
    neighbours,
    subsets,
)
from taxinet_ros.analysis.scan_statistic import hoeffding_bound, likelihood_ratio

SHUFFLES = 999
PAIR_DISCOUNT = 1.2
"""A candidate with a condition must tell a fifth more than one without, to be named instead."""

_CELLS, _CELLS_OF_PAIR, _THIRDS = 40, 20, 3
_MOST_KINDS = 8
_BATCH = 111


class _Cut(NamedTuple):
    """A feature in cells: a part for each, the cell of each run, and what candidates are made of.

    ``members`` says which cells each candidate has, (candidates, cells).
    """

    feature: Feature
    cells: tuple[Part, ...]
    places: Ints
    members: Floats32


@dataclass(frozen=True, kw_only=True)
class _Block:
    """Candidates that share a condition: runs of neighbouring cells, and sets of kinds.

    Attributes:
        condition: that all of them share, or None.
        cuts: the features that they are about.
        which: numbers of the runs that fulfil the condition.
        runs_of_cell: which of these each cell has, (cells of all cuts, runs).
        inside: number of runs of each candidate.
        worth: factor on the statistic.
    """

    condition: Part | None
    cuts: tuple[_Cut, ...]
    which: Ints
    runs_of_cell: csr_array
    inside: Floats32
    worth: float

    def failures(self, failed: Mask) -> Floats32:
        """Failures of each candidate, for each row of outcomes: (candidates, rows)."""
        cells = self.runs_of_cell @ failed[:, self.which].T.astype(np.float32)
        return _of_candidates(self.cuts, cells)

    def region(self, candidate: int) -> Region:
        """What a candidate is."""
        for cut in self.cuts:
            if candidate < len(cut.members):
                break
            candidate -= len(cut.members)
        part = _union([cut.cells[cell] for cell in np.flatnonzero(cut.members[candidate])])
        return Region(parts=(part,) if self.condition is None else (self.condition, part))


class Scan:
    """The candidates of a set of runs.

    Attributes:
        region: the one with the largest statistic, its limits on the grid of the scan; None where
            none has more failures than the others.
        statistic: its log likelihood ratio, discounted.
        candidates: that were compared.
    """

    def __init__(self, frame: pd.DataFrame) -> None:
        """Compare them.

        Args:
            frame: runs with features and ``failed``.
        """
        self._failed = frame['failed'].to_numpy(dtype=bool)
        self._blocks = list(_blocks(frame))
        self.candidates = sum(len(block.inside) for block in self._blocks)
        self.region: Region | None = None
        self.statistic = 0.0
        for block in self._blocks:
            ratio = block.worth * self._ratio(block, block.failures(self._failed[None, :])[:, 0])
            best = int(ratio.argmax())
            if ratio[best] > self.statistic:
                self.region, self.statistic = block.region(best), float(ratio[best])
        self._inside = None if self.region is None else self.region.mask(frame)

    def p_value(self, alpha: float, rng: np.random.Generator) -> tuple[float, bool]:
        """How probable so large a statistic is somewhere, if failing had no cause here.

        Args:
            alpha: the shufflings end when it is clear that the value is above it.
            rng: for the shufflings.

        Returns:
            The p value, and whether it is a bound that the true one is below.
        """
        if self._inside is None:
            return 1.0, False
        bound = self.candidates * hoeffding_bound(self._failed, self._inside)
        if bound < 1 / (SHUFFLES + 1):
            return bound, True
        # A ratio grows with the failures inside, so it is enough to know from how many on.
        enough = [self._enough(block)[:, None] for block in self._blocks]
        done = reached = 0
        while done < SHUFFLES and reached <= alpha * (SHUFFLES + 1):
            rows = rng.permuted(np.tile(self._failed, (_BATCH, 1)), axis=1)
            hits = np.zeros(_BATCH, dtype=bool)
            for block, least in zip(self._blocks, enough, strict=True):
                hits |= (block.failures(rows) >= least).any(axis=0)
            done, reached = done + _BATCH, reached + int(hits.sum())
        return (reached + 1) / (done + 1), False

    def _ratio(self, block: _Block, failures: Floats32) -> Floats:
        runs, least = len(self._failed), least_runs(len(self._failed))
        ratio = likelihood_ratio(failures, block.inside, int(self._failed.sum()), runs)
        ratio[(block.inside < least) | (runs - block.inside < least)] = 0.0
        return ratio

    def _enough(self, block: _Block) -> Floats32:
        """Fewest failures with which each candidate reaches the statistic; infinite for never."""
        reached = self.statistic * (1 - 1e-9)
        most = np.minimum(block.inside, self._failed.sum())
        low, high = np.zeros_like(most), most
        for _ in range(int(most.max()).bit_length() + 1):
            middle = np.floor((low + high) / 2)
            enough = block.worth * self._ratio(block, middle) >= reached
            low, high = np.where(enough, low, np.minimum(middle + 1, high)), np.where(
                enough, middle, high)
        possible = block.worth * self._ratio(block, high) >= reached
        return np.where(possible, high, np.inf).astype(np.float32)


def least_runs(runs: int) -> int:
    """Fewest runs that a candidate may have."""
    return max(8, runs // 200)


def _blocks(frame: pd.DataFrame) -> Iterator[_Block]:
    features = varied(frame)
    fine = [cut for feature in features if (cut := _cut(feature, frame, _CELLS)) is not None]
    if fine:
        yield _block(fine, None, np.arange(len(frame)))
    coarse = [_cut(feature, frame, _CELLS_OF_PAIR) for feature in features]
    for condition, source in _conditions(frame, features):
        cuts = [cut for cut in coarse if cut is not None and cut.feature.source != source]
        if cuts:
            yield _block(cuts, condition, np.flatnonzero(condition.mask(frame)))


def _of_candidates(cuts: Sequence[_Cut], of_cells: Floats32) -> Floats32:
    """Sums over the cells of each candidate, of sums of each cell: (candidates, …)."""
    ends = np.cumsum([len(cut.cells) for cut in cuts])[:-1]
    return np.concatenate([
        cut.members @ part for cut, part in zip(cuts, np.split(of_cells, ends), strict=True)
    ])


def _cut(feature: Feature, frame: pd.DataFrame, most: int) -> _Cut | None:
    """The feature in cells of runs, or None where it has too many words."""
    if feature.numeric:
        values = frame[feature.name].to_numpy(dtype=np.float64)
        cells, places = interval_cells(values, most, feature.name)
        return _Cut(feature, cells, places, neighbours(len(cells)))
    kinds = kinds_present(feature, frame)
    if len(kinds) > _MOST_KINDS:
        return None
    words = tuple(Kinds(feature=feature.name, kinds=(kind,)) for kind in kinds)
    places = pd.Categorical(frame[feature.name], categories=kinds).codes.astype(np.int64)
    return _Cut(feature, words, places, subsets(len(kinds)))


def _block(cuts: Sequence[_Cut], condition: Part | None, which: Ints) -> _Block:
    firsts = np.cumsum([0, *(len(cut.cells) for cut in cuts)])
    rows = np.concatenate([first + cut.places[which]
                           for first, cut in zip(firsts, cuts, strict=False)])
    columns = np.tile(np.arange(len(which)), len(cuts))
    runs_of_cell = csr_array(
        (np.ones(len(rows), dtype=np.float32), (rows, columns)), shape=(firsts[-1], len(which)),
    )
    counts = np.bincount(rows, minlength=firsts[-1]).astype(np.float32)
    return _Block(
        condition=condition, cuts=tuple(cuts), which=which, runs_of_cell=runs_of_cell,
        inside=_of_candidates(cuts, counts),
        worth=1.0 if condition is None else 1 / PAIR_DISCOUNT,
    )


def _conditions(
    frame: pd.DataFrame, features: Sequence[Feature]
) -> Iterator[tuple[Part, str]]:
    """Neighbouring words of a feature, no rain, and thirds of the other numeric features."""
    for feature in features:
        if not feature.numeric:
            kinds = kinds_present(feature, frame)[:_MOST_KINDS]
            for among in neighbours(len(kinds)):
                chosen = tuple(kind for kind, one in zip(kinds, among, strict=True) if one)
                yield Kinds(feature=feature.name, kinds=chosen), feature.source
        elif feature.name == RAIN.name:
            yield Interval(feature=feature.name, low=None, high=0.0), feature.source
        else:
            values = frame[feature.name].to_numpy(dtype=np.float64)
            for cell in interval_cells(values, _THIRDS, feature.name)[0]:
                yield cell, feature.source


def _union(parts: Sequence[Part]) -> Part:
    first = parts[0]
    if isinstance(first, Interval):
        last = parts[-1]
        assert isinstance(last, Interval)
        return Interval(feature=first.feature, low=first.low, high=last.high)
    kinds = [kind for part in parts if isinstance(part, Kinds) for kind in part.kinds]
    return Kinds(feature=first.feature, kinds=tuple(kinds))
