"""The search space: the random choices of a program, each mapped to the unit interval.

A sampler proposes *quantiles* of the program's prior, and the program's inverse distribution
function turns them into values. A point that is uniform in the unit cube is therefore a draw from
the prior. Random numbers depend on the run number and no state, so those of any run can be
generated at any time.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np

from taxinet_ros.errors import UsageError

Point = tuple[float | None, ...]
"""One quantile in [0, 1) per dimension; None for a dimension that is idle at this point."""
IDLE = -1
"""Bin number of an idle dimension."""
BELOW_ONE = math.nextafter(1.0, 0.0)
"""The largest quantile."""


class Branch(NamedTuple):
    """Categories of another dimension under which a choice is made.

    Attributes:
        parent: name of the other dimension, which is discrete.
        categories: the category numbers.
    """

    parent: str
    categories: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Dimension:
    """One random choice of a program.

    Attributes:
        name: unique in its space, and readable: ``ego.position.x``, ``time_of_day_h``, ``weather``.
        weights: prior weight of each category of a discrete choice; each category owns an interval
            of quantiles as long as its share, in this order. Empty: the choice is continuous.
        low, high: values at quantile 0 and 1 of a continuous choice, for display only.
        buckets: number of equal slices of a continuous choice for samplers that keep histograms.
        when: the choice is made if one of these branches is taken, and is idle otherwise: it then
            has no coordinate and no influence. Empty: it is always made.
    """

    name: str
    weights: tuple[float, ...] = ()
    low: float = 0.0
    high: float = 1.0
    buckets: int = 10
    when: tuple[Branch, ...] = ()

    def __post_init__(self) -> None:
        """Validate the weights and buckets.

        Raises:
            UsageError: a weight is negative or not finite, all are zero, or there are no buckets.
        """
        if any(not math.isfinite(weight) or weight < 0 for weight in self.weights):
            raise UsageError(f'{self.name}: weights {self.weights}: need to be finite, 0 or more')
        if self.weights and not sum(self.weights) > 0:
            raise UsageError(f'{self.name}: weights {self.weights}: one has to be above 0')
        if self.buckets < 1:
            raise UsageError(f'{self.name}: {self.buckets} buckets, needs to be 1 or more')

    @property
    def discrete(self) -> bool:
        """Whether it is a choice among categories."""
        return bool(self.weights)

    @property
    def edges(self) -> tuple[float, ...]:
        """Quantiles 0 … 1 between its bins: its categories, or its buckets."""
        return _edges(self.weights, self.buckets)

    @property
    def prior(self) -> tuple[float, ...]:
        """Prior probability of each bin; they sum to 1."""
        return tuple(high - low for low, high in pairwise(self.edges))

    def bin(self, quantile: float) -> int:
        """Number of the category or bucket that owns a quantile in [0, 1)."""
        return bisect_right(self.edges, quantile) - 1


@cache
def _edges(weights: tuple[float, ...], buckets: int) -> tuple[float, ...]:
    if not weights:
        return tuple(number / buckets for number in range(buckets + 1))
    total = math.fsum(weights)
    inner = (math.fsum(weights[:number]) / total for number in range(len(weights)))
    return (*inner, 1.0)


class Space(tuple[Dimension, ...]):
    """The dimensions of a program, in the order of a point's coordinates.

    A dimension may depend on others (:attr:`Dimension.when`), which precede it.
    """

    _branches: tuple[tuple[tuple[int, frozenset[int]], ...], ...]

    def __new__(cls, dimensions: Iterable[Dimension]) -> Self:
        """Create a space; validate the names and dependencies of its dimensions.

        Raises:
            UsageError: two share a name, or one depends on no category of an earlier one.
        """
        space = super().__new__(cls, dimensions)
        numbers: dict[str, int] = {}
        branches = []
        for number, dimension in enumerate(space):
            for parent, categories in dimension.when:
                last = len(space[numbers[parent]].weights) - 1 if parent in numbers else -1
                if not categories or not 0 <= min(categories) <= max(categories) <= last:
                    raise UsageError(f'{dimension.name}: {parent} has no categories {categories}')
            if dimension.name in numbers:
                raise UsageError(
                    f'two dimensions have the name {dimension.name}; give each its own'
                )
            numbers[dimension.name] = number
            branches.append(tuple(
                (numbers[parent], frozenset(categories)) for parent, categories in dimension.when
            ))
        space._branches = tuple(branches)
        return space

    def active(self, number: int, bins: Sequence[int]) -> bool:
        """Whether a dimension's choice is made, given the bins of all dimensions before it."""
        branches = self._branches[number]
        return not branches or any(bins[parent] in taken for parent, taken in branches)

    def point(self, quantiles: Iterable[float]) -> Point:
        """The point with these quantiles 0 … 1 in its active dimensions.

        A 1, which rounding may give, is moved just below. The quantile of an idle dimension is
        dropped, so a point that is uniform in the unit cube gives a draw from the prior.
        """
        point: list[float | None] = []
        bins: list[int] = []
        for number, (dimension, quantile) in enumerate(zip(self, quantiles, strict=True)):
            if self.active(number, bins):
                coordinate = min(float(quantile), BELOW_ONE)
                point.append(coordinate)
                bins.append(dimension.bin(coordinate))
            else:
                point.append(None)
                bins.append(IDLE)
        return tuple(point)

    def bins(self, point: Point) -> tuple[int, ...]:
        """Bin of each coordinate; :data:`IDLE` for an idle dimension."""
        return tuple(
            IDLE if quantile is None else dimension.bin(quantile)
            for dimension, quantile in zip(self, point, strict=True)
        )

    def check(self, point: Point) -> None:
        """Check that a point belongs to this space.

        Raises:
            ValueError: it lacks a quantile in [0, 1) for an active dimension, or has one for an
                idle one.
        """
        if len(point) != len(self):
            raise ValueError(f'{len(point)} quantiles for {len(self)} dimensions')
        if not all(quantile is None or 0 <= quantile < 1 for quantile in point):
            raise ValueError(f'point {point}: quantiles have to be within [0, 1)')
        bins = self.bins(point)
        for number, dimension in enumerate(self):
            if self.active(number, bins) != (point[number] is not None):
                what = 'is idle' if point[number] is not None else 'has no quantile'
                raise ValueError(f'point {point}: {dimension.name} {what} there')


