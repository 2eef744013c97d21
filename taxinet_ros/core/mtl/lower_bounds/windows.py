"""Lower-bound nodes of windows (always, eventually, historically, once) and of shifts."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from itertools import accumulate

from taxinet_ros.core.mtl.lower_bounds.nodes import BoundRequest, ListedBound, LowerBound
from taxinet_ros.core.mtl.sliding import INF, Stairs, empty_value, slide

Offsets = tuple[float, float]
"""Start and end of a window relative to its sample [ns]: ints or +-inf, both of one sign."""


class AheadBound(LowerBound):
    """Minimum or maximum of a settled node over a future window, in amortised constant time."""

    __slots__ = ('_child', '_lowest', '_offsets', '_past', '_reached', '_taken')

    value: Stairs

    def __init__(
        self, asked: BoundRequest, *, lowest: bool, offsets: Offsets, child: LowerBound
    ) -> None:
        super().__init__(asked, child)
        assert child.settled, 'the bounds of this operand may change'
        self.value = Stairs(lowest)
        # Unbounded windows are nested, so their extremes are sorted.
        self.monotone = offsets[1] == INF
        _forecast(self, lowest, offsets, child)
        self._lowest, self._offsets, self._child = lowest, offsets, child
        # ``taken``: number of samples processed. Windows before ``past`` ended before the newest
        # sample; windows before ``reached`` started at or before it.
        self._taken = self._past = self._reached = 0

    def step(self, now_ns: int) -> None:
        """Update the bounds; see :meth:`LowerBound.step`."""
        child, stairs = self._child, self.value
        if self._grow():
            stairs.rows = self.rows
            if self._past < self.first:
                self._past = self._reached = stairs.open = self.first
        if self._taken < child.rows:
            self._take()
        if self._lowest:
            self._cap(now_ns)

    def _take(self) -> None:
        """Add the operand's new samples to the windows that contain them."""
        stamps, values, rows = self.stamps_ns, self._child.value, self.rows
        low_ns, high_ns = self._offsets
        past, reached, changed = self._past, self._reached, rows
        for at in range(max(self._taken, self._child.first), self._child.rows):
            stamp = stamps[at]
            while past < rows and stamps[past] + high_ns < stamp:
                past += 1
            while reached < rows and stamps[reached] + low_ns <= stamp:
                reached += 1
            if past < reached:
                first = self.value.take(values[at], past, reached)
                if first < changed:
                    changed = first
        if changed < reached:
            self._touch(changed, reached)
        self._taken = self._child.rows
        self._past, self._reached = past, reached

    def _cap(self, now_ns: int) -> None:
        """Apply the minimum of possible future values to the open windows (minimum only)."""
        stairs, was_open, cap = self.value, self.value.open, self.value.cap
        stairs.open = closed_rows(self, was_open, self._offsets[1], now_ns)
        self._touch(was_open, stairs.open)
        if stairs.open < self.rows or now_ns < self.end_ns:
            stairs.cap = self._child.future(now_ns)
            if stairs.cap != cap:
                self._touch(stairs.open, self.rows)
        never = never_row(self, self._offsets[0])
        stairs.never = INF if never == self.rows else never

    def _future(self, now_ns: int) -> float:
        return _window_future(self, self._lowest, self._offsets, self._child, now_ns)


