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
from collections.abc import Callable, Sequence

from taxinet_ros.core.mtl.window import INF


class LowerBound(ABC):
    """One node. After each :meth:`step` its public face holds for the trace so far.

    Args:
        stamps_ns: stamps of the trace [ns], shared by all nodes; the owner appends to it.
        begin_ns, end_ns: only samples with stamps in this closed range matter to the parents.

    Attributes:
        value: lower bound by sample index; entries before :attr:`first` mean nothing, and samples
            after ``end_ns`` have none.
        first: index of the first sample that matters.
        low, high: the last step changed no bounds but those of samples low <= i < high.
        monotone: the bounds are sorted, one way or the other.
    """

    __slots__ = ('begin_ns', 'end_ns', 'first', 'high', 'low', 'monotone', 'stamps_ns', 'value')

    def __init__(self, stamps_ns: Sequence[int], begin_ns: float, end_ns: float) -> None:
        self.stamps_ns = stamps_ns
        self.begin_ns = begin_ns
        self.end_ns = end_ns
        self.value: list[float] = []
        self.first = 0
        self.low, self.high = sys.maxsize, 0
        self.monotone = False

    def step(self, now_ns: int) -> None:
        """Follow the trace, to which at most one sample was added; all is known up to ``now_ns``.

        The nodes below must have followed before.
        """
        stamps_ns, value = self.stamps_ns, self.value
        count = len(stamps_ns)
        self.low, self.high = sys.maxsize, 0
        if len(value) < count and stamps_ns[-1] <= self.end_ns:
            value.append(-INF)
            if stamps_ns[-1] < self.begin_ns:
                self.first = count
            else:
                self.low, self.high = count - 1, count
        self._update(now_ns)

    def future(self, now_ns: int) -> float:
        """Lower bound at every sample that may still come and matter; +inf if none can."""
        return INF if now_ns >= self.end_ns else self._future(now_ns)

    def _touch(self, low: int, high: int) -> None:
        # Some operands know more samples than this node: until looks beyond what it is asked.
        low, high = max(low, self.first), min(high, len(self.value))
        if low < high:
            self.low, self.high = min(self.low, low), max(self.high, high)

    @abstractmethod
    def _update(self, now_ns: int) -> None:
        """Bring ``value``, ``low`` and ``high`` up to date; new entries were appended as -inf."""

    @abstractmethod
    def _future(self, now_ns: int) -> float:
        """Lower bound at samples later than ``now_ns``, when there can be some."""


class AtomBound(LowerBound):
    """A predicate: known where there is a sample.

    Args:
        stamps_ns, begin_ns, end_ns: see :class:`LowerBound`.
        margins: margin of the predicate by sample index, shared; the owner appends to it.
        negated: whether minus the margin is meant.
        outlook: gives the least possible (negated) margin up to a time [ns].
        moves: whether the outlook changes with the samples.
    """

    __slots__ = ('_margins', '_moves', '_negated', '_outlook', '_static')

    def __init__(
        self,
        stamps_ns: Sequence[int],
        begin_ns: float,
        end_ns: float,
        *,
        margins: Sequence[float],
        negated: bool,
        outlook: Callable[[float], float],
        moves: bool,
    ) -> None:
        super().__init__(stamps_ns, begin_ns, end_ns)
        self._margins = margins
        self._negated = negated
        self._outlook = outlook
        self._moves = moves
        self._static = outlook(end_ns)

    def _update(self, now_ns: int) -> None:
        if self.high:
            self.value[-1] = -self._margins[-1] if self._negated else self._margins[-1]

    def _future(self, now_ns: int) -> float:
        return self._outlook(self.end_ns) if self._moves else self._static


class JoinBound(LowerBound):
    """Lowest or highest of nodes with the same range, sample by sample."""

    __slots__ = ('_children', '_pick')

    def __init__(
        self,
        stamps_ns: Sequence[int],
        begin_ns: float,
        end_ns: float,
        *,
        lowest: bool,
        children: Sequence[LowerBound],
    ) -> None:
        super().__init__(stamps_ns, begin_ns, end_ns)
        self._pick: Callable[..., float] = min if lowest else max
        self._children = children

    def _update(self, now_ns: int) -> None:
        for child in self._children:
            self._touch(child.low, child.high)
        low, high = self.low, self.high
        if low < high:
            columns = (child.value[low:high] for child in self._children)
            self.value[low:high] = map(self._pick, *columns)

    def _future(self, now_ns: int) -> float:
        return self._pick(child.future(now_ns) for child in self._children)
