"""Lower bounds of operators that look ahead: always, eventually, until and its dual."""

from __future__ import annotations

import operator
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence

from taxinet_ros.core.mtl.lower import LowerBound
from taxinet_ros.core.mtl.window import INF, empty_value, slide


class HighestAheadBound(LowerBound):
    """Highest of a node over [t + low, t + high]; :class:`LowestAheadBound` is the other kind.

    What is to come can only raise a highest value, and in the worst case nothing more comes: the
    lower bound is the extreme over what was seen.
    """

    __slots__ = ('_child', '_high_ns', '_horizon_ns', '_low_ns', '_lowest', '_seen', '_taken')

    def __init__(
        self,
        stamps_ns: Sequence[int],
        begin_ns: float,
        end_ns: float,
        *,
        window_ns: tuple[float, float],
        child: LowerBound,
        horizon_ns: int,
    ) -> None:
        super().__init__(stamps_ns, begin_ns, end_ns)
        self._low_ns, self._high_ns = window_ns
        self._child = child
        self._horizon_ns = horizon_ns
        self._lowest = False
        # Unbounded windows are nested, so their extremes are sorted.
        self.monotone = window_ns[1] == INF
        # Extreme over the samples so far in each window, whatever may come.
        self._seen = self.value
        # Number of the operand's samples that were seen at least once.
        self._taken = 0

    def _update(self, now_ns: int) -> None:
        if self._child.high:
            start, stop = self._see()
            if start < stop:
                self._touch(start, stop)

    def _affected(self) -> tuple[int, int]:
        """Rows start <= i < stop whose windows hold an operand's sample that changed."""
        stamps, rows = self.stamps_ns, len(self.value)
        low, high = self._child.low, self._child.high
        start = self.first
        if self._high_ns != INF:
            start = bisect_left(stamps, stamps[low] - self._high_ns, start, rows)
        return start, bisect_right(stamps, stamps[high - 1] - self._low_ns, start, rows)

    def _see(self) -> tuple[int, int]:
        """Take in the operand's changes; give the rows that may have changed."""
        start, stop = self._affected()
        low, high = self._child.low, self._child.high
        new = high > self._taken
        if new:
            self._taken = high
        if new and high - low == 1 and start < stop:
            return self._see_new(self._child.value[low], start, stop), stop
        if start < stop:
            self._seen[start:stop] = self._slide(start, stop)
        return start, stop

    def _see_new(self, value: float, start: int, stop: int) -> int:
        """Take a new sample into the windows start <= i < stop, which all reach it.

        The later a window starts the fewer samples it holds, so their extremes are sorted.
        """
        seen, last = self._seen, self._seen[stop - 1]
        if last <= value if self._lowest else last >= value:
            return stop
        if self._lowest:
            start = bisect_right(seen, value, start, stop)
        else:
            start = bisect_right(seen, -value, start, stop, key=operator.neg)
        seen[start:stop] = [value] * (stop - start)
        return start

    def _slide(self, start: int, stop: int) -> list[float]:
        values, low_ns, high_ns = self._child.value, self._low_ns, self._high_ns
        if stop - start != 1:
            rows = range(start, stop)
            return slide(self.stamps_ns, values, rows, low_ns, high_ns, self._lowest)
        # The usual case at the root of a formula, and many times faster.
        stamps, stamp = self.stamps_ns, self.stamps_ns[start]
        left = bisect_left(stamps, stamp + low_ns, 0, len(values))
        right = bisect_right(stamps, stamp + high_ns, left, len(values))
        if left >= right:
            return [empty_value(self._lowest)]
        extreme = min if self._lowest else max
        if self._child.monotone:
            return [extreme(values[left], values[right - 1])]
        return [extreme(values[left:right])]

    def _future(self, now_ns: int) -> float:
        return self._child.future(now_ns) if self._low_ns == 0 else -INF


