"""Scan statistic: find regions of increased failure rate and test their significance.

There are three families of regions: intervals of a numeric feature, including over midnight, and
sets of words; intervals of a sum of two features, which are slanted bands; and two conditions, of
which both hold or exactly one does. Each family's maximum score is compared with its maxima under
permuted outcomes; the largest excess over all families is then compared with that of the
permutations. So the p value accounts for all regions examined. It says that something matters, not
which feature of a region of two does: each is tested given the other, with outcomes permuted among
runs of about equal values of the other.

The statistic of a region is the log likelihood ratio of two failure rates, inside and outside,
against one (Kulldorff, Communications in Statistics: Theory and Methods 26, 1997). Small regions
are far more numerous than large ones, so the maximum statistic would nearly always be that of a
small one; the score therefore subtracts what regions of that size reach by chance (Walther and
Perry, Journal of the Royal Statistical Society B 84, 2022).

Permutation assumes that scenes were chosen independently of outcomes. If a sampler learned from
them, the runs are tested in their order instead, by an e-value.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import csr_array
from scipy.special import betaln, logsumexp
from threadpoolctl import threadpool_limits

from taxinet_ros.analysis.causes.region import (
    Either,
    Floats32,
    Interval,
    Ints,
    Kinds,
    Region,
    Slant,
    around_the_clock,
    beginnings,
    interval_cells,
    neighbours,
    subsets,
)
from taxinet_ros.analysis.runs.features import (
    CROSS_TRACK,
    DISTANCE,
    HEADING,
    TIME_OF_DAY,
    WIND_DIRECTION,
    Feature,
    Floats,
    Mask,
    kinds_present,
    varied,
)


def likelihood_ratio(
    failures: npt.NDArray[Any], inside: npt.NDArray[Any], all_failures: int, runs: int
) -> Floats:
    """Log likelihood ratio of two rates against one; 0 unless the rate inside is the higher.

    Args:
        failures: number of failures inside.
        inside: number of runs inside, broadcast with ``failures``.
        all_failures: number of failures inside and outside.
        runs: number of runs inside and outside.
    """
    x_log_x = _x_log_x(runs)
    k, n = np.rint(failures).astype(np.int32), np.rint(inside).astype(np.int32)
    # Outside there are never more failures than runs where k is a count of these runs.
    beyond = np.minimum(all_failures - k, runs - n)
    ratio: Floats = x_log_x[k] + x_log_x[n - k]
    ratio += x_log_x[beyond]
    ratio += x_log_x[runs - n - beyond]
    ratio -= x_log_x[n] + x_log_x[runs - n]
    ratio -= float(x_log_x[all_failures] + x_log_x[runs - all_failures] - x_log_x[runs])
    return np.where(k * float(runs) > n * float(all_failures), ratio, 0.0)


def _x_log_x(most: int) -> Floats:
    numbers = np.arange(most + 1, dtype=np.float64)
    return numbers * np.log(np.maximum(numbers, 1))


def size_penalty(inside: npt.NDArray[Any], runs: int) -> Floats:
    """Value of the root of twice the ratio that regions of a given size reach by chance."""
    smaller = np.minimum(inside, runs - inside)
    penalty: Floats = np.sqrt(2 * np.log(math.e * runs / np.maximum(smaller, 1.0)))
    return penalty


def hoeffding_bound(failed: Mask, inside: Mask) -> float:
    """Bound on the probability that permuted outcomes put at least as many failures inside.

    Args:
        failed: whether each run failed.
        inside: whether each run is inside; neither none nor all.
    """
    share = float(failed.mean())
    exponents = []
    for among, of in ((failed[inside], share), (~failed[~inside], 1 - share)):
        part = float(among.mean())
        exponents.append(len(among) * _divergence(part, of) if part > of else 0.0)
    return math.exp(-max(exponents))


def interval_of(failures: int, runs: int, deviance: float) -> tuple[float, float]:
    """Likelihood interval of a rate.

    Args:
        failures: number of failed runs.
        runs: number of runs; with 0 every rate is possible.
        deviance: the log likelihood ratio of the observed rate to a rate at an end.
    """
    if not runs:
        return 0.0, 1.0
    share = failures / runs

    def end(of: float) -> float:
        near, far = share, of
        for _ in range(60):
            middle = (near + far) / 2
            if runs * _divergence(share, middle) <= deviance:
                near = middle
            else:
                far = middle
        return near

    return (end(0.0) if failures else 0.0), (end(1.0) if failures < runs else 1.0)


def _divergence(part: float, whole: float) -> float:
    """Kullback-Leibler divergence of two coins."""
    terms = ((part, whole), (1 - part, 1 - whole))
    return sum(one * math.log(one / max(other, 1e-300)) for one, other in terms if one > 0)


def log_evidence(
    failures: npt.NDArray[Any], inside: npt.NDArray[Any], all_failures: int, runs: int
) -> Floats:
    """Log e-value against 'one rate', for each of some regions fixed before the runs.

    It is the likelihood of the outcomes under two unknown rates, each mixed over Jeffreys's prior,
    divided by the maximum under a single rate. If all scenes fail equally often, then given the
    past and the scene, the next outcome is a toss of one coin, however the scene was chosen. So the
    ratio to the true coin is a martingale and the ratio here does not exceed it. By Ville's
    inequality it exceeds 1 / alpha with probability at most alpha, whatever the sampler has learned
    from outcomes (universal inference: Wasserman, Ramdas and Balakrishnan, PNAS 117, 2020; Ramdas,
    Grünwald, Vovk and Shafer, Statistical Science 38, 2023). Means of e-values are e-values.
    """
    k, n = failures.astype(np.float64), inside.astype(np.float64)
    beyond, others = all_failures - k, runs - n

    def mixed(hits: Floats, tosses: Floats) -> Floats:
        value: Floats = betaln(hits + 0.5, tosses - hits + 0.5) - betaln(0.5, 0.5)
        return value

    x_log_x = _x_log_x(runs)
    one_rate = x_log_x[all_failures] + x_log_x[runs - all_failures] - x_log_x[runs]
    evidence: Floats = mixed(k, n) + mixed(beyond, others) - float(one_rate)
    return evidence


SHUFFLES = 999
DISCOUNT = 1.2
"""Factor by which a region of two features must exceed one of a single feature to be preferred."""
PERIODS = {TIME_OF_DAY.name: 24.0, HEADING.name: 360.0, WIND_DIRECTION.name: 360.0}
"""Periods of the cyclic features."""
_FIRST_SHUFFLES, _SHUFFLES_OF_BOUND, _SHUFFLES_GIVEN = 199, 59, 199
_HOPELESS = 3.0
"""Multiple of alpha: if p exceeds it after the first permutations, no more are made."""
_LEVEL = 0.05
_LEVELS = (0.03, 0.015, 0.015)
"""Level of each family: single features are causes more often than pairs."""
_MOST_KINDS = 8
_SLOPES = (0.5, 1.0, 2.0)
_SLANTED = (CROSS_TRACK, HEADING, DISTANCE, TIME_OF_DAY)
_WRAPS = 0.2
"""A feature is treated as cyclic if at most this share of its period contains no run."""
_LEARNING = 0.2
"""Share of a search's runs used only to place the cuts, if outcomes influenced the scenes."""
_NONE = -99.0
"""A value below every score."""
_ONE, _SLANT, _TWO = range(3)


