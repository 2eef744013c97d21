"""Samplers that do not learn: independent draws, Halton and Sobol points, and the grid.

The grid has every combination of evenly spaced quantiles and of categories, in an order that
covers the space early.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.sampler import Exhausted, Proposer, Sampler
from taxinet_ros.samplers.space import (
    IDLE,
    Dimension,
    Point,
    Space,
    prior_point,
    run_generator,
)

if TYPE_CHECKING:
    from scipy.stats import qmc


BLOCK = 256
"""Number of points computed at once; a power of two, as Sobol sequences require."""


class Random(Sampler):
    """Independent draws: the point of run i depends only on the seed and i."""

    def drawn(self, index: int) -> bool:
        """True: every run is drawn from the prior."""
        return True

    def weight(self, index: int) -> float:
        """1: the point follows the prior."""
        return 1.0

    def __init__(self, space: Space, seed: int) -> None:
        self._space = space
        self._seed = seed
        self._index, self._attempt = -1, 0

    def ask(self) -> Point:
        """The next point."""
        self._index, self._attempt = self._index + 1, 0
        return prior_point(self._space, self._seed, self._index)

    def again(self) -> Point:
        """Another draw for the same run."""
        self._attempt += 1
        return prior_point(self._space, self._seed, self._index, self._attempt)


class QuasiRandom(Proposer):
    """Low-discrepancy points, each marginally uniform.

    A rejected point is replaced by an independent draw, because the next point of the sequence
    depends on the one before it, which would bias accepted points.
    """

    def __init__(self, space: Space, seed: int, engine: qmc.QMCEngine) -> None:
        self._space = space
        self._seed = seed
        self._points = _points(space, engine)
        self._index, self._attempt = -1, 0

    def ask(self) -> Point:
        """The next point."""
        self._index, self._attempt = self._index + 1, 0
        return next(self._points)

    def again(self) -> Point:
        """An independent draw for the same run."""
        self._attempt += 1
        return prior_point(self._space, self._seed, self._index, self._attempt)

    def weight(self, index: int) -> float:
        """1: the point follows the prior."""
        return 1.0


def halton(space: Space, seed: int) -> QuasiRandom:
    """Halton's sequence, its digits permuted at random (Owen, arXiv:1706.02808)."""
    from scipy.stats import qmc  # 0.5 s import that only these two need

    return QuasiRandom(space, seed, qmc.Halton(len(space), scramble=True, rng=seed))


def sobol(space: Space, seed: int) -> QuasiRandom:
    """Sobol's sequence, scrambled (Owen, Journal of Complexity 14, 1998).

    It is best balanced when the number of runs is a power of two: use 1024 rather than 1000.
    """
    from scipy.stats import qmc

    return QuasiRandom(space, seed, qmc.Sobol(len(space), scramble=True, rng=seed))


def _points(space: Space, engine: qmc.QMCEngine) -> Iterator[Point]:
    while True:
        yield from map(space.point, engine.random(BLOCK))


Cell = tuple[float, float, float]
"""Lowest and highest quantile of a cell of one dimension, and its probability."""
MOST_BRANCHES = 10_000
"""Most combinations of options that decide which other choices are made; one grid each."""


class Grid(Proposer):
    """The cells of a full grid, one run in the middle of each; it does not learn.

    A category counts as one cell regardless of its probability, so rare ones are tried as often as
    the others; the weight corrects for this. Each combination of options that decide which other
    choices are made has its own grid: an idle dimension has no cells, so no scene is repeated. When
    all cells have been visited they are visited again in the same order, at a random point in each
    cell; without continuous dimensions the sampler is then exhausted.
    """

    def __init__(self, space: Space, seed: int, runs: int, *, points: int = 0) -> None:
        """Define the grid without enumerating it.

        Args:
            space: the space to search.
            seed: seed of the campaign; determines the order of the cells.
            runs: number of runs that the grid should fit.
            points: cells per continuous dimension; 0 for as many as fit the runs.

        Raises:
            UsageError: more than :data:`MOST_BRANCHES` combinations of options decide what else is
                chosen.
        """
        self._space = space
        self._seed = seed
        branches = _branches(space)
        sizes = _sizes(space, branches, runs, points)
        cells = [_cells(each, size) for each, size in zip(space, sizes, strict=True)]
        self._grids = [_Subgrid(space, cells, bins, seed) for bins in branches]
        self.cells = sum(grid.order.cells for grid in self._grids)
        self._finite = all(dimension.discrete for dimension in space)
        self._visits = 0
        self._weights: list[float] = []

    def ask(self) -> Point:
        """The next point."""
        self._weights.append(0.0)
        return self.again()

    def again(self) -> Point:
        """The next point of the grid, for the same run."""
        if self._finite and self._visits == self.cells:
            raise Exhausted(f'all {self.cells} combinations of the grid have been tried')
        # Each grid once, then always the one with the smallest visited share.
        grid = min(self._grids, key=lambda grid: grid.visits / grid.order.cells)
        cells = grid.next()
        self._weights[-1] = math.prod(share for _, _, share in cells) * self.cells
        again, self._visits = self._visits >= self.cells, self._visits + 1
        within = [0.5] * len(cells)
        if again:
            within = run_generator(self._seed, self._visits).random(len(cells)).tolist()
        return self._space.point(
            low + part * (high - low) for (low, high, _), part in zip(cells, within, strict=True)
        )

    def weight(self, index: int) -> float:
        """Probability of the point's cell under the prior over that in the grid."""
        return self._weights[index]


