"""Search from a failing point for the one nearest to nominal that still fails.

Independent of scenarios and runs. A point gives for each axis the number of steps from its nominal
value: the origin is nominal, the start is the known failure. Robustness values are requested by
point and answered in any order; a point fails if its robustness is 0 or less.

The search is delta debugging (Zeller and Hildebrandt, IEEE Trans. Software Eng. 28, 2002), with
axes as its differences: first each axis is set to nominal if the failure survives, then the
remaining ones are bisected, repeatedly until nothing changes. Failure is not monotone: a passing
point may lie between two failing ones. So the result is a local minimum: it fails, and it passes if
any one axis is set to nominal or moved one step closer; some other point even nearer may fail too.
Its failure may also have another cause than the start's.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

Point = tuple[int, ...]
"""Steps away from nominal, one number for each axis."""

Rule = Callable[[Point, int], Point]
"""Makes a point valid after one axis (its number) was moved, by setting others to 0."""

LEAST_ASKED = 2
"""Minimum number of evaluations: the start and the origin."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Axis:
    """One parameter that may be moved towards nominal.

    Attributes:
        steps: number of steps between nominal and the start, 1 or more.
        scan: try the values one by one from nominal, instead of bisecting; for words.
    """

    steps: int
    scan: bool = False


class End(enum.StrEnum):
    """Why a search ended."""

    NOT_YET = ''
    MINIMAL = 'minimal'
    NOMINAL_FAILS = 'nominal fails'
    NOT_REPRODUCED = 'not reproduced'
    SPENT = 'spent'


@dataclass(frozen=True, kw_only=True, slots=True)
class State:
    """Progress of a search.

    Attributes:
        at: the nearest known failing point; the start if even that passes.
        end: why it ended.
    """

    at: Point
    end: End


class ShrinkSearch:
    """The ask-and-tell search; its result is independent of the order of the answers."""

    def __init__(
        self, axes: Sequence[Axis], *, most: int, rule: Rule = lambda point, axis: point,
    ) -> None:
        """Create the search.

        Args:
            axes: one or more.
            most: maximum number of answers to use, :data:`LEAST_ASKED` or more.
            rule: makes a point valid.
        """
        if not axes or any(axis.steps < 1 for axis in axes) or most < LEAST_ASKED:
            raise ValueError(f'axes {axes}, at most {most} answers')
        self.axes = tuple(axes)
        self.start = tuple(axis.steps for axis in axes)
        self.origin = (0,) * len(self.axes)
        self._most = most
        self._rule = rule
        self._answers: dict[Point, float] = {}

    @property
    def wanted(self) -> list[Point]:
        """Points to evaluate, in their order; none if the search has ended.

        Each is needed whatever the answers for the others are, so what is evaluated does not depend
        on how many are at once.
        """
        return self._walk().missing

    def tell(self, point: Point, rho: float) -> None:
        """Record an answer, requested or not."""
        self._answers[point] = rho

    @property
    def state(self) -> State:
        """Current progress."""
        walk = self._walk()
        return State(at=walk.at, end=walk.end)

    def rho(self, point: Point) -> float | None:
        """The answer for a point, or None."""
        return self._answers.get(point)

    def moved(self, point: Point, axis: int, steps: int) -> Point:
        """``point`` with one axis at ``steps``, made valid by the rule."""
        return self._rule((*point[:axis], steps, *point[axis + 1:]), axis)

    def _walk(self) -> _Walk:
        walk = _Walk(self, self._answers, self._most)
        walk.go()
        return walk


class _Stop(Exception):  # noqa: N818 (an end, not an error)
    """The walk cannot continue: answers are missing, or the limit is reached."""


class _Walk:
    """Replay of the search from its start, as far as answers are available.

    It is replayed for every request: a few hundred arithmetic steps, compared to runs of seconds.
    So there is no state that an out-of-order answer could disturb.
    """

    def __init__(self, shrink: ShrinkSearch, answers: Mapping[Point, float], most: int) -> None:
        self.at = shrink.start
        self.end = End.NOT_YET
        self.missing: list[Point] = []
        self.asked: dict[Point, None] = {}
        self._shrink = shrink
        self._answers = answers
        self._most = most
        self._passing: dict[int, int] = {}

    def go(self) -> None:
        """Walk until the end, or until it cannot continue."""
        try:
            self.end = self._search()
        except _Stop:
            self.end = End.NOT_YET if self.missing else End.SPENT

    def _search(self) -> End:
        start, origin = self._shrink.start, self._shrink.origin
        rhos = self._ask([start, origin])
        if rhos[start] > 0:
            return End.NOT_REPRODUCED
        if rhos[origin] <= 0:
            self.at = origin
            return End.NOMINAL_FAILS
        before: Point = ()
        while self.at != before:
            before = self.at
            self._take_back()
            for axis in range(len(before)):
                self._narrow(axis)
        return End.MINIMAL

    def _take_back(self) -> None:
        """Set whole axes to nominal until no more can be without losing the failure."""
        while True:
            singles = [
                self._shrink.moved(self.at, axis, 0) for axis, steps in enumerate(self.at) if steps
            ]
            rhos = self._ask(singles)
            failing = sorted((point for point in rhos if rhos[point] <= 0), key=rhos.__getitem__)
            if failing:
                # All at once if that still fails, else the one that leaves the worst failure.
                self.at = failing[0]
                together = tuple(map(min, *failing)) if len(failing) > 1 else failing[0]
                if self._fails(together):
                    self.at = together
            if len(rhos) < len(singles):
                raise _Stop
            if not failing:
                return

    def _narrow(self, axis: int) -> None:
        """Move one axis as near to nominal as the failure allows; at nominal it passes."""
        high = self.at[axis]
        if self._shrink.axes[axis].scan:
            next((steps for steps in range(1, high) if self._try(axis, steps)), None)
            return
        # What passed in the last round most likely still passes, which saves the bisection.
        low = max(0, min(self._passing.get(axis, 0), high - 1))
        if low and self._try(axis, low):
            high, low = low, 0
        while high - low > 1:
            middle = (low + high) // 2
            if self._try(axis, middle):
                high = middle
            else:
                low = middle
        self._passing[axis] = low

    def _try(self, axis: int, steps: int) -> bool:
        """Move there if it fails."""
        point = self._shrink.moved(self.at, axis, steps)
        if not self._fails(point):
            return False
        self.at = point
        return True

    def _fails(self, point: Point) -> bool:
        found = self._ask([point])
        if not found:
            raise _Stop
        return found[point] <= 0

    def _ask(self, points: Sequence[Point]) -> dict[Point, float]:
        """Answers for points, for fewer where no more may be asked for."""
        new = [point for point in dict.fromkeys(points) if point not in self.asked]
        self.asked |= dict.fromkeys(new[:self._most - len(self.asked)])
        self.missing = [point for point in self.asked if point not in self._answers]
        if self.missing:
            raise _Stop
        return {point: self._answers[point] for point in points if point in self.asked}
