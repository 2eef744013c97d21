"""Core form to the nodes that bound it from below, each with the time range that matters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.envelope import Envelope
from taxinet_ros.core.mtl.lower import AtomBound, JoinBound, LowerBound
from taxinet_ros.core.mtl.lower_ahead import (
    ChainAheadBound,
    HighestAheadBound,
    LowestAheadBound,
    ShiftAheadBound,
)
from taxinet_ros.core.mtl.lower_back import ChainBackBound, ShiftBackBound, WindowBackBound
from taxinet_ros.core.mtl.normal import Core, CoreAtom, CoreChain, CoreJoin, CoreShift, CoreWindow
from taxinet_ros.core.mtl.window import INF


class Builder:
    """Builds nodes over one growing trace.

    Args:
        stamps_ns: stamps of the trace, which the owner appends to.
        margins: margins of each predicate, which the owner appends to.
        envelope: what the signals can still do.
        horizon_ns: end of the run [ns].

    Attributes:
        nodes: every node built so far, operands before operators.
    """

    def __init__(
        self,
        stamps_ns: Sequence[int],
        margins: Mapping[ast.Compare, Sequence[float]],
        envelope: Envelope,
        horizon_ns: int,
    ) -> None:
        self.nodes: list[LowerBound] = []
        self._stamps_ns = stamps_ns
        self._margins = margins
        self._envelope = envelope
        self._horizon_ns = horizon_ns

    def build(self, core: Core, begin_ns: float, end_ns: float) -> LowerBound:
        """Node for a core formula that is asked at samples within [begin, end]."""
        match core:
            case CoreAtom():
                node = self._atom(core, begin_ns, end_ns)
            case CoreJoin(lowest, cores):
                children = [self.build(child, begin_ns, end_ns) for child in cores]
                node = JoinBound(
                    self._stamps_ns, begin_ns, end_ns, lowest=lowest, children=children
                )
            case CoreWindow():
                node = self._window(core, begin_ns, end_ns)
            case CoreChain():
                node = self._chain(core, begin_ns, end_ns)
            case CoreShift():
                node = self._shift(core, begin_ns, end_ns)
        self.nodes.append(node)
        return node

    def _atom(self, core: CoreAtom, begin_ns: float, end_ns: float) -> LowerBound:
        atom, negated, envelope = core.atom, core.negated, self._envelope
        return AtomBound(
            self._stamps_ns,
            begin_ns,
            end_ns,
            margins=self._margins[atom],
            negated=negated,
            outlook=partial(envelope.least_margin, atom, negated),
            moves=envelope.moves(atom),
        )

    def _window(self, core: CoreWindow, begin_ns: float, end_ns: float) -> LowerBound:
        low_ns, high_ns = core.interval.low_ns, core.interval.high_ns
        if core.past:
            assert high_ns is not None, 'an unbounded window into the past is a chain'
            return WindowBackBound(
                self._stamps_ns,
                begin_ns,
                end_ns,
                lowest=core.lowest,
                window_ns=(low_ns, high_ns),
                child=self.build(core.child, begin_ns - high_ns, end_ns - low_ns),
            )
        reach_ns = INF if high_ns is None else high_ns
        child_end_ns = min(end_ns + reach_ns, self._horizon_ns)
        kind = LowestAheadBound if core.lowest else HighestAheadBound
        return kind(
            self._stamps_ns,
            begin_ns,
            end_ns,
            window_ns=(low_ns, reach_ns),
            child=self.build(core.child, begin_ns + low_ns, child_end_ns),
            horizon_ns=self._horizon_ns,
        )

    def _chain(self, core: CoreChain, begin_ns: float, end_ns: float) -> LowerBound:
        reach_ns = INF if core.reach_ns is None else core.reach_ns
        if core.past:
            begin_ns -= reach_ns
            left = None if core.left is None else self.build(core.left, begin_ns, end_ns)
            right = self.build(core.right, begin_ns, end_ns)
            return ChainBackBound(
                self._stamps_ns, begin_ns, end_ns, lowest=core.lowest, left=left, right=right
            )
        assert core.left is not None, 'an unbounded window ahead is a window'
        end_ns = min(end_ns + reach_ns, self._horizon_ns)
        guard = self.build(core.left, begin_ns, end_ns)
        right = self.build(core.right, begin_ns, end_ns)
        return ChainAheadBound(
            self._stamps_ns, begin_ns, end_ns, lowest=core.lowest, left=guard, right=right
        )

    def _shift(self, core: CoreShift, begin_ns: float, end_ns: float) -> LowerBound:
        if core.past:
            return ShiftBackBound(
                self._stamps_ns,
                begin_ns,
                end_ns,
                lowest=core.lowest,
                delay_ns=core.delay_ns,
                child=self.build(core.child, begin_ns - core.delay_ns, end_ns - core.delay_ns),
            )
        delay_ns, horizon_ns = core.delay_ns, self._horizon_ns
        child_end_ns = min(end_ns + delay_ns, horizon_ns)
        return ShiftAheadBound(
            self._stamps_ns,
            begin_ns,
            end_ns,
            lowest=core.lowest,
            delay_ns=delay_ns,
            child=self.build(core.child, begin_ns + delay_ns, child_end_ns),
            horizon_ns=horizon_ns,
        )