class WindowBound(ListedBound):
    """Minimum or maximum of any node over any window."""

    __slots__ = (
        '_child', '_lowest', '_offsets', '_open', '_so_far', '_so_far_from', '_worst',
    )

    def __init__(
        self, asked: BoundRequest, *, lowest: bool, offsets: Offsets, child: LowerBound
    ) -> None:
        super().__init__(asked, child)
        # A past window is closed when its sample arrives.
        self.settled = child.settled and offsets[1] <= 0
        self.monotone = offsets[1] == INF
        _forecast(self, lowest, offsets, child)
        self._lowest, self._offsets, self._child = lowest, offsets, child
        self._open, self._worst = 0, -INF
        # Running extreme of the samples of one window: see _seen_by.
        self._so_far: list[float] = []
        self._so_far_from = 0

    def step(self, now_ns: int) -> None:
        """Update the bounds; see :meth:`LowerBound.step`."""
        child = self._child
        grown = self._grow()
        if child.low < child.high:
            self._touch(*self._affected(child.low, child.high))
            del self._so_far[max(child.low - self._so_far_from, 0):]
        elif not grown and self._open == self.rows and now_ns >= self.end_ns:
            # No window is open or will be.
            return
        if self._lowest:
            self._step_lowest(now_ns)
        elif self.low < self.high:
            self.value[self.low : self.high] = self._seen(self.low, self.high)

    def _affected(self, low: int, high: int) -> tuple[int, int]:
        """Rows start <= i < stop whose windows contain any of the samples low <= i < high."""
        stamps, (low_ns, high_ns) = self.stamps_ns, self._offsets
        start = bisect_left(stamps, stamps[low] - high_ns, self.first, self.rows)
        return start, bisect_right(stamps, stamps[high - 1] - low_ns, start, self.rows)

    def _step_lowest(self, now_ns: int) -> None:
        was_open, was_worst = self._open, self._worst
        opened = self._open = closed_rows(self, was_open, self._offsets[1], now_ns)
        self._touch(was_open, opened)
        if opened < self.rows or now_ns < self.end_ns:
            self._worst = self._child.future(now_ns)
            if self._worst != was_worst:
                self._touch(opened, self.rows)
        low, high = self.low, self.high
        middle = min(max(low, opened), high)
        if low < middle:
            self.value[low:middle] = self._seen(low, middle)
        if middle < high:
            self.value[middle:high] = self._hedged(middle, high)
        never = max(never_row(self, self._offsets[0]), low)
        if never < high:
            self.value[never:high] = [INF] * (high - never)

    def _hedged(self, start: int, stop: int) -> list[float]:
        """Bounds of open windows: minimum of the samples so far and of possible future ones."""
        worst = self._worst
        if worst <= self._child.floor:
            return [worst] * (stop - start)
        return [min(seen, worst) for seen in self._seen(start, stop)]

    def _seen(self, start: int, stop: int) -> list[float]:
        """Extremes of the samples so far, without future ones."""
        values, (low_ns, high_ns) = self._child.value, self._offsets
        if stop - start != 1 and high_ns == INF:
            return self._seen_nested(start, stop)
        if stop - start != 1:
            rows = range(start, stop)
            return slide(self.stamps_ns, values, rows, low_ns, high_ns, self._lowest)
        return [self._seen_by(start)]

    def _seen_nested(self, start: int, stop: int) -> list[float]:
        """Like :meth:`_seen`, for windows without end: each contains the next one."""
        stamps, values, low_ns = self.stamps_ns, self._child.value, self._offsets[0]
        extreme: Callable[..., float] = min if self._lowest else max
        found = [self._seen_by(stop - 1)] * (stop - start)
        first = bisect_left(stamps, stamps[start] + low_ns, 0, len(values))
        edge = bisect_left(stamps, stamps[stop - 1] + low_ns, first, len(values))
        before = values[first:edge]
        for row in range(stop - 2, start - 1, -1):
            left = bisect_left(stamps, stamps[row] + low_ns, first, edge)
            found[row - start] = extreme(
                (found[row - start + 1], *before[left - first : edge - first])
            )
            edge = left
        return found

    def _seen_by(self, row: int) -> float:
        """Like :meth:`_seen`, for one window: the usual case at the root, and many times faster.

        A sample changes the operand at the newest samples only. So the extremes of all prefixes of
        the window are cached, and only those that include a changed sample are recomputed.
        """
        stamps, values, (low_ns, high_ns) = self.stamps_ns, self._child.value, self._offsets
        left = bisect_left(stamps, stamps[row] + low_ns, 0, len(values))
        right = bisect_right(stamps, stamps[row] + high_ns, left, len(values))
        if left >= right:
            return empty_value(self._lowest)
        extreme: Callable[..., float] = min if self._lowest else max
        if self._child.monotone:
            return extreme(values[left], values[right - 1])
        so_far = self._so_far
        if left != self._so_far_from:
            self._so_far_from = left
            so_far.clear()
        known = len(so_far)
        if known < right - left:
            newer = values[left + known : right]
            if known:
                so_far[-1:] = accumulate(newer, extreme, initial=so_far[-1])
            else:
                so_far += accumulate(newer, extreme)
        return so_far[right - left - 1]

    def _future(self, now_ns: int) -> float:
        return _window_future(self, self._lowest, self._offsets, self._child, now_ns)


def _forecast(node: LowerBound, lowest: bool, offsets: Offsets, child: LowerBound) -> None:
    """Set the attributes of a window node that are known before the first sample."""
    low_ns, high_ns = offsets
    if not lowest:
        # A window that includes offset 0 contains its sample; any other may stay empty.
        node.floor = child.floor if 0 in offsets else -INF
        node.steady_ns = min(node.end_ns, child.steady_ns) if 0 in offsets else node.end_ns
        node.wake_ns = child.wake_ns if node.floor == child.floor else -INF
        return
    node.floor = child.floor
    node.steady_ns = min(node.end_ns, node.horizon_ns - low_ns, child.steady_ns)
    if low_ns >= 0:
        # Until the first window closes all are open and may, at worst, reach the floor.
        first_ns = min(node.begin_ns + high_ns, node.horizon_ns, node.horizon_ns - low_ns + 1)
        node.wake_ns = min(first_ns, child.steady_ns)


