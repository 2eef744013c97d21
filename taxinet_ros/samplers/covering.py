"""A sampler that covers combinations of cells: where no run has been, one goes next.

Every t of the cells of a scene are a combination (t = 2: pairs); testing all of them is t-wise
coverage (Cohen, Dalal, Fredman, Patton: The AETG system, IEEE TSE 23, 1997, whose greedy choice of
the best of several candidates this follows). Which cells a point is in may be anything, such as the
cells of an operational design domain (:mod:`taxinet_ros.trials.odd`) of the scene that the
program makes of the point. So combinations are not built but looked for: candidates are draws of
the program, and crosses of points that have been in the wanted cells.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from taxinet_ros.samplers.sampler import Proposer
from taxinet_ros.samplers.space import IDLE, Point, Space, run_generator

Cells = tuple[int, ...]
"""A cell per parameter; negative where a scene has none."""
Wanted = Mapping[tuple[int, ...], npt.NDArray[np.bool_]]
"""Which combinations to cover, for each set of parameters: an axis for each of them."""

_STREAM = 2
_STEP = 0.04
"""Standard deviation by which a cross differs from its parents [quantiles]."""
_POOL, _MOST_POOL = 128, 4096
_DRAWS, _TARGETS, _CROSSES, _IMPROVEMENTS = 4, 3, 4, 8
_SEARCHES = 4
"""How often a combination that no point has been in is looked for, each time by some crosses."""
_DEEPEST = 5
"""Number of times from which on it is all the same how often a combination has been run."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Reach:
    """How far a search has come.

    Attributes:
        wanted: number of combinations to cover.
        covered: number of those in a run.
        seen: number of those in a run or in any point looked at.
        points: number of points looked at.
        unseen: combinations that no point has been in, as (parameters, cells).
    """

    wanted: int
    covered: int
    seen: int
    points: int
    unseen: tuple[tuple[tuple[int, ...], Cells], ...]


