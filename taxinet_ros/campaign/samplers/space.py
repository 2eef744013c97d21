"""What a search may vary: the random choices of a program, each seen as a unit interval.

A program's own prior stays in force whatever the sampler does: a sampler proposes *quantiles* of
it, and the program's inverse distribution function turns them into values. A point that is uniform
in the unit cube is therefore a draw from the prior.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

from taxinet_ros.core.errors import UsageError

Point = tuple[float, ...]
"""One quantile in [0, 1) per dimension."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Dimension:
    """One random choice of a program.

    Attributes:
        name: unique in its space, and readable: ``ego.position.x``, ``time_of_day``, ``weather``.
        weights: of a discrete choice, the prior's weight of each category; quantiles fall to the
            categories in this order, each owning an interval as long as its share. Empty: the
            choice is continuous.
        low, high: values at quantile 0 and 1 of a continuous choice, for display only.
        buckets: number of equal slices of a continuous choice for samplers that keep histograms.
    """

    name: str
    weights: tuple[float, ...] = ()
    low: float = 0.0
    high: float = 1.0
    buckets: int = 10

    def __post_init__(self) -> None:
        """Refuse what no sampler could work with.

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
        if not self.discrete:
            return tuple(number / self.buckets for number in range(self.buckets + 1))
        total = math.fsum(self.weights)
        inner = (math.fsum(self.weights[:number]) / total for number in range(len(self.weights)))
        return (*inner, 1.0)

    @property
    def prior(self) -> tuple[float, ...]:
        """Probability of each bin before anything is known; they add up to 1."""
        return tuple(high - low for low, high in pairwise(self.edges))

    def bin(self, quantile: float) -> int:
        """Number of the category or bucket that owns a quantile in [0, 1)."""
        return bisect_right(self.edges, quantile) - 1


Space = tuple[Dimension, ...]
"""The dimensions of a program, in the order of a point's coordinates."""


def make_space(dimensions: Iterable[Dimension]) -> Space:
    """A space of the dimensions.

    Raises:
        UsageError: there are none, or two have one name.
    """
    space = tuple(dimensions)
    if not space:
        raise UsageError('the program makes no random choice, so there is nothing to search')
    names = [dimension.name for dimension in space]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise UsageError(f'two dimensions have the name {twice[0]}; give each its own')
    return space
