"""Sliding minimum and maximum over irregular stamps: of a whole trace, and sample by sample."""

from __future__ import annotations

import operator
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from typing import overload

INF = float('inf')


def empty_value(lowest: bool) -> float:
    """Minimum (maximum) of no values: +inf (-inf)."""
    return INF if lowest else -INF


def slide(
    stamps_ns: Sequence[int],
    values: Sequence[float],
    rows: range,
    low_ns: float,
    high_ns: float,
    lowest: bool,
) -> list[float]:
    """Extreme value in the closed window [t + low, t + high] of each row, in linear time.

    A monotonic queue holds the candidates (Lemire, Streaming maximum-minimum filter using no more
    than three comparisons per element, 2006).

    Args:
        stamps_ns: strictly increasing stamps [ns].
        values: value at each stamp; stamps beyond the last value have none.
        rows: indices of the samples to evaluate, ascending.
        low_ns: start of the window relative to the sample [ns]; an int, or -inf.
        high_ns: end of the window relative to the sample [ns]; an int, or inf.
        lowest: True for the minimum.

    Returns:
        One value for each row; an empty window gives :func:`empty_value`.
    """
    keeps_older: Callable[[float, float], bool] = operator.lt if lowest else operator.gt
    nothing = empty_value(lowest)
    known = len(values)
    at = bisect_left(stamps_ns, stamps_ns[rows.start] + low_ns, 0, known) if rows else 0
    queue: deque[int] = deque()
    out: list[float] = []
    for row in rows:
        start, end = stamps_ns[row] + low_ns, stamps_ns[row] + high_ns
        while at < known and stamps_ns[at] <= end:
            value = values[at]
            while queue and not keeps_older(values[queue[-1]], value):
                queue.pop()
            queue.append(at)
            at += 1
        while queue and stamps_ns[queue[0]] < start:
            queue.popleft()
        out.append(values[queue[0]] if queue else nothing)
    return out


class Stairs(Sequence[float]):
    """Extreme of each window, indexed by the sample that the window belongs to.

    Args:
        lowest: True for the minimum.

    Attributes:
        rows: number of windows.
        cap: minimum of possible later values; applies to lowest windows open <= i < never.
        open: index of the first window into which samples may still fall.
        never: index of the first window that starts after the end of the run.
    """

    __slots__ = (
        '_lowest',
        '_nothing',
        '_reached',
        '_starts',
        '_tops',
        'cap',
        'never',
        'open',
        'rows',
    )

    def __init__(self, lowest: bool) -> None:
        self._lowest = lowest
        self._nothing = empty_value(lowest)
        self.cap = self._nothing
        self.rows = self.open = self._reached = 0
        self.never = INF if lowest else 0
        self._starts, self._tops = [0], [self._nothing]

    def __len__(self) -> int:
        return self.rows

    @overload
    def __getitem__(self, index: int) -> float: ...
    @overload
    def __getitem__(self, index: slice) -> list[float]: ...
    def __getitem__(self, index: int | slice) -> float | list[float]:
        if isinstance(index, slice):
            start, stop, _ = index.indices(self.rows)
            return self._listed(start, stop)
        if index >= self._reached:
            seen = self._nothing
        else:
            seen = self._tops[bisect_right(self._starts, index) - 1]
        if self.open <= index < self.never:
            return min(seen, self.cap)
        return seen

    def _listed(self, start: int, stop: int) -> list[float]:
        """Extremes of the windows start <= i < stop, step by step."""
        starts, tops = self._starts, self._tops
        found: list[float] = []
        at, row = bisect_right(starts, start) - 1, start
        while row < min(self._reached, stop):
            at += 1
            end = min(starts[at] if at < len(starts) else self._reached, self._reached, stop)
            found += [tops[at - 1]] * (end - row)
            row = end
        found += [self._nothing] * (stop - row)
        low, high = max(self.open, start), int(min(self.never, stop))
        if low < high:
            found[low - start : high - start] = [
                min(seen, self.cap) for seen in found[low - start : high - start]
            ]
        return found

    def take(self, value: float, start: int, stop: int) -> int:
        """Add a sample to the windows start <= i < stop; earlier windows get no more samples.

        ``stop`` never decreases. Returns the index of the first window that changed, or ``stop``.
        """
        starts, tops, changed = self._starts, self._tops, stop
        if self._reached < stop:
            if self._reached < start:
                # Windows that closed before any sample reached them.
                starts.append(self._reached)
                tops.append(self._nothing)
            changed, self._reached = max(self._reached, start), stop
        while starts and (tops[-1] >= value if self._lowest else tops[-1] <= value):
            if starts[-1] < start:
                changed = start
                break
            changed = starts.pop()
            tops.pop()
        if changed < stop:
            starts.append(changed)
            tops.append(value)
        return changed