class _Subgrid:
    """The grid of the choices made under one combination of options."""

    def __init__(
        self, space: Space, cells: list[list[Cell]], bins: tuple[int | None, ...], seed: int
    ) -> None:
        """Create it from the cells of every dimension, and the bins of the parent dimensions."""
        self._sides = [
            [(0.0, 0.0, 1.0)] if number == IDLE else
            mine if number is None else [_cell(dimension, number)]
            for dimension, mine, number in zip(space, cells, bins, strict=True)
        ]
        self.order = CellOrder([len(side) for side in self._sides], seed)
        self.visits = 0

    def next(self) -> list[Cell]:
        """The next cell of each dimension; any cell for an idle one."""
        digits = self.order.digits(self.visits)
        self.visits += 1
        return [side[digit] for side, digit in zip(self._sides, digits, strict=True)]


class CellOrder:
    """A one-to-one numbering of the cells of a grid whose prefixes are spread evenly.

    Successive cells, as many as the longest side has, form a Latin hypercube: none of its rows is
    visited twice. The next set is the same, shifted along the other sides by the cell given by this
    order, applied recursively to the grid of those sides.

    Attributes:
        cells: number of cells.
    """

    def __init__(self, sizes: list[int], seed: int) -> None:
        """Number the cells of a grid with these side lengths, shuffled by a seed."""
        self.cells = math.prod(sizes)
        self._sizes = sizes
        self._longest_first = sorted(range(len(sizes)), key=lambda side: -sizes[side])
        chance = np.random.default_rng(seed)
        self._shuffles = {
            (side, level): chance.permutation(sizes[side]).tolist()
            for depth, side in enumerate(self._longest_first) for level in range(depth + 1)
        }

    def digits(self, index: int) -> list[int]:
        """Coordinates of cell ``index``; the numbering wraps around after the last."""
        index %= self.cells
        digits = [0] * len(self._sizes)
        steps: list[int] = []
        for depth, side in enumerate(self._longest_first):
            index, place = divmod(index, self._sizes[side])
            steps.append(place)
            place = self._shuffles[side, depth][place]
            for level in reversed(range(depth)):
                moved = (place + steps[level]) % self._sizes[side]
                place = self._shuffles[side, level][moved]
            digits[side] = place
        return digits


def _branches(space: Space) -> list[tuple[int | None, ...]]:
    """Every combination of options that decide on other choices, as bins.

    :data:`IDLE` is the bin of an idle dimension, None that of an unrestricted choice.
    """
    parents = {parent for dimension in space for parent, _ in dimension.when}
    found = []
    for bins in _combinations(space, parents, ()):
        found.append(bins)
        if len(found) > MOST_BRANCHES:
            raise UsageError(
                f'sampler grid: more than {MOST_BRANCHES} combinations of options decide what '
                'else is chosen; use sobol or random'
            )
    return found


def _combinations(
    space: Space, parents: set[str], bins: tuple[int | None, ...]
) -> Iterator[tuple[int | None, ...]]:
    if len(bins) == len(space):
        yield bins
        return
    dimension = space[len(bins)]
    # None is no category; only parent dimensions decide on others.
    if not space.active(len(bins), [IDLE if each is None else each for each in bins]):
        choices: list[int | None] = [IDLE]
    elif dimension.name in parents:
        choices = [number for number, share in enumerate(dimension.prior) if share > 0]
    else:
        choices = [None]
    for choice in choices:
        yield from _combinations(space, parents, (*bins, choice))


def _sizes(
    space: Space, branches: list[tuple[int | None, ...]], runs: int, points: int
) -> list[int]:
    """Number of cells of each dimension when it is active."""
    sizes = [sum(share > 0 for share in each.prior) if each.discrete else points or 1
             for each in space]
    continuous = [number for number, each in enumerate(space)
                  if not each.discrete and any(bins[number] is None for bins in branches)]
    if points or not continuous:
        return sizes
    for number in cycle(continuous):
        sizes[number] += 1
        if _total(sizes, branches) > runs:
            sizes[number] -= 1
            break
    return sizes


def _total(sizes: list[int], branches: list[tuple[int | None, ...]]) -> int:
    return sum(
        math.prod(size for size, number in zip(sizes, bins, strict=True) if number is None)
        for bins in branches
    )


def _cells(dimension: Dimension, size: int) -> list[Cell]:
    if not dimension.discrete:
        return [(number / size, (number + 1) / size, 1 / size) for number in range(size)]
    return [_cell(dimension, number) for number, share in enumerate(dimension.prior) if share > 0]


def _cell(dimension: Dimension, number: int) -> Cell:
    low, high = dimension.edges[number:number + 2]
    return low, high, dimension.prior[number]
