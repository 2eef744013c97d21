"""Lower bounds of operators that look back: historically, once, since and its dual."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence

from taxinet_ros.core.mtl.lower import LowerBound
from taxinet_ros.core.mtl.window import INF, empty_value, slide


class WindowBackBound(LowerBound):
    """Lowest or highest of a node over the bounded window [t - high, t - low]."""

    __slots__ = ('_child', '_high_ns', '_low_ns', '_lowest')

    def __init__(
        self,
        stamps_ns: Sequence[int],
        begin_ns: float,
        end_ns: float,
        *,
        lowest: bool,
        window_ns: tuple[int, int],
        child: LowerBound,
    ) -> None:
        super().__init__(stamps_ns, begin_ns, end_ns)
        self._lowest = lowest
        self._low_ns, self._high_ns = window_ns
        self._child = child

    def _update(self, now_ns: int) -> None:
        stamps, rows = self.stamps_ns, len(self.value)
        low, high = self._child.low, self._child.high
        if low < high:
            start = bisect_left(stamps, stamps[low] + self._low_ns, self.first, rows)
            stop = bisect_right(stamps, stamps[high - 1] + self._high_ns, self.first, rows)
            self._touch(start, stop)
        if self.low < self.high:
            window = (-self._high_ns, -self._low_ns)
            changed = range(self.low, self.high)
            self.value[self.low : self.high] = slide(
                stamps, self._child.value, changed, *window, self._lowest
            )

    def _future(self, now_ns: int) -> float:
        if not self._lowest:
            return self._child.future(now_ns) if self._low_ns == 0 else -INF
        start = bisect_left(self.stamps_ns, now_ns - self._high_ns)
        return least_from(self._child, start, now_ns)


class ChainBackBound(LowerBound):
    """Unbounded since, or its dual (``lowest``), by recursion from the first sample on.

    Without a left operand: unbounded once and historically.
    """

    __slots__ = ('_left', '_other', '_own', '_right', '_start')

    def __init__(
        self,
        stamps_ns: Sequence[int],
        begin_ns: float,
        end_ns: float,
        *,
        lowest: bool,
        left: LowerBound | None,
        right: LowerBound,
    ) -> None:
        super().__init__(stamps_ns, begin_ns, end_ns)
        picks: tuple[Callable[..., float], ...] = (min, max) if lowest else (max, min)
        self._own, self._other = picks
        self._left, self._right = left, right
        self._start = empty_value(lowest)

    def _update(self, now_ns: int) -> None:
        for child in (self._left, self._right):
            if child is not None:
                self._touch(child.low, child.high)
        if self.low >= self.high:
            return
        right, value = self._right.value, self.value
        row = self.low
        before = value[row - 1] if row > self.first else self._start
        while row < len(value):
            guard = before if self._left is None else self._other(self._left.value[row], before)
            before = self._own(right[row], guard)
            if before == value[row] and row >= self.high:
                break
            value[row] = before
            row += 1
        self.high = row

    def _future(self, now_ns: int) -> float:
        last = self.value[-1] if len(self.value) > self.first else self._start
        guard = last if self._left is None else self._other(self._left.future(now_ns), last)
        return self._own(self._right.future(now_ns), guard)


class ShiftBackBound(LowerBound):
    """A node at the last sample at or before t - delay."""

    __slots__ = ('_child', '_delay_ns', '_lowest')

    def __init__(
        self,
        stamps_ns: Sequence[int],
        begin_ns: float,
        end_ns: float,
        *,
        lowest: bool,
        delay_ns: int,
        child: LowerBound,
    ) -> None:
        super().__init__(stamps_ns, begin_ns, end_ns)
        self._lowest = lowest
        self._delay_ns = delay_ns
        self._child = child

    def _update(self, now_ns: int) -> None:
        stamps, rows = self.stamps_ns, len(self.value)
        if self._child.low < self._child.high:
            changed = stamps[self._child.low] + self._delay_ns
            self._touch(bisect_left(stamps, changed, self.first, rows), rows)
        for row in range(self.low, self.high):
            source = bisect_right(stamps, stamps[row] - self._delay_ns) - 1
            inside = self._child.first <= source < len(self._child.value)
            self.value[row] = self._child.value[source] if inside else empty_value(self._lowest)

    def _future(self, now_ns: int) -> float:
        if not self._lowest:
            return -INF
        start = bisect_right(self.stamps_ns, now_ns - self._delay_ns) - 1
        return least_from(self._child, start, now_ns)


def least_from(node: LowerBound, start: int, now_ns: int) -> float:
    """Least lower bound of a node at its samples from an index on and at those still to come."""
    future = node.future(now_ns)
    if future == -INF:
        return -INF
    return min([future, *node.value[max(start, node.first) :]])