class _Axis(NamedTuple):
    """A feature, or a sum of two, divided into cells, with the candidate sets of cells.

    Attributes:
        part: the unrestricted part, whose limits are replaced.
        firsts, lasts: minimum and maximum of each cell; empty for words.
        places: cell of each run.
        members: cells of each candidate, (candidates, cells).
    """

    part: Interval | Kinds | Slant
    firsts: Floats
    lasts: Floats
    places: Ints
    members: Floats32

    def chosen(self, cells: Floats32) -> Interval | Kinds | Slant:
        """The part formed by some cells."""
        part, inside = self.part, np.flatnonzero(cells)
        if isinstance(part, Kinds):
            return Kinds(feature=part.feature, kinds=tuple(part.kinds[cell] for cell in inside))
        first, last = int(inside[0]), int(inside[-1])
        if last - first + 1 > len(inside):  # it wraps around
            gap = np.flatnonzero(cells == 0)
            first, last = int(gap[-1]) + 1, int(gap[0]) - 1
        low, high = float(self.firsts[first]), float(self.lasts[last])
        if isinstance(part, Slant):
            return Slant(feature=part.feature, other=part.other, factor=part.factor,
                         low=low, high=high)
        return Interval(feature=part.feature, low=low, high=high)


@dataclass(frozen=True)
class _Block:
    """Candidates that are evaluated together.

    Attributes:
        family: :data:`_ONE`, :data:`_SLANT` or :data:`_TWO`.
        axes: one axis, or two crossed axes.
        runs_of_cell: which runs each cell, or pair of cells, contains: (cells, runs).
        inside: number of runs of each candidate.
    """

    family: int
    axes: tuple[_Axis, ...]
    runs_of_cell: csr_array
    inside: Floats32

    def failures(self, rows: Floats32) -> Floats32:
        """Number of failures of each candidate, per row of outcomes: (candidates, rows)."""
        return _counts(self.axes, self.runs_of_cell @ rows.T)

    def region(self, candidate: int) -> Region:
        """The region of a candidate."""
        if len(self.axes) == 1:
            return Region(parts=(self.axes[0].chosen(self.axes[0].members[candidate]),))
        one, other = self.axes
        both = len(one.members) * len(other.members)
        if candidate < both:
            first, second = divmod(candidate, len(other.members))
            return Region(parts=(one.chosen(one.members[first]), other.chosen(
                other.members[second])))
        halves = [beginnings(axis.members.shape[1]) for axis in self.axes]
        either = len(halves[0]) * len(halves[1])
        same, candidate = divmod(candidate - both, either)
        first, second = divmod(candidate, len(halves[1]))
        cells = 1 - halves[1][second] if same else halves[1][second]
        parts = one.chosen(halves[0][first]), other.chosen(cells)
        assert not isinstance(parts[0], Slant)
        assert not isinstance(parts[1], Slant)
        return Region(parts=(Either(either=(parts[0], parts[1])),))


