"""Lower bounds of a node at another sample: the first at or after a delay, the last before it."""

from __future__ import annotations

from bisect import bisect_left, bisect_right

from taxinet_ros.core.mtl.lower import Asked, ListedBound, LowerBound
from taxinet_ros.core.mtl.lower_window import least_from
from taxinet_ros.core.mtl.window import INF, empty_value


class ShiftBound(ListedBound):
    """A node at a sample ``delay_ns`` away; ``lowest`` tells what an absent one is worth."""

    __slots__ = ('_child', '_delay_ns', '_lowest')

    def __init__(self, asked: Asked, *, lowest: bool, delay_ns: int, child: LowerBound) -> None:
        super().__init__(asked, child)
        self._lowest, self._delay_ns, self._child = lowest, delay_ns, child


class ShiftAheadBound(ShiftBound):
    """A node at the first sample at or after t + delay."""

    __slots__ = ('_known',)

    def __init__(self, asked: Asked, *, lowest: bool, delay_ns: int, child: LowerBound) -> None:
        super().__init__(asked, lowest=lowest, delay_ns=delay_ns, child=child)
        self._known = 0

    def step(self, now_ns: int) -> None:
        """See the base."""
        self._grow()
        stamps, rows = self.stamps_ns, self.rows
        # The samples whose delay had not passed with the last one known may see a change.
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

    def __init__(self, asked: Asked, *, lowest: bool, delay_ns: int, child: LowerBound) -> None:
        super().__init__(asked, lowest=lowest, delay_ns=delay_ns, child=child)
        self.settled = child.settled

    def step(self, now_ns: int) -> None:
        """See the base."""
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
