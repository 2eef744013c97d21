"""From one failing point, the search for the nearest to nominal that still fails.

Knows neither scenarios nor runs. A point says for each axis how many steps it is away from its
nominal value: the origin is nominal, the start is the point that was found to fail. A point's
robustness is asked for, answered in any order, and fails where it is 0 or less.

The search is delta debugging (Zeller and Hildebrandt, IEEE Trans. Software Eng. 28, 2002), with
axes for its differences: first every axis is taken to nominal as a whole where the failure survives
it, then those that are left are bisected, round and round until nothing moves. Failure is not
monotone: between two points that fail there may be one that does not. So the result is a local
minimum: it fails, taking any one axis back to nominal makes it pass, and so does one step less on
any one axis; some other point that is nearer still may fail too. It may also fail for another
reason than the start does.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

Point = tuple[int, ...]
"""Steps away from nominal, one number for each axis."""

Rule = Callable[[Point, int], Point]
"""Makes a point possible after one axis (its number) was moved, by taking others to 0."""

LEAST_ASKED = 2
"""Without its start and the origin no search can be begun."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Axis:
    """One thing that may be taken nearer to nominal.

    Attributes:
        steps: between nominal and the start, 1 or more.
        scan: look at the values one by one from nominal on, instead of bisecting; for words.
    """

    steps: int
    scan: bool = False


class End(enum.StrEnum):
    """Why a search asks no more."""

    NOT_YET = ''
    MINIMAL = 'minimal'
    NOMINAL_FAILS = 'nominal fails'
    NOT_REPRODUCED = 'not reproduced'
    SPENT = 'spent'


@dataclass(frozen=True, kw_only=True, slots=True)
class State:
    """How far a search has come.

    Attributes:
        at: the nearest point that is known to fail; the start where it does not fail itself.
        asked: number of answers that this rests on.
        end: why it asks no more.
    """

    at: Point
    asked: int
    end: End


class ShrinkSearch:
    """The search, by ask and tell. Its result depends on the answers only, not on their order."""

    def __init__(
        self, axes: Sequence[Axis], *, most: int, rule: Rule = lambda point, axis: point,
    ) -> None:
        """Nothing is asked yet.

        Args:
            axes: one or more.
            most: answers that the search may rest on, :data:`LEAST_ASKED` or more.
            rule: what makes a point possible.
        """
        if not axes or any(axis.steps < 1 for axis in axes) or most < LEAST_ASKED:
            raise ValueError(f'axes {axes}, at most {most} answers')
        self.axes = tuple(axes)
        self.start = tuple(axis.steps for axis in axes)
        self.origin = (0,) * len(self.axes)
        self._most = most
        self._rule = rule
        self._answers: dict[Point, float] = {}

    def wanted(self, limit: int = 1) -> list[Point]:
        """Points to be answered, the most urgent first; none where the search has ended.

        Args:
            limit: most points. Those that the search needs next come first; if they are fewer, then
                those that it would need after one answer or the other.
        """
        found: dict[Point, None] = {}
        guesses: list[dict[Point, float]] = [{}]
        while guesses and len(found) < limit:
            guess = guesses.pop(0)
            missing = self._walk(guess).missing
            found.update(dict.fromkeys(missing))
            if len(missing) == 1:
                guesses += [{**guess, missing[0]: rho} for rho in (-1.0, 1.0)]
        return list(found)[:limit]

    def tell(self, point: Point, rho: float) -> None:
        """Take an answer, asked for or not."""
        self._answers[point] = rho

    @property
    def state(self) -> State:
        """How far it has come."""
        walk = self._walk({})
        return State(at=walk.at, asked=len(walk.asked), end=walk.end)

    def rho(self, point: Point) -> float | None:
        """The answer for a point, if there is one."""
        return self._answers.get(point)

    def moved(self, point: Point, axis: int, steps: int) -> Point:
        """``point`` with one axis at ``steps``, and what that takes to nominal with it."""
        return self._rule((*point[:axis], steps, *point[axis + 1:]), axis)

    def _walk(self, guess: Mapping[Point, float]) -> _Walk:
        walk = _Walk(self, {**self._answers, **guess}, self._most)
        walk.go()
        return walk


class _Stop(Exception):  # noqa: N818 (an end, not an error)
    """The walk cannot go on: answers are missing, or their number is spent."""


class _Walk:
    """The search from its beginning as far as the answers carry it.

    It is walked anew for every question: a few hundred steps of plain arithmetic, next to runs of
    seconds. So there is no state that an answer out of order could disturb.
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
        """Walk until the end, or until it cannot go on."""
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
        """Take whole axes to nominal until none can be without the failure being lost."""
        while True:
            singles = [
                self._shrink.moved(self.at, axis, 0) for axis, steps in enumerate(self.at) if steps
            ]
            rhos = self._ask(singles)
            failing = sorted((point for point in rhos if rhos[point] <= 0), key=rhos.__getitem__)
            if not failing:
                return
            together = tuple(map(min, *failing)) if len(failing) > 1 else failing[0]
            # All at once where that still fails, else the one that leaves the worst failure.
            self.at = together if self._fails(together) else failing[0]

    def _narrow(self, axis: int) -> None:
        """Bring one axis as near to nominal as the failure allows; at nominal it passes."""
        high = self.at[axis]
        if self._shrink.axes[axis].scan:
            next((steps for steps in range(1, high) if self._try(axis, steps)), None)
            return
        # What passed the last time round most likely passes still, and saves the bisection.
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
        """Go there if it fails."""
        point = self._shrink.moved(self.at, axis, steps)
        if not self._fails(point):
            return False
        self.at = point
        return True

    def _fails(self, point: Point) -> bool:
        return self._ask([point])[point] <= 0

    def _ask(self, points: Sequence[Point]) -> dict[Point, float]:
        asked = {**self.asked, **dict.fromkeys(points)}
        if len(asked) > self._most:
            raise _Stop
        self.asked = asked
        self.missing = [point for point in asked if point not in self._answers]
        if self.missing:
            raise _Stop
        return {point: self._answers[point] for point in points}
