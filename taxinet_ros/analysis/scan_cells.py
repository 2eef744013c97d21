"""Features in cells with about equally many runs, and what regions can be made of cells."""

from __future__ import annotations

import functools
import itertools

import numpy as np
import numpy.typing as npt

from taxinet_ros.analysis.group_rates import Floats

Ints = npt.NDArray[np.int64]
Floats32 = npt.NDArray[np.float32]


def interval_cells(values: Floats, most: int) -> tuple[Floats, Floats, Ints]:
    """Cut a feature into cells with about equally many runs each.

    Equal values stay together. The ends of a cell are values of runs.

    Returns:
        The least and the greatest value of each cell, and the cell of each value.
    """
    ordered = np.sort(values)
    firsts = np.unique(ordered[(np.arange(most) * len(ordered)) // most])
    # A value that many runs share is a cell of its own, such as no rain.
    common, counts = np.unique(ordered, return_counts=True)
    many = common[counts > len(ordered) / most]
    after = common[np.minimum(np.searchsorted(common, many) + 1, len(common) - 1)]
    firsts = np.unique(np.concatenate([firsts, many, after]))
    places = np.searchsorted(firsts, values, side='right') - 1
    ends = np.append(np.searchsorted(ordered, firsts[1:]), len(ordered)) - 1
    return firsts, ordered[ends], places.astype(np.int64)


@functools.cache
def neighbours(cells: int) -> Floats32:
    """All runs of neighbouring cells, but not all cells: (candidates, cells)."""
    pairs = [(low, high) for low in range(cells) for high in range(low + 1, cells + 1)
             if high - low < cells]
    numbers = np.arange(cells)
    chosen = [(numbers >= low) & (numbers < high) for low, high in pairs]
    return np.array(chosen, dtype=np.float32).reshape(-1, cells)


@functools.cache
def around(cells: int) -> Floats32:
    """All runs of neighbouring cells where the last is a neighbour of the first too."""
    inner = neighbours(cells)
    without_ends = inner[(inner[:, 0] == 0) & (inner[:, -1] == 0)]
    return np.concatenate([inner, 1 - without_ends])


@functools.cache
def subsets(kinds: int) -> Floats32:
    """All subsets but none and all: (candidates, kinds)."""
    chosen = list(itertools.product((0, 1), repeat=kinds))[1:-1]
    return np.array(chosen, dtype=np.float32).reshape(-1, kinds)


@functools.cache
def beginnings(cells: int) -> Floats32:
    """The first cell, the first two, and so on, but not all: (candidates, cells)."""
    return np.tri(cells, dtype=np.float32)[:-1]
