"""Lower bounds of chains: unbounded until, since and their duals, once and historically."""

from __future__ import annotations

from collections.abc import Callable

from taxinet_ros.core.mtl.lower import Asked, ListedBound, LowerBound
from taxinet_ros.core.mtl.window import INF, empty_value


class ChainBound(ListedBound):
    """A recursion from sample to sample over two nodes with the same range.

    Args:
        asked: where it is asked.
        lowest: False for until and since, True for their duals.
        left: the operand that has to hold on the way; None, looking back, where nothing has to.
        right: the operand that has to be reached.
    """

    __slots__ = ('_left', '_lowest', '_other', '_own', '_right')

    def __init__(
        self, asked: Asked, *, lowest: bool, left: LowerBound | None, right: LowerBound
    ) -> None:
        super().__init__(asked, *([] if left is None else [left]), right)
        self._lowest = lowest
        picks: tuple[Callable[..., float], ...] = (min, max) if lowest else (max, min)
        self._own, self._other = picks
        self._left, self._right = left, right

    def _follow_operands(self) -> None:
        self._grow()
        for child in (self._left, self._right):
            if child is not None:
                self._touch(child.low, child.high)


class ChainAheadBound(ChainBound):
    """Unbounded until, or its dual, from the newest sample back."""

    __slots__ = ('_beyond',)

    _left: LowerBound

    def __init__(
        self, asked: Asked, *, lowest: bool, left: LowerBound, right: LowerBound
    ) -> None:
        super().__init__(asked, lowest=lowest, left=left, right=right)
        self._beyond = -INF
        self.floor, self.steady_ns = right.floor, right.steady_ns

    def step(self, now_ns: int) -> None:
        """See the base."""
        self._follow_operands()
        # After the newest sample nothing may follow, which is the worst for until; for the dual
        # the worst is the least that the right operand can still do.
        beyond = self._right.future(now_ns) if self._lowest else -INF
        if beyond != self._beyond:
            self._beyond = beyond
            self._touch(self.rows - 1, self.rows)
        if self.low < self.high:
            self._recur()

    def _recur(self) -> None:
        left, right, value = self._left.value, self._right.value, self.value
        own, other = self._own, self._other
        changed_low, row = self.low, self.high - 1
        after = value[row + 1] if row + 1 < self.rows else self._beyond
        while row >= self.first:
            after = own(right[row], other(left[row], after))
            if after == value[row] and row < changed_low:
                break
            value[row] = after
            row -= 1
        self.low = row + 1

    def _future(self, now_ns: int) -> float:
        return self._right.future(now_ns)


class ChainBackBound(ChainBound):
    """Unbounded since, or its dual, from the first sample on."""

    __slots__ = ('_start',)

    def __init__(
        self, asked: Asked, *, lowest: bool, left: LowerBound | None, right: LowerBound
    ) -> None:
        super().__init__(asked, lowest=lowest, left=left, right=right)
        self._start = empty_value(lowest)
        self.settled = right.settled and (left is None or left.settled)

    def step(self, now_ns: int) -> None:
        """See the base."""
        self._follow_operands()
        if self.low >= self.high:
            return
        right, value, row = self._right.value, self.value, self.low
        before = value[row - 1] if row > self.first else self._start
        while row < self.rows:
            guard = before if self._left is None else self._other(self._left.value[row], before)
            before = self._own(right[row], guard)
            if before == value[row] and row >= self.high:
                break
            value[row] = before
            row += 1
        self.high = row

    def _future(self, now_ns: int) -> float:
        last = self.value[self.rows - 1] if self.rows > self.first else self._start
        guard = last if self._left is None else self._other(self._left.future(now_ns), last)
        return self._own(self._right.future(now_ns), guard)