def closed_rows(node: LowerBound, known: int, high_ns: float, now_ns: int) -> int:
    """Number of windows that can get no more samples, at least ``known``."""
    stamps, rows = node.stamps_ns, node.rows
    closed = max(known, node.first)
    if now_ns >= node.horizon_ns:
        return rows
    if closed < rows and stamps[closed] + high_ns <= now_ns:
        return bisect_right(stamps, now_ns - high_ns, closed, rows)
    return min(closed, rows)


def never_row(node: LowerBound, low_ns: float) -> int:
    """Index of the first window that starts after the end of the run and so stays empty."""
    stamps, rows = node.stamps_ns, node.rows
    if not rows or stamps[rows - 1] + low_ns <= node.horizon_ns:
        return rows
    return bisect_right(stamps, node.horizon_ns - low_ns, node.first, rows)


def _window_future(
    node: LowerBound, lowest: bool, offsets: Offsets, child: LowerBound, now_ns: int
) -> float:
    if not lowest:
        return child.future(now_ns) if 0 in offsets else -INF
    if now_ns + offsets[0] >= node.horizon_ns:
        return INF
    return least_from(child, bisect_right(node.stamps_ns, now_ns + offsets[0]), now_ns)


def least_from(node: LowerBound, start: int, now_ns: int) -> float:
    """Minimum bound of a node over its samples from an index on and all future samples."""
    future = node.future(now_ns)
    if future == node.floor:
        return future
    return min([future, *node.value[max(start, node.first) : node.rows]])


class ShiftBound(ListedBound):
    """A node at a sample ``delay_ns`` away; an absent one is +inf if ``lowest``, else -inf."""

    __slots__ = ('_child', '_delay_ns', '_lowest')

    def __init__(
        self, asked: BoundRequest, *, lowest: bool, delay_ns: int, child: LowerBound
    ) -> None:
        super().__init__(asked, child)
        self._lowest, self._delay_ns, self._child = lowest, delay_ns, child


class ShiftAheadBound(ShiftBound):
    """A node at the first sample at or after t + delay."""

    __slots__ = ('_known',)

    def __init__(
        self, asked: BoundRequest, *, lowest: bool, delay_ns: int, child: LowerBound
    ) -> None:
        super().__init__(asked, lowest=lowest, delay_ns=delay_ns, child=child)
        self._known = 0

    def step(self, now_ns: int) -> None:
        """Update the bounds; see :meth:`LowerBound.step`."""
        self._grow()
        stamps, rows = self.stamps_ns, self.rows
        # Samples whose delay had not elapsed at the last step may change.
        low = min(self._child.low, self._known)
        self._known = len(stamps)
        before = stamps[low - 1] - self._delay_ns if low else -INF
        self._touch(bisect_right(stamps, before, self.first, rows), rows)
        source = bisect_left(stamps, stamps[self.low] + self._delay_ns) if self.low < rows else 0
        for row in range(self.low, rows):
            target = stamps[row] + self._delay_ns
            while source < len(stamps) and stamps[source] < target:
                source += 1
            self.value[row] = self._at(source, target, now_ns)

    def _at(self, source: int, target_ns: int, now_ns: int) -> float:
        if source < self._child.rows:
            return self._child.value[source]
        if source == len(self.stamps_ns) and now_ns < self.horizon_ns >= target_ns:
            return self._child.future(now_ns) if self._lowest else -INF
        return empty_value(self._lowest)

    def _future(self, now_ns: int) -> float:
        if not self._lowest:
            return -INF
        if now_ns + self._delay_ns >= self.horizon_ns:
            return INF
        return self._child.future(now_ns)


class ShiftBackBound(ShiftBound):
    """A node at the last sample at or before t - delay."""

    __slots__ = ()

    def __init__(
        self, asked: BoundRequest, *, lowest: bool, delay_ns: int, child: LowerBound
    ) -> None:
        super().__init__(asked, lowest=lowest, delay_ns=delay_ns, child=child)
        self.settled = child.settled

    def step(self, now_ns: int) -> None:
        """Update the bounds; see :meth:`LowerBound.step`."""
        self._grow()
        stamps, rows = self.stamps_ns, self.rows
        if self._child.low < self._child.high:
            changed = stamps[self._child.low] + self._delay_ns
            self._touch(bisect_left(stamps, changed, self.first, rows), rows)
        for row in range(self.low, self.high):
            source = bisect_right(stamps, stamps[row] - self._delay_ns) - 1
            inside = self._child.first <= source < self._child.rows
            self.value[row] = self._child.value[source] if inside else empty_value(self._lowest)

    def _future(self, now_ns: int) -> float:
        if not self._lowest:
            return -INF
        start = bisect_right(self.stamps_ns, now_ns - self._delay_ns) - 1
        return least_from(self._child, start, now_ns)