class Covering(Proposer):
    """Proposes the point whose scene has the most combinations with the fewest runs.

    A run without a result covers nothing, so its combinations are wanted again.
    """

    def __init__(
        self, space: Space, seed: int, wanted: Wanted, cells: Callable[[Point], Cells | None]
    ) -> None:
        """Create it.

        Args:
            space: the space to search.
            seed: seed of the campaign.
            wanted: the combinations to cover.
            cells: cells of the scene of a point; None if it is of no use.
        """
        self._space, self._seed, self._cells = space, seed, cells
        self._wanted = dict(wanted)
        self._runs = {each: np.zeros(mask.shape, dtype=np.int64) for each, mask in wanted.items()}
        self._seen = {each: np.zeros(mask.shape, dtype=bool) for each, mask in wanted.items()}
        self._searched = {each: np.zeros(mask.shape, dtype=np.int64)
                          for each, mask in wanted.items()}
        # A combination is worth more than all of a scene that have been run once more often.
        self._base = float(len(self._wanted) + 1)
        self._points: list[Point] = []
        self._places: list[Cells] = []
        self._used: set[int] = set()
        self._asked: list[Cells | None] = []
        self._attempt = 0
        self._looked = 0

    def ask(self) -> Point:
        """The next point."""
        if not self._asked:
            for number in range(_POOL):
                chance = run_generator(self._seed, number, stream=_STREAM + 1)
                self._look(self._space.point(chance.random(len(self._space))))
        self._asked.append(None)
        self._attempt = 0
        return self._choose()

    def again(self) -> Point:
        """Another point for the same run, in place of one that the program refused."""
        self._count(self._asked[-1], -1)
        self._attempt += 1
        return self._choose()

    def tell(self, index: int, rho: float | None) -> None:
        """Want the combinations of a run without a result again."""
        if rho is None:
            self._count(self._asked[index], -1)

    def add(self, point: Point, rho: float) -> None:
        """Count a run that the program itself drew."""
        self._count(self._cells(point), 1)

    def reach(self) -> Reach:
        """How far the search has come."""
        unseen = tuple(
            (each, tuple(int(one) for one in place))
            for each, mask in self._wanted.items()
            for place in np.argwhere(mask & ~self._seen[each])
        )
        return Reach(
            wanted=sum(int(mask.sum()) for mask in self._wanted.values()),
            covered=sum(int((mask & (self._runs[each] > 0)).sum())
                        for each, mask in self._wanted.items()),
            seen=sum(int((mask & self._seen[each]).sum()) for each, mask in self._wanted.items()),
            points=self._looked, unseen=unseen,
        )

    def _choose(self) -> Point:
        chance = run_generator(self._seed, len(self._asked) - 1, self._attempt, stream=_STREAM)
        self._thin_out()
        best = self._best_of_pool()
        for _ in range(_DRAWS):
            best = self._better(best, self._space.point(chance.random(len(self._space))))
        for parents in self._targets(chance):
            for _ in range(_CROSSES):
                best = self._better(best, self._cross(parents, chance))
        for _ in range(_IMPROVEMENTS):
            if best is None or not self._points:
                break
            other = int(chance.integers(len(self._points)))
            best = self._better(best, self._cross([best, other], chance, keep=0.7))
        if best is None:  # no point looked at is of use, so the run will tell what the program does
            return self._space.point(chance.random(len(self._space)))
        self._used.add(best)
        self._asked[-1] = self._places[best]
        self._count(self._asked[-1], 1)
        return self._points[best]

    def _best_of_pool(self) -> int | None:
        free = [number for number in range(len(self._points)) if number not in self._used]
        if not free:
            return None
        places = np.array([self._places[number] for number in free])
        gains = np.zeros(len(free))
        for each, mask in self._wanted.items():
            columns = places[:, each]
            known = (columns >= 0).all(axis=1)
            at = tuple(np.where(known, columns[:, axis], 0) for axis in range(len(each)))
            gains += np.where(known & mask[at], self._worth(self._runs[each][at]), 0.0)
        return free[int(np.argmax(gains))]

    def _worth(self, runs: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        worth: npt.NDArray[np.float64] = self._base ** -np.minimum(runs, _DEEPEST).astype(float)
        return worth

    def _gain(self, cells: Cells) -> float:
        gain = 0.0
        for each, mask in self._wanted.items():
            at = tuple(cells[one] for one in each)
            if min(at) >= 0 and mask[at]:
                gain += self._base ** -min(int(self._runs[each][at]), _DEEPEST)
        return gain

    def _better(self, best: int | None, point: Point) -> int | None:
        """The better of a point of the pool and a new one, which joins the pool."""
        number = self._look(point)
        if number is None or (
            best is not None
            and self._gain(self._places[number]) <= self._gain(self._places[best])
        ):
            return best
        return number

    def _look(self, point: Point) -> int | None:
        """Number of a new point in the pool; None if it is of no use."""
        self._looked += 1
        cells = self._cells(point)
        if cells is None:
            return None
        for each, seen in self._seen.items():
            at = tuple(cells[one] for one in each)
            if min(at) >= 0:
                seen[at] = True
        self._points.append(point)
        self._places.append(cells)
        return len(self._points) - 1

    def _thin_out(self) -> None:
        """Keep the better half of a pool that has become too large."""
        if len(self._points) <= _MOST_POOL:
            return
        free = [number for number in range(len(self._points)) if number not in self._used]
        free.sort(key=lambda number: -self._gain(self._places[number]))
        kept = sorted(free[:_MOST_POOL // 2])
        self._points = [self._points[number] for number in kept]
        self._places = [self._places[number] for number in kept]
        self._used = set()

    def _targets(self, chance: np.random.Generator) -> list[list[int]]:
        """Points that have been in the cells of combinations that none has been in at once."""
        open_ones = [
            (each, tuple(place)) for each, mask in self._wanted.items()
            for place in np.argwhere(
                mask & ~self._seen[each] & (self._searched[each] < _SEARCHES)
            )
        ]
        found = []
        for pick in chance.permutation(len(open_ones))[:_TARGETS]:
            each, place = open_ones[pick]
            self._searched[each][place] += 1
            parents = []
            for one, cell in zip(each, place, strict=True):
                there = [number for number, cells in enumerate(self._places) if cells[one] == cell]
                if there:
                    parents.append(there[int(chance.integers(len(there)))])
            if len(parents) == len(each) > 1:
                found.append(parents)
        return found

    def _cross(
        self, parents: Sequence[int], chance: np.random.Generator, keep: float | None = None
    ) -> Point:
        """A point with each coordinate from one parent, moved; ``keep``: share of the first one."""
        count, width = len(parents), len(self._space)
        shares = None if keep is None else [keep, *[(1 - keep) / (count - 1)] * (count - 1)]
        whose = chance.choice(count, size=width, p=shares)
        moves, fill = chance.normal(0.0, _STEP, width), chance.random(width)
        quantiles = []
        for number, (pick, move) in enumerate(zip(whose, moves, strict=True)):
            value = self._points[parents[pick]][number]
            moved = fill[number] if value is None else abs(value + move)
            quantiles.append(float(2 - moved if moved > 1 else moved))
        return self._space.point(quantiles)

    def _count(self, cells: Cells | None, by: int) -> None:
        if cells is None:
            return
        for each, runs in self._runs.items():
            at = tuple(cells[one] for one in each)
            if min(at) >= 0:
                runs[at] += by


def own_cells(space: Space, number: int, strength: int) -> tuple[
    Wanted, Callable[[Point], Cells | None]
]:
    """Cells of the program's own choices: options, and equal parts of the quantiles.

    Args:
        space: the space to search.
        number: parts of each continuous choice.
        strength: number of cells in a combination; no more than there are choices.
    """
    possible = [
        np.array([share > 0 for share in one.prior]) if one.discrete else np.ones(number, bool)
        for one in space
    ]

    def cells(point: Point) -> Cells:
        return tuple(
            IDLE if value is None else one.bin(value) if one.discrete else int(value * number)
            for one, value in zip(space, point, strict=True)
        )

    wanted = {}
    for each in itertools.combinations(range(len(space)), min(strength, len(space))):
        mask = possible[each[0]]
        for one in each[1:]:
            mask = np.logical_and.outer(mask, possible[one])
        wanted[each] = mask
    return wanted, cells
