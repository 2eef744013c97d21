"""Lower bounds of a formula's robustness while a trace still grows: the parts without time.

A node holds, for each sample so far, the least robustness of its sub-formula over all ways in
which the run may go on: any number of further samples, none included, at any later stamps up to
the horizon. This is the lower end of the robust satisfaction interval of Deshmukh et al. (Robust
online monitoring of signal temporal logic, Formal Methods in System Design 51, 2017), for
pointwise semantics. The upper end is minus the lower bound of the negated formula.

Bounds never fall as samples come, because in core form every operator is monotone.
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from taxinet_ros.core.mtl.window import INF

_NONE = sys.maxsize


@dataclass(frozen=True, kw_only=True, slots=True)
class Asked:
    """The trace, and where on it a node is asked.

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
    """One node. After each :meth:`step` its public face holds for the trace so far.

    Each node is stepped once for every sample, and its operands before it (:class:`.build.Root`).

    Attributes:
        value: lower bound by sample index; entries before :attr:`first` mean nothing, and samples
            after ``end_ns`` have none that counts.
        rows: number of samples up to ``end_ns``.
        first: index of the first sample that matters.
        low, high: the last step changed no bounds but those of samples low <= i < high.
        monotone: the bounds are sorted, one way or the other.
        settled: a bound that was given once never changes.
        floor: no bound, of any sample that came or may come, is below.
        steady_ns: before this time :meth:`future` is :attr:`floor`.
        wake_ns: before this time every bound is :attr:`floor`, and no step need be made.
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

    def __init__(self, asked: Asked, *operands: LowerBound) -> None:
        self.stamps_ns = asked.stamps_ns
        self.begin_ns, self.end_ns = asked.begin_ns, asked.end_ns
        self.horizon_ns = asked.horizon_ns
        self.rows = self.first = 0
        self.low, self.high = _NONE, 0
        self.monotone = self.settled = False
        self.floor = self.steady_ns = self.wake_ns = -INF
        self._asked_ns, self._told = -1, -INF
        # A window behind asks its operand earlier than it is asked itself.
        self.final_ns = max([asked.end_ns, *(node.final_ns for node in operands)])

    @abstractmethod
    def step(self, now_ns: int) -> None:
        """Follow the trace, to which samples were added; all is known up to ``now_ns``."""

    def future(self, now_ns: int) -> float:
        """Lower bound at every sample that may still come and matter; +inf if none can.

        To be asked after the step to ``now_ns``. Kept until the next one, for several may ask.
        """
        if now_ns >= self.end_ns:
            return INF
        if self._asked_ns != now_ns:
            self._asked_ns, self._told = now_ns, self._future(now_ns)
        return self._told

    @abstractmethod
    def _future(self, now_ns: int) -> float:
        """Lower bound at samples later than ``now_ns``, when there can be some."""

    def _grow(self) -> bool:
        """Count the samples that came in; these alone are the changed ones so far.

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
        """Count samples low <= i < high among the changed ones, as far as they matter."""
        # Some operands know more samples than this node: until looks beyond what it is asked.
        low, high = max(low, self.first), min(high, self.rows)
        if low < high:
            self.low, self.high = min(self.low, low), max(self.high, high)


class ListedBound(LowerBound):
    """A node that keeps the bounds of its samples in a list."""

    __slots__ = ()

    value: list[float]

    def __init__(self, asked: Asked, *operands: LowerBound) -> None:
        super().__init__(asked, *operands)
        self.value = []

    def _grow(self) -> bool:
        grown = super()._grow()
        if grown:
            self.value.extend([-INF] * (self.rows - len(self.value)))
        return grown


class AtomBound(LowerBound):
    """A predicate: known where there is a sample.

    Args:
        asked: where it is asked.
        margins: (negated) margin of the predicate by sample index, shared; the owner appends to it.
        floor: the least (negated) margin that any sample can have.
        outlook: gives the least possible (negated) margin up to a time [ns], where that changes
            with the samples; else None.
    """

    __slots__ = ('_outlook',)

    def __init__(
        self,
        asked: Asked,
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
        """See the base; the margins themselves are there already."""
        known, stamps = self.rows, self.stamps_ns
        if known + 1 == len(stamps) and self.begin_ns <= stamps[known] <= self.end_ns:
            # The usual case, without a call.
            self.low, self.high = known, known + 1
            self.rows = known + 1
        else:
            self._grow()

    def _future(self, now_ns: int) -> float:
        return self._outlook(self.end_ns) if self._outlook else self.floor


class JoinBound(ListedBound):
    """Lowest or highest of nodes with the same range, sample by sample."""

    __slots__ = ('_children', '_pick')

    def __init__(self, asked: Asked, *, lowest: bool, children: Sequence[LowerBound]) -> None:
        super().__init__(asked, *children)
        self._pick: Callable[..., float] = min if lowest else max
        self._children = children
        self.settled = all(child.settled for child in children)
        self.floor = self._pick(child.floor for child in children)
        self.steady_ns = min(child.steady_ns for child in children)
        self.wake_ns = min(child.wake_ns for child in children)

    def step(self, now_ns: int) -> None:
        """See the base."""
        self._grow()
        for child in self._children:
            self._touch(child.low, child.high)
        low, high = self.low, self.high
        if low < high:
            columns = (child.value[low:high] for child in self._children)
            self.value[low:high] = map(self._pick, *columns)

    def _future(self, now_ns: int) -> float:
        return self._pick(child.future(now_ns) for child in self._children)
