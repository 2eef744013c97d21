"""Builds the lower-bound nodes of a core formula, each with the time range that matters."""

from __future__ import annotations

import math
from collections.abc import Callable

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.lower_bounds.nodes import (
    AtomBound,
    BoundRequest,
    ChainAheadBound,
    ChainBackBound,
    JoinBound,
    LowerBound,
)
from taxinet_ros.core.mtl.lower_bounds.windows import (
    AheadBound,
    ShiftAheadBound,
    ShiftBackBound,
    WindowBound,
)
from taxinet_ros.core.mtl.normal_form import (
    Core,
    CoreAtom,
    CoreChain,
    CoreJoin,
    CoreShift,
    CoreWindow,
    Normaliser,
    normalise,
    window_offsets,
)
from taxinet_ros.core.mtl.sliding import INF
from taxinet_ros.errors import UsageError

MakeAtom = Callable[[CoreAtom, BoundRequest], AtomBound]

MAX_NODES = 1_000
"""Maximum number of nodes of one formula; limits the cost of a sample to about a millisecond."""

_NO_END_NS = 2**62


class Root:
    """Node of a whole formula, which is evaluated at the first sample only.

    Attributes:
        bound: lower bound of the run's robustness.
        wake_ns: before this time the bound cannot change, and :meth:`follow` need not be called.
    """

    __slots__ = ('_builder', '_cores', '_node', '_steps', 'bound', 'wake_ns')

    def __init__(
        self, formula: ast.Formula, builder: Builder, first_ns: int, *, negated: bool
    ) -> None:
        self._builder, self._cores = builder, Normaliser()
        core = self._cores.core(formula, negated)
        self._node = node = builder.build(core, first_ns, first_ns)
        self._steps = [part.step for part in builder.nodes]
        self.bound = node.floor
        self.wake_ns = node.wake_ns

    def follow(self, now_ns: int) -> None:
        """Update the bound; the trace is complete up to ``now_ns``."""
        node = self._node
        for step in self._steps:
            step(now_ns)
        if node.low < node.high:
            # Adding 0.0 turns -0.0 into 0.0, as in offline evaluation.
            self.bound = node.value[0] + 0.0
        if now_ns >= node.final_ns:
            self.wake_ns = INF

    def bounds_of(self, part: ast.Formula, negated: bool) -> Callable[[int], float]:
        """Lower bound of a subformula, or of its negation, by the index of a sample.

        It is NaN where the whole formula does not depend on it. Call :meth:`follow` before, as
        nothing is computed before ``wake_ns``.
        """
        nodes = self._builder.nodes_of(self._cores.done[part, negated])
        stamps_ns = self._node.stamps_ns

        def bound(row: int) -> float:
            for node in nodes:
                if node.begin_ns <= stamps_ns[row] <= node.end_ns:
                    return node.value[row] if row < node.rows else node.floor
            return math.nan

        return bound


class Builder:
    """Builds the nodes of one core formula over one growing trace.

    A subformula that is evaluated at the same samples in several places is one node.

    Args:
        stamps_ns: stamps of the trace, which the owner appends to.
        horizon_ns: end of the run [ns].
        make_atom: makes the node of a predicate.

    Attributes:
        nodes: all nodes, operands first; they must be stepped in this order.
    """

    def __init__(self, stamps_ns: list[int], horizon_ns: int, make_atom: MakeAtom) -> None:
        self._stamps_ns = stamps_ns
        self._horizon_ns = horizon_ns
        self._make_atom = make_atom
        self._built: dict[tuple[int, float, float], LowerBound] = {}
        self.nodes: list[LowerBound] = []

    def build(self, core: Core, begin_ns: float, end_ns: float) -> LowerBound:
        """Node of a core formula that is evaluated at samples within [begin, end].

        Raises:
            UsageError: there would be more than :data:`MAX_NODES` nodes.
        """
        key = id(core), begin_ns, end_ns
        node = self._built.get(key)
        if node is None:
            node = self._built[key] = self._made(core, begin_ns, end_ns)
            self.nodes.append(node)
            if len(self.nodes) > MAX_NODES:
                raise UsageError(
                    f'formula: nested until[a:b] and since[a:b] with a > 0 make more than '
                    f'{MAX_NODES:,} parts, each level twice as many; write fewer levels'
                )
        return node

    def nodes_of(self, core: Core) -> list[LowerBound]:
        """Nodes of a core formula, one for each range in which it is evaluated."""
        return [node for (made_of, *_), node in self._built.items() if made_of == id(core)]

    def _made(self, core: Core, begin_ns: float, end_ns: float) -> LowerBound:
        asked = self._asked(begin_ns, end_ns)
        match core:
            case CoreAtom():
                return self._make_atom(core, asked)
            case CoreJoin(lowest, cores):
                children = [self.build(child, begin_ns, end_ns) for child in cores]
                return JoinBound(asked, lowest=lowest, children=children)
            case CoreWindow():
                return self._window(core, asked)
            case CoreChain():
                return self._chain(core, asked)
            case CoreShift():
                return self._shift(core, asked)

    def _asked(self, begin_ns: float, end_ns: float) -> BoundRequest:
        return BoundRequest(
            stamps_ns=self._stamps_ns,
            begin_ns=begin_ns,
            end_ns=end_ns,
            horizon_ns=self._horizon_ns,
        )

    def _window(self, core: CoreWindow, asked: BoundRequest) -> LowerBound:
        low_ns, high_ns = offsets = window_offsets(core.interval, core.past)
        end_ns = min(asked.end_ns + high_ns, self._horizon_ns)
        child = self.build(core.child, asked.begin_ns + low_ns, end_ns)
        if child.settled and not core.past:
            return AheadBound(asked, lowest=core.lowest, offsets=offsets, child=child)
        return WindowBound(asked, lowest=core.lowest, offsets=offsets, child=child)

    def _chain(self, core: CoreChain, asked: BoundRequest) -> LowerBound:
        reach_ns = INF if core.reach_ns is None else core.reach_ns
        begin_ns, end_ns = asked.begin_ns, asked.end_ns
        if core.past:
            begin_ns -= reach_ns
        else:
            end_ns = min(end_ns + reach_ns, self._horizon_ns)
        left = None if core.left is None else self.build(core.left, begin_ns, end_ns)
        right = self.build(core.right, begin_ns, end_ns)
        asked = self._asked(begin_ns, end_ns)
        if core.past:
            return ChainBackBound(asked, lowest=core.lowest, left=left, right=right)
        assert left is not None, 'an unbounded window ahead is a window'
        return ChainAheadBound(asked, lowest=core.lowest, left=left, right=right)

    def _shift(self, core: CoreShift, asked: BoundRequest) -> LowerBound:
        delay_ns = -core.delay_ns if core.past else core.delay_ns
        end_ns = min(asked.end_ns + delay_ns, self._horizon_ns)
        child = self.build(core.child, asked.begin_ns + delay_ns, end_ns)
        kind = ShiftBackBound if core.past else ShiftAheadBound
        return kind(asked, lowest=core.lowest, delay_ns=core.delay_ns, child=child)


def check_parts(formula: ast.Formula) -> None:
    """Check that a formula can be monitored.

    Raises:
        UsageError: it would need more than :data:`MAX_NODES` nodes on some run.
    """
    def blank(core: CoreAtom, asked: BoundRequest) -> AtomBound:
        return AtomBound(asked, margins=(), floor=-INF, outlook=None)

    # Worst case: a finite horizon can only make sample ranges equal, so nodes are shared more.
    Builder([], _NO_END_NS, blank).build(normalise(formula), 0, 0)