class LowestAheadBound(HighestAheadBound):
    """Lowest of a node over [t + low, t + high].

    A window is open while samples may still fall into it, and these can lower its value to the
    operand's :meth:`future`. While that is -inf what was seen in open windows makes no difference,
    and is not kept.
    """

    __slots__ = ('_closed', '_keeps', '_worst')

    def __init__(
        self,
        stamps_ns: Sequence[int],
        begin_ns: float,
        end_ns: float,
        *,
        window_ns: tuple[float, float],
        child: LowerBound,
        horizon_ns: int,
    ) -> None:
        super().__init__(
            stamps_ns, begin_ns, end_ns, window_ns=window_ns, child=child, horizon_ns=horizon_ns
        )
        self._lowest = True
        self._seen = []
        self._closed = 0
        self._keeps = False
        self._worst = -INF

    def _update(self, now_ns: int) -> None:
        start, closed = self._closed, self._close(now_ns)
        done = closed == len(self.value) and now_ns >= self.end_ns
        worst = -INF if done else self._child.future(now_ns)
        if worst == -INF:
            self._settle(start)
        else:
            self._hedge(worst, start)
        # Windows that start beyond the horizon are empty for good.
        if self.high and self.stamps_ns[self.high - 1] + self._low_ns > self._horizon_ns:
            first_ns = self._horizon_ns - self._low_ns
            start = bisect_right(self.stamps_ns, first_ns, self.first, len(self.value))
            self.value[start:] = [INF] * (len(self.value) - start)

    def _close(self, now_ns: int) -> int:
        """Advance and return the number of closed windows."""
        rows, closed = len(self.value), max(self._closed, self.first)
        if now_ns >= self._horizon_ns:
            closed = rows
        elif closed < rows and self.stamps_ns[closed] + self._high_ns <= now_ns:
            closed = bisect_right(self.stamps_ns, now_ns - self._high_ns, closed, rows)
        self._closed = closed
        return closed

    def _settle(self, start: int) -> None:
        """Closed windows, of which those from a row on are new; open ones, if any, are at -inf."""
        stop = self._closed
        if stop == self.first or (stop == start and not self._child.high):
            return
        if self._child.high:
            first, last = self._affected()
            # Of the old ones only those that the operand's changes reach.
            stop = stop if stop > start else min(last, stop)
            start = min(start, first)
        start = max(start, self.first)
        if start < stop:
            self.value[start:stop] = self._slide(start, stop)
            self._touch(start, stop)

    def _hedge(self, worst: float, start: int) -> None:
        """All windows, of which those from a row on were open: what was seen and may come."""
        value, rows = self.value, len(self.value)
        if self._keeps:
            self._seen.extend([INF] * (rows - len(self._seen)))
            changed = self._see()[0] if self._child.high else rows
        else:
            self._keeps, self._taken, changed = True, len(self.stamps_ns), self.first
            self._seen = value[: self.first] + self._slide(self.first, rows)
        closed = self._closed
        low = min(start, changed)
        if low < closed:
            value[low:closed] = self._seen[low:closed]
            self._touch(low, closed)
        low = closed if worst != self._worst else max(closed, min(changed, self.low))
        self._worst = worst
        if low < rows:
            value[low:] = [min(seen, worst) for seen in self._seen[low:]]
            self._touch(low, rows)

    def _future(self, now_ns: int) -> float:
        if now_ns + self._low_ns >= self._horizon_ns:
            return INF
        return self._child.future(now_ns)


class ChainAheadBound(LowerBound):
    """Unbounded until, or its dual (``lowest``), by recursion from the newest sample back."""

    __slots__ = ('_beyond', '_left', '_lowest', '_other', '_own', '_right')

    def __init__(
        self,
        stamps_ns: Sequence[int],
        begin_ns: float,
        end_ns: float,
        *,
        lowest: bool,
        left: LowerBound,
        right: LowerBound,
    ) -> None:
        super().__init__(stamps_ns, begin_ns, end_ns)
        self._lowest = lowest
        picks: tuple[Callable[..., float], ...] = (min, max) if lowest else (max, min)
        self._own, self._other = picks
        self._left, self._right = left, right
        self._beyond = -INF

    def _update(self, now_ns: int) -> None:
        # After the newest sample nothing may follow, which is the worst for until; for the dual
        # the worst is the least that the right operand can still do.
        beyond = self._right.future(now_ns) if self._lowest else -INF
        for child in (self._left, self._right):
            self._touch(child.low, child.high)
        if beyond != self._beyond:
            self._beyond = beyond
            self._touch(max(len(self.value) - 1, self.first), len(self.value))
        if self.low < self.high:
            self._recur()

    def _recur(self) -> None:
        left, right, value = self._left.value, self._right.value, self.value
        own, other = self._own, self._other
        changed_low, row = self.low, self.high - 1
        after = value[row + 1] if row + 1 < len(value) else self._beyond
        while row >= self.first:
            after = own(right[row], other(left[row], after))
            if after == value[row] and row < changed_low:
                break
            value[row] = after
            row -= 1
        self.low = row + 1

    def _future(self, now_ns: int) -> float:
        return self._right.future(now_ns)


class ShiftAheadBound(LowerBound):
    """A node at the first sample at or after t + delay."""

    __slots__ = ('_child', '_delay_ns', '_horizon_ns', '_lowest')

    def __init__(
        self,
        stamps_ns: Sequence[int],
        begin_ns: float,
        end_ns: float,
        *,
        lowest: bool,
        delay_ns: int,
        child: LowerBound,
        horizon_ns: int,
    ) -> None:
        super().__init__(stamps_ns, begin_ns, end_ns)
        self._lowest = lowest
        self._delay_ns = delay_ns
        self._child = child
        self._horizon_ns = horizon_ns

    def _update(self, now_ns: int) -> None:
        stamps, rows = self.stamps_ns, len(self.value)
        low = min(self._child.low, len(stamps) - 1)
        before = stamps[low - 1] - self._delay_ns if low else -INF
        self._touch(bisect_right(stamps, before, self.first, rows), rows)
        source = bisect_left(stamps, stamps[self.low] + self._delay_ns) if self.low < rows else 0
        for row in range(self.low, rows):
            target = stamps[row] + self._delay_ns
            while source < len(stamps) and stamps[source] < target:
                source += 1
            self.value[row] = self._at(source, target, now_ns)

    def _at(self, source: int, target_ns: int, now_ns: int) -> float:
        if source < len(self._child.value):
            return self._child.value[source]
        if source == len(self.stamps_ns) and now_ns < self._horizon_ns >= target_ns:
            return self._child.future(now_ns) if self._lowest else -INF
        return empty_value(self._lowest)

    def _future(self, now_ns: int) -> float:
        if not self._lowest:
            return -INF
        return INF if now_ns + self._delay_ns >= self._horizon_ns else self._child.future(now_ns)
