"""Every combination of evenly spaced quantiles and of categories, in an order that covers early."""

from __future__ import annotations

import math
from itertools import cycle

import numpy as np

from taxinet_ros.campaign.samplers.draws import as_point, generator
from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.samplers.space import Dimension, Point, Space

Cell = tuple[float, float, float]
"""Lowest and highest quantile of a cell of one dimension, and its weight."""


class Grid:
    """The cells of a full grid, one run in the middle of each; nothing is learned.

    A category counts as one cell however likely it is, so the rare ones are tried as often as the
    others; the weight sets that right. When all cells have been visited they are visited again in
    the same order, each run then somewhere within its cell.
    """

    def __init__(self, space: Space, seed: int, runs: int, *, points: int = 0) -> None:
        """Lay the grid; it is not enumerated.

        Args:
            space: what to search.
            seed: of the campaign; gives the order of the cells.
            runs: number of runs that the grid should fit into.
            points: cells per continuous dimension; 0 for as many as fit into the runs.
        """
        self._seed = seed
        self._cells = [_cells(each, size) for each, size in
                       zip(space, _sizes(space, runs, points), strict=True)]
        self._order = CellOrder([len(cells) for cells in self._cells], seed)
        self._asked = 0

    def ask(self) -> Point:
        """The next point."""
        index = self._asked
        self._asked += 1
        within = [0.5] * len(self._cells)
        if index >= self._order.cells:
            within = generator(self._seed, index).random(len(self._cells)).tolist()
        return as_point(
            low + part * (high - low)
            for (low, high, _), part in zip(self._visited(index), within, strict=True)
        )

    def tell(self, index: int, rho: float | None) -> None:
        """Nothing is learned."""

    def weight(self, index: int) -> float:
        """Probability of the point's categories under the prior over that in the grid."""
        return math.prod(weight for _, _, weight in self._visited(index))

    def learned(self) -> Probabilities:
        """Nothing."""
        return {}

    def _visited(self, index: int) -> list[Cell]:
        digits = self._order.digits(index)
        return [cells[digit] for cells, digit in zip(self._cells, digits, strict=True)]


class CellOrder:
    """A one-to-one numbering of the cells of a grid whose beginnings are spread evenly.

    As many successive cells as the longest side has make a Latin hypercube: none of its rows is
    visited twice. The next such set is the same, moved along the other sides by the cell that this
    very order has on the grid of those sides.

    Attributes:
        cells: number of cells.
    """

    def __init__(self, sizes: list[int], seed: int) -> None:
        """Number the cells of a grid with these sides, shuffled by a seed."""
        self.cells = math.prod(sizes)
        self._sizes = sizes
        self._longest_first = sorted(range(len(sizes)), key=lambda side: -sizes[side])
        chance = np.random.default_rng(seed)
        self._shuffles = {
            (side, level): chance.permutation(sizes[side]).tolist()
            for depth, side in enumerate(self._longest_first) for level in range(depth + 1)
        }

    def digits(self, index: int) -> list[int]:
        """Place of cell ``index`` along each side; the numbering begins again after the last."""
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


def _sizes(space: Space, runs: int, points: int) -> list[int]:
    """Number of cells of each dimension."""
    possible = [sum(share > 0 for share in each.prior) for each in space]
    sizes = [size if each.discrete else points or 1
             for each, size in zip(space, possible, strict=True)]
    continuous = [number for number, each in enumerate(space) if not each.discrete]
    if points or not continuous:
        return sizes
    for number in cycle(continuous):
        sizes[number] += 1
        if math.prod(sizes) > runs:
            sizes[number] -= 1
            break
    return sizes



def _cells(dimension: Dimension, size: int) -> list[Cell]:
    if not dimension.discrete:
        return [(number / size, (number + 1) / size, 1.0) for number in range(size)]
    edges, prior = dimension.edges, dimension.prior
    return [(edges[number], edges[number + 1], size * share)
            for number, share in enumerate(prior) if share > 0]