class Scan:
    """The candidates of a set of runs.

    Attributes:
        region: the one with the best score, its limits on the grid of the scan; None if none has an
            increased failure rate.
        candidates: number of compared candidates.
    """

    def __init__(self, frame: pd.DataFrame, basis: pd.DataFrame | None = None) -> None:
        """Evaluate all candidates.

        Args:
            frame: runs with features and ``failed``.
            basis: runs by which features are cut; None for ``frame``.
        """
        self._failed = frame['failed'].to_numpy(dtype=bool)
        self._blocks = list(_blocks(frame, frame if basis is None else basis))
        self.candidates = sum(len(block.inside) for block in self._blocks)
        self.region: Region | None = None
        self._greatest = np.full(3, _NONE)
        self._singles: dict[str, tuple[float, Region]] = {}
        self._first_score, self._score_of = np.zeros(0, dtype=np.int32), np.zeros(0, np.float32)
        rows, told = self._failed[None, :].astype(np.float32), 0.0
        for block in self._blocks:
            score = self._scores(block, rows)[:, 0]
            best = int(score.argmax())
            self._greatest[block.family] = max(self._greatest[block.family], score[best])
            penalty = float(size_penalty(block.inside[best], len(self._failed)))
            worth = float(score[best]) + penalty
            if block.family == _ONE:
                self._singles[block.axes[0].part.feature] = float(score[best]), block.region(best)
            worth /= 1.0 if block.family == _ONE else math.sqrt(DISCOUNT)
            if worth > told:
                self.region, told = block.region(best), worth
        self._shuffled = np.zeros((0, 3))
        self._inside = None if self.region is None else self.region.mask(frame)

    def p_value(self, alpha: float, rng: np.random.Generator) -> tuple[float, bool]:
        """P value of the best region under the hypothesis of no cause.

        Args:
            alpha: the permutations end when the value is clearly above it.
            rng: generator for the permutations.

        Returns:
            The p value, and whether it is an upper bound.
        """
        if self._inside is None:
            return 1.0, False
        bound = self.candidates * hoeffding_bound(self._failed, self._inside)
        if bound < 1 / (SHUFFLES + 1):
            self._shuffle(_SHUFFLES_OF_BOUND, rng)  # needed by the intervals
            return bound, True
        self._tabulate()
        self._shuffle(_FIRST_SHUFFLES, rng)
        if self._rank() <= _HOPELESS * alpha:
            self._shuffle(SHUFFLES - _FIRST_SHUFFLES, rng)
        return self._rank(), False

    def _rank(self) -> float:
        usual = np.array([np.quantile(each, 1 - level) for each, level in zip(
            self._shuffled.T, _LEVELS, strict=True)])
        usual[usual <= _NONE] = -_NONE  # a family without candidates never exceeds anything
        here = float((self._greatest - usual).max())
        there = (self._shuffled - usual).max(axis=1)
        return (1 + int((there >= here - 1e-9).sum())) / (1 + len(there))

    def deviance(self, inside: int) -> float:
        """Log likelihood ratio that bounds the error of every region's rate in 95 % of cases.

        Args:
            inside: number of runs in the region.
        """
        greatest = self._shuffled.max(axis=1)
        usual = float(np.quantile(greatest, 1 - _LEVEL))
        root = max(usual, 0.0) + float(size_penalty(np.array([inside]), len(self._failed))[0])
        return root**2 / 2 + _OF_ONE_RATE

    def single(self, features: Collection[str]) -> Region:
        """The best region of one feature, of these if there are any."""
        among = [self._singles[name] for name in features or self._singles]
        return max(among, key=lambda one: one[0])[1]

    def p_single(self) -> float:
        """P value of the best region of one feature among these, after :meth:`p_value`."""
        above = int((self._shuffled[:, _ONE] >= self._greatest[_ONE] - 1e-9).sum())
        return (1 + above) / (1 + len(self._shuffled))

    def p_given(self, feature: str, rng: np.random.Generator) -> float:
        """P value under the hypothesis that this feature alone matters, if any does.

        Args:
            feature: name of the feature.
            rng: generator for the permutations.
        """
        blocks, cells = self._with(feature)
        order = np.argsort(cells, kind='stable')
        shuffled = np.argsort(cells + rng.random((_SHUFFLES_GIVEN, len(cells))), axis=1)
        rows = np.tile(self._failed, (1 + _SHUFFLES_GIVEN, 1)).astype(np.float32)
        rows[1:, order] = self._failed[shuffled]
        best = np.full(len(rows), _NONE)
        with threadpool_limits(limits=1):
            for block in blocks:
                np.maximum(best, self._scores(block, rows).max(axis=0), out=best)
        return float((best >= best[0] - 1e-9).mean())

    def _with(self, feature: str) -> tuple[list[_Block], Ints]:
        """The blocks of a feature and another one, and its cell of each run."""
        blocks = [block for block in self._blocks if block.family != _ONE and any(
            feature in axis.part.names for axis in block.axes)]
        cells = next(block.axes[0].places for block in self._blocks
                     if block.axes[0].part.names == (feature,))
        return blocks, cells

    def _shuffle(self, times: int, rng: np.random.Generator) -> None:
        rows = rng.permuted(np.tile(self._failed, (times, 1)), axis=1).astype(np.float32)
        greatest = np.full((times, 3), _NONE)
        # On a busy machine BLAS threads slow down matrices of this size tenfold.
        with threadpool_limits(limits=1):
            for block in self._blocks:
                score = self._scores(block, rows).max(axis=0)
                np.maximum(greatest[:, block.family], score, out=greatest[:, block.family])
        self._shuffled = np.concatenate([self._shuffled, greatest])

    def _scores(self, block: _Block, rows: Floats32) -> Floats32:
        """Score of each candidate, per row of outcomes: (candidates, rows)."""
        failures = block.failures(rows)
        if not len(self._score_of):
            return self._score(failures, block.inside[:, None])
        places = failures.astype(np.int32)
        places += self._first_score[block.inside.astype(np.int32)][:, None]
        return self._score_of.take(places)

    def _tabulate(self) -> None:
        """Tabulate all possible scores by runs inside and failures among them."""
        runs, all_failures = len(self._failed), int(self._failed.sum())
        sizes = np.unique(np.concatenate([block.inside for block in self._blocks]))
        self._first_score = np.full(runs + 1, 0, dtype=np.int32)
        self._first_score[sizes.astype(np.int32)] = np.arange(len(sizes)) * (all_failures + 1)
        failures = np.minimum(np.arange(all_failures + 1)[None, :], sizes[:, None])
        self._score_of = self._score(failures, sizes[:, None]).ravel()

    def _score(self, failures: npt.NDArray[Any], inside: Floats32) -> Floats32:
        """Root of twice the ratio minus its size penalty; -inf for too few runs."""
        runs = len(self._failed)
        ratio = likelihood_ratio(failures, inside, int(self._failed.sum()), runs)
        penalty = size_penalty(inside, runs)
        penalty[np.minimum(inside, runs - inside) < least_runs(runs)] = np.inf
        scores: Floats = np.sqrt(2 * np.maximum(ratio, 0.0)) - penalty
        return scores.astype(np.float32)