def alike(space: Space, one: Point, other: Point, apart: float) -> bool:
    """Whether two points have the same categories, and no coordinate differs by more than this.

    Args:
        space: theirs.
        one: a point.
        other: another one; a dimension that is idle at one of them only makes them differ.
        apart: greatest difference [quantiles].
    """
    for dimension, mine, its in zip(space, one, other, strict=True):
        if mine is None or its is None:
            same = mine is its
        elif dimension.discrete:
            same = dimension.bin(mine) == dimension.bin(its)
        else:
            same = abs(mine - its) <= apart
        if not same:
            return False
    return True


def make_space(dimensions: Iterable[Dimension]) -> Space:
    """Make a space of the dimensions.

    Raises:
        UsageError: there are no dimensions, or they are inconsistent.
    """
    space = Space(dimensions)
    if not space:
        raise UsageError('the program makes no random choice, so there is nothing to search')
    return space


def run_generator(
    seed: int, index: int, attempt: int = 0, *, stream: int = 0
) -> np.random.Generator:
    """Random numbers of run ``index`` (0, 1, …) in a campaign with a seed (0 or more).

    Args:
        seed: seed of the campaign.
        index: number of the run.
        attempt: number of points of this run rejected before.
        stream: different streams have independent numbers for the same run.
    """
    key = (index, attempt, stream) if stream else (index, attempt) if attempt else (index,)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def prior_point(space: Space, seed: int, index: int, attempt: int = 0) -> Point:
    """The point of run ``index`` if it is drawn from the prior."""
    return space.point(run_generator(seed, index, attempt).random(len(space)))
