"""Lower-bound nodes of a formula on a growing trace: atoms, logic and chains.

Chains are unbounded until, since and their duals, once and historically.
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from taxinet_ros.core.mtl.sliding import INF, empty_value

_NONE = sys.maxsize


@dataclass(frozen=True, kw_only=True, slots=True)
class BoundRequest:
    """The trace, and the range of it in which a node is evaluated.

    Attributes:
        stamps_ns: stamps of the trace [ns], shared by all nodes; the owner appends to it.
        begin_ns, end_ns: only samples with stamps in this closed range matter to the parents.
        horizon_ns: end of the run [ns].
    """

    stamps_ns: Sequence[int]
    begin_ns: float
    end_ns: float
    horizon_ns: int


class LowerBound(ABC):
    """Base class of nodes. After each :meth:`step`, public attributes hold for the trace so far.

    Each node is stepped once per sample, after its operands (:class:`.builder.Root`).

    Attributes:
        value: lower bound by sample index; undefined before :attr:`first` and for samples after
            ``end_ns``.
        rows: number of samples up to ``end_ns``.
        first: index of the first sample that matters.
        low, high: the last step changed only bounds of samples low <= i < high.
        monotone: the bounds are sorted, ascending or descending.
        settled: a bound never changes once it is set.
        floor: minimum of all bounds, of present and future samples.
        steady_ns: before this time :meth:`future` is :attr:`floor`.
        wake_ns: before this time every bound is :attr:`floor`, and :meth:`step` is not needed.
        final_ns: from this time on no bound changes.
    """

    __slots__ = (
        '_asked_ns',
        '_told',
        'begin_ns',
        'end_ns',
        'final_ns',
        'first',
        'floor',
        'high',
        'horizon_ns',
        'low',
        'monotone',
        'rows',
        'settled',
        'stamps_ns',
        'steady_ns',
        'value',
        'wake_ns',
    )

    value: Sequence[float]
    final_ns: float

    def __init__(self, asked: BoundRequest, *operands: LowerBound) -> None:
        self.stamps_ns = asked.stamps_ns
        self.begin_ns, self.end_ns = asked.begin_ns, asked.end_ns
        self.horizon_ns = asked.horizon_ns
        self.rows = self.first = 0
        self.low, self.high = _NONE, 0
        self.monotone = self.settled = False
        self.floor = self.steady_ns = self.wake_ns = -INF
        self._asked_ns, self._told = -1, -INF
        # A past window evaluates its operand earlier than it is evaluated itself.
        self.final_ns = max([asked.end_ns, *(node.final_ns for node in operands)])

    @abstractmethod
    def step(self, now_ns: int) -> None:
        """Update the bounds for the added samples; the trace is complete up to ``now_ns``."""

    def future(self, now_ns: int) -> float:
        """Lower bound at every relevant future sample; +inf if there can be none.

        Call it after the step to ``now_ns``. The result is cached until the next step.
        """
        if now_ns >= self.end_ns:
            return INF
        if self._asked_ns != now_ns:
            self._asked_ns, self._told = now_ns, self._future(now_ns)
        return self._told

    @abstractmethod
    def _future(self, now_ns: int) -> float:
        """Lower bound at samples after ``now_ns``; called only if there can be some."""

    def _grow(self) -> bool:
        """Count the new samples and reset the changed range to them.

        Returns whether there were any.
        """
        stamps, known, count = self.stamps_ns, self.rows, len(self.stamps_ns)
        self.low, self.high = _NONE, 0
        if known == count or stamps[known] > self.end_ns:
            return False
        self.rows = count if stamps[-1] <= self.end_ns else bisect_right(stamps, self.end_ns, known)
        if stamps[known] < self.begin_ns:
            self.first = known = bisect_left(stamps, self.begin_ns, known, self.rows)
        if known < self.rows:
            self.low, self.high = known, self.rows
        return True

    def _touch(self, low: int, high: int) -> None:
        """Extend the changed range by samples low <= i < high, as far as they matter."""
        # Operands may have more samples than this node: until looks beyond its own range.
        low, high = max(low, self.first), min(high, self.rows)
        if low < high:
            self.low, self.high = min(self.low, low), max(self.high, high)


class ListedBound(LowerBound):
    """Base class of nodes that store their bounds in a list."""

    __slots__ = ()

    value: list[float]

    def __init__(self, asked: BoundRequest, *operands: LowerBound) -> None:
        super().__init__(asked, *operands)
        self.value = []

    def _grow(self) -> bool:
        grown = super()._grow()
        if grown:
            self.value.extend([-INF] * (self.rows - len(self.value)))
        return grown


class AtomBound(LowerBound):
    """Node of a predicate; exact at every sample.

    Args:
        asked: trace and range of evaluation.
        margins: (negated) margin of the predicate by sample index, shared; the owner appends to it.
        floor: minimum possible (negated) margin of any sample.
        outlook: gives the minimum possible (negated) margin up to a time [ns]; None if that does
            not depend on the samples.
    """

    __slots__ = ('_outlook',)

    def __init__(
        self,
        asked: BoundRequest,
        *,
        margins: Sequence[float],
        floor: float,
        outlook: Callable[[float], float] | None,
    ) -> None:
        super().__init__(asked)
        self.value = margins
        self.settled = True
        self.floor = floor
        self.steady_ns = -INF if outlook else self.end_ns
        self._outlook = outlook

    def step(self, now_ns: int) -> None:
        """Count the new samples; their margins are already in ``value``."""
        known, stamps = self.rows, self.stamps_ns
        if known + 1 == len(stamps) and self.begin_ns <= stamps[known] <= self.end_ns:
            # Fast path for the usual case.
            self.low, self.high = known, known + 1
            self.rows = known + 1
        else:
            self._grow()

    def _future(self, now_ns: int) -> float:
        return self._outlook(self.end_ns) if self._outlook else self.floor


class JoinBound(ListedBound):
    """Minimum or maximum of nodes with the same range, sample by sample."""

    __slots__ = ('_children', '_pick')

    def __init__(
        self, asked: BoundRequest, *, lowest: bool, children: Sequence[LowerBound]
    ) -> None:
        super().__init__(asked, *children)
        self._pick: Callable[..., float] = min if lowest else max
        self._children = children
        self.settled = all(child.settled for child in children)
        self.floor = self._pick(child.floor for child in children)
        self.steady_ns = min(child.steady_ns for child in children)
        self.wake_ns = min(child.wake_ns for child in children)

    def step(self, now_ns: int) -> None:
        """Update the bounds; see :meth:`LowerBound.step`."""
        self._grow()
        for child in self._children:
            self._touch(child.low, child.high)
        low, high = self.low, self.high
        if low < high:
            columns = (child.value[low:high] for child in self._children)
            self.value[low:high] = map(self._pick, *columns)

    def _future(self, now_ns: int) -> float:
        return self._pick(child.future(now_ns) for child in self._children)


class ChainBound(ListedBound):
    """A recursion from sample to sample over two nodes with the same range.

    Args:
        asked: trace and range of evaluation.
        lowest: False for until and since, True for their duals.
        left: the operand that must hold until then; None for unbounded once and historically.
        right: the operand that must be reached.
    """

    __slots__ = ('_left', '_lowest', '_other', '_own', '_right')

    def __init__(
        self, asked: BoundRequest, *, lowest: bool, left: LowerBound | None, right: LowerBound
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
    """Unbounded until or its dual; recursion from the newest sample backwards."""

    __slots__ = ('_beyond',)

    _left: LowerBound

    def __init__(
        self, asked: BoundRequest, *, lowest: bool, left: LowerBound, right: LowerBound
    ) -> None:
        super().__init__(asked, lowest=lowest, left=left, right=right)
        self._beyond = -INF
        self.floor, self.steady_ns = right.floor, right.steady_ns

    def step(self, now_ns: int) -> None:
        """Update the bounds; see :meth:`LowerBound.step`."""
        self._follow_operands()
        # The worst case for until is that no sample follows; for the dual it is the minimum
        # future value of the right operand.
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
    """Unbounded since or its dual; recursion from the first sample onwards."""

    __slots__ = ('_start',)

    def __init__(
        self, asked: BoundRequest, *, lowest: bool, left: LowerBound | None, right: LowerBound
    ) -> None:
        super().__init__(asked, lowest=lowest, left=left, right=right)
        self._start = empty_value(lowest)
        self.settled = right.settled and (left is None or left.settled)

    def step(self, now_ns: int) -> None:
        """Update the bounds; see :meth:`LowerBound.step`."""
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
