"""Core form of a formula, used by offline and online evaluation.

Negation is pushed down to the atoms, so every operator is monotone in its operands. Each operator
takes either the lowest of its operands (and, always, historically, and the duals of until and
since) or the highest. The dual of an operator is the same operator of the other kind, applied to
the duals of its operands.

A bounded until is split after Donzé, Ferrère and Maler (Efficient robust monitoring for STL,
CAV 2013, section 3)::

    p until[a,b] q  =  eventually[a,b] q  and  always[0,a) p  and  (p until q) at t + a

where "at t + a" is the first sample at or after that time. Time is in integer nanoseconds, so the
half-open [0,a) is the closed [0,a-1]. Since is split the same way, backwards.

The split uses an operand twice, so copies would double at each level of nesting. To avoid this,
equal subformulas are one object: the core form is a directed acyclic graph, and a traversal caches
results by object id. Never hash or compare core nodes by structure.
"""

from __future__ import annotations

from dataclasses import dataclass

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.sliding import INF


@dataclass(frozen=True, slots=True)
class CoreAtom:
    """Margin of a predicate, or minus it."""

    atom: ast.Compare
    negated: bool


@dataclass(frozen=True, slots=True)
class CoreJoin:
    """Lowest (and) or highest (or) of the operands at the same sample."""

    lowest: bool
    children: tuple[Core, ...]


@dataclass(frozen=True, slots=True)
class CoreWindow:
    """Minimum or maximum of the operand over a future or past window."""

    lowest: bool
    past: bool
    interval: ast.Interval
    child: Core


@dataclass(frozen=True, slots=True)
class CoreChain:
    """Unbounded until and since (``lowest`` False) or their duals (True).

    ``reach_ns`` is how far from the sample the operands matter; None for the whole run. ``left``
    None stands for the neutral constant: unbounded once and historically.
    """

    lowest: bool
    past: bool
    reach_ns: int | None
    left: Core | None
    right: Core


@dataclass(frozen=True, slots=True)
class CoreShift:
    """The operand at the first sample at or after t + delay; past: the last at or before t - delay.

    ``lowest`` gives the value where there is no such sample: +inf if True, -inf if False.
    """

    lowest: bool
    past: bool
    delay_ns: int
    child: Core


Core = CoreAtom | CoreJoin | CoreWindow | CoreChain | CoreShift


def window_offsets(interval: ast.Interval, past: bool) -> tuple[float, float]:
    """Bounds of a window relative to the sample [ns]: ints, or +-inf if unbounded."""
    high_ns = INF if interval.high_ns is None else interval.high_ns
    return (-high_ns, -interval.low_ns) if past else (interval.low_ns, high_ns)


def normalise(formula: ast.Formula, *, negated: bool = False) -> Core:
    """Core form of a formula, or of its negation; equal subformulas are one object."""
    return Normaliser().core(formula, negated)


class Normaliser:
    """Makes core forms; equal subformulas of all its formulas are one object.

    Attributes:
        done: core forms by formula and whether it is negated.
    """

    def __init__(self) -> None:
        """Create it without any core form."""
        self.done: dict[tuple[ast.Formula, bool], Core] = {}

    def core(self, formula: ast.Formula, negated: bool) -> Core:
        """Core form of a formula, or of its negation."""
        key = formula, negated
        if key not in self.done:
            self.done[key] = self._made(formula, negated)
        return self.done[key]

    def _made(self, formula: ast.Formula, negated: bool) -> Core:
        match formula:
            case ast.Compare():
                return CoreAtom(formula, negated)
            case ast.Not(child):
                return self.core(child, not negated)
            case ast.Logic(op, left, right):
                first = self.core(left, negated != (op == 'implies'))
                return CoreJoin((op == 'and') != negated, (first, self.core(right, negated)))
            case ast.Temporal(op, interval, child):
                lowest = (op in ('always', 'historically')) != negated
                past = op in ('once', 'historically')
                return _unary(lowest, past, interval, self.core(child, negated))
            case ast.TemporalPair(op, interval, left, right):
                first, second = self.core(left, negated), self.core(right, negated)
                return _pair(negated, op == 'since', interval, first, second)


def _unary(lowest: bool, past: bool, interval: ast.Interval, child: Core) -> Core:
    if not past or interval.high_ns is not None:
        return CoreWindow(lowest, past, interval, child)
    chain = CoreChain(lowest, past, None, None, child)
    return _shifted(chain, interval.low_ns)


def _pair(lowest: bool, past: bool, interval: ast.Interval, left: Core, right: Core) -> Core:
    low, high = interval.low_ns, interval.high_ns
    chain = CoreChain(lowest, past, None if high is None else high - low, left, right)
    parts: list[Core] = []
    if high is not None:
        parts.append(CoreWindow(lowest, past, interval, right))
    if low > 0:
        parts.append(CoreWindow(not lowest, past, ast.Interval(0, low - 1), left))
    if not parts:
        return chain
    return CoreJoin(not lowest, (*parts, _shifted(chain, low)))


def _shifted(chain: CoreChain, delay_ns: int) -> Core:
    if delay_ns == 0:
        return chain
    return CoreShift(chain.lowest, chain.past, delay_ns, chain)