_OF_ONE_RATE = 1.92
"""Half the 95 % quantile of chi-square with one degree of freedom: for the rate of all runs."""


class SearchScan(Scan):
    """The same where scenes may have been chosen by earlier outcomes, tested by e-values.

    Regions are cut by the first runs, and tested by the others.
    """

    def __init__(self, frame: pd.DataFrame) -> None:
        """Evaluate all candidates.

        Args:
            frame: runs with features and ``failed``, in the order in which they were requested.
        """
        first = max(1, round(_LEARNING * len(frame)))
        super().__init__(frame.iloc[first:], frame.iloc[:first])

    def p_value(self, alpha: float, rng: np.random.Generator) -> tuple[float, bool]:
        """Like that of the base class; half of the weight is on regions of one feature."""
        families = [self._of_family(family) for family in range(3)]
        evidence = [self._log_evidence(blocks) for blocks in families if blocks]
        if not evidence:
            return 1.0, True
        weights = np.array([2.0, *[1.0] * (len(evidence) - 1)])
        return _p_of(float(logsumexp(evidence, b=weights / weights.sum()))), True

    def p_single(self) -> float:
        """P value of all regions of one feature together."""
        return _p_of(self._log_evidence(self._of_family(_ONE)))

    def p_given(self, feature: str, rng: np.random.Generator) -> float:
        """Like that of the base class, with few cells, as the rate of each is unknown."""
        every = [self._evidence_given(block, axis) for block in self._of_family(_TWO)
                 for axis in range(2) if block.axes[axis].part.feature == feature]
        return _p_of(_log_mean(np.concatenate(every))) if every else 1.0

    def _evidence_given(self, block: _Block, axis: int) -> Floats:
        """Log e-value of each candidate against 'one rate in each cell of one of the axes'.

        A cell of which a candidate has all or nothing says nothing and is left out.
        """
        sizes = [each.members.shape[1] for each in block.axes]
        cell_of = np.indices(sizes)[axis].ravel()
        total = np.zeros(len(block.inside))
        for cell in range(sizes[axis]):
            there = cell_of == cell
            parts = _counts(block.axes, there.astype(np.float32)[:, None])[:, 0]
            runs = block.axes[axis].places == cell
            rows = np.array([runs, runs & self._failed], dtype=np.float32)
            inside, failures = block.failures(rows).T
            evidence = log_evidence(failures, inside, int(rows[1].sum()), int(rows[0].sum()))
            total += np.where((parts > 0) & (parts < there.sum()), evidence, 0.0)
        return total

    def _of_family(self, family: int) -> list[_Block]:
        return [block for block in self._blocks if block.family == family]

    def _log_evidence(self, blocks: Sequence[_Block]) -> float:
        """Log of the mean e-value of all candidates against 'one rate'."""
        rows = self._failed[None, :].astype(np.float32)
        return _log_mean(np.concatenate([
            log_evidence(block.failures(rows)[:, 0], block.inside, int(self._failed.sum()),
                         len(self._failed)) for block in blocks]))


