"""The extremes of windows that start one after another, in constant amortised time a sample.

Windows that are open all end with the newest sample, and the later one starts the fewer samples it
holds; so their extremes are sorted, and a new sample changes a run of the latest windows only. Runs
of windows with one extreme are kept as one step, and a sample takes away every step that it beats
and lays down at most two (the same argument as for Lemire's monotonic queue).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import overload

from taxinet_ros.core.mtl.window import INF, empty_value


class Stairs(Sequence[float]):
    """Extreme of each window, by the index of the sample at which it is asked.

    Args:
        lowest: True for the minimum.

    Attributes:
        rows: number of windows.
        cap: least of what may still come; it counts for lowest windows open <= i < never.
        open: index of the first window into which samples may still fall.
        never: index of the first window that starts beyond the end of the run.
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
        """Let a sample fall into the windows start <= i < stop; none before takes any more.

        ``stop`` never falls. Returns the index of the first window that changed, or ``stop``.
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