def _log_mean(evidence: Floats) -> float:
    return float(logsumexp(evidence)) - math.log(len(evidence))


def _p_of(evidence: float) -> float:
    return math.exp(-max(evidence, 0.0))


def least_runs(runs: int) -> int:
    """Minimum number of runs of a candidate."""
    return max(8, runs // 200)


def goes_round(feature: str, values: Floats) -> bool:
    """Whether an interval of a feature may wrap around, as a night does."""
    if feature not in PERIODS:
        return False
    period = PERIODS[feature]
    return bool(period * (1 - _WRAPS) <= values.max() - values.min() <= period)


def _blocks(frame: pd.DataFrame, basis: pd.DataFrame) -> Iterator[_Block]:
    runs = len(frame)
    fine, coarse = int(np.clip(runs // 10, 10, 40)), int(np.clip(runs**0.5 / 2.5, 4, 8))
    features = varied(basis)
    for feature in features:
        if (axis := _axis(feature, frame, basis, fine, subsets)) is not None:
            yield _block(_ONE, (axis,), runs)
    for axis in _slants(frame, basis, max(10, fine // 2)):
        yield _block(_SLANT, (axis,), runs)
    crossed = {
        feature: axis for feature in features
        if (axis := _axis(feature, frame, basis, coarse, neighbours)) is not None
    }
    for one, other in itertools.combinations(crossed, 2):
        if one.source != other.source:
            yield _block(_TWO, (crossed[one], crossed[other]), runs)


def _axis(
    feature: Feature, frame: pd.DataFrame, basis: pd.DataFrame, most: int,
    sets: Callable[[int], Floats32],
) -> _Axis | None:
    """The feature divided into cells, or None if it has too many words or only one cell."""
    if feature.numeric:
        part = Interval(feature=feature.name, low=None, high=None)
        values, cut_by = (one[feature.name].to_numpy(dtype=np.float64) for one in (frame, basis))
        return _numeric(part, values, cut_by, most)
    kinds = kinds_present(feature, basis)
    if not 2 <= len(kinds) <= _MOST_KINDS:
        return None
    codes = pd.Index(kinds).get_indexer(pd.Index(frame[feature.name])).astype(np.int64)
    empty = np.zeros(0)
    # A word that only occurs later is assigned to the last cell.
    return _Axis(Kinds(feature=feature.name, kinds=kinds), empty, empty,
                 np.where(codes < 0, len(kinds) - 1, codes), sets(len(kinds)))


def _numeric(
    part: Interval | Slant, values: Floats, cut_by: Floats, most: int
) -> _Axis | None:
    firsts, lasts, places = interval_cells(cut_by, most)
    if len(firsts) < 2:
        return None
    if values is not cut_by:
        places = np.maximum(np.searchsorted(firsts, values, side='right') - 1, 0)
    round_about = isinstance(part, Interval) and goes_round(part.feature, cut_by)
    members = around_the_clock(len(firsts)) if round_about else neighbours(len(firsts))
    return _Axis(part, firsts, lasts, places, members)


def _slants(frame: pd.DataFrame, basis: pd.DataFrame, most: int) -> Iterator[_Axis]:
    """Sums of two features, scaled so that both vary about equally."""
    for one, other in itertools.combinations(varied(basis, _SLANTED), 2):
        ranges = [float(np.ptp(basis[feature.name])) for feature in (one, other)]
        for slope, sign in itertools.product(_SLOPES, (1, -1)):
            factor = float(f'{sign * slope * ranges[0] / ranges[1]:.2g}')
            part = Slant(feature=one.name, other=other.name, factor=factor, low=None, high=None)
            axis = _numeric(part, part.values(frame), part.values(basis), most)
            if axis is not None:
                yield axis


def _block(family: int, axes: tuple[_Axis, ...], runs: int) -> _Block:
    cells, places = 1, np.zeros(runs, dtype=np.int64)
    for axis in axes:
        cells *= axis.members.shape[1]
        places = places * axis.members.shape[1] + axis.places
    runs_of_cell = csr_array(
        (np.ones(runs, dtype=np.float32), (places, np.arange(runs))), shape=(cells, runs))
    counts = np.bincount(places, minlength=cells).astype(np.float32)
    return _Block(family, axes, runs_of_cell, _counts(axes, counts[:, None])[:, 0])


def _counts(axes: Sequence[_Axis], of_cells: Floats32) -> Floats32:
    """Sums over the cells of each candidate, from sums of each cell: (candidates, rows)."""
    if len(axes) == 1:
        return np.asarray(axes[0].members @ of_cells)
    one, other = axes
    shape = (one.members.shape[1], other.members.shape[1], -1)
    joint = of_cells.reshape(shape)
    rows = joint.shape[2]
    both = _crossed(one.members, other.members, joint)
    first, second = (beginnings(axis.members.shape[1]) for axis in axes)
    alone = np.tensordot(first, joint.sum(axis=1), 1)[:, None, :]
    beside = np.tensordot(second, joint.sum(axis=0), 1)[None, :, :]
    either = alone + beside - 2 * _crossed(first, second, joint)
    whole = joint.sum(axis=(0, 1))
    return np.concatenate([
        both.reshape(-1, rows), either.reshape(-1, rows), (whole - either).reshape(-1, rows),
    ])


def _crossed(one: Floats32, other: Floats32, joint: Floats32) -> Floats32:
    first = np.tensordot(one, joint, 1)
    return np.matmul(other, first)
