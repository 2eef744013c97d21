"""A formula in people's words: ``always over the run: |steering| <= 0.3 rad (17.19 deg)``."""

from __future__ import annotations

from collections.abc import Mapping

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.envelope import Range
from taxinet_ros.core.mtl.units import (
    PURE,
    Dimension,
    Quantity,
    added,
    dimension_of,
    multiplied,
    rooted,
    value_words,
)
from taxinet_ros.core.mtl.window import INF
from taxinet_ros.core.types import NS_PER_S

Units = Mapping[str, str]
"""Unit of each signal; one that is missing, or '', is not known."""


def quantity_of(expr: ast.Expr, units: Units) -> Quantity:
    """What is still known of the dimension of an expression that was parsed into SI."""
    match expr:
        case ast.Number():
            return PURE
        case ast.Signal(name):
            return Quantity(dimension_of(units.get(name, '')))
        case ast.Negative(child):
            return quantity_of(child, units)
        case ast.Arithmetic(op, left, right):
            one, two = quantity_of(left, units), quantity_of(right, units)
            if op in '+-':
                return added(one, two)
            # A number may have had a unit of its own, which is no longer known.
            known = one.pure == two.pure
            return multiplied(one, two, 1 if op == '*' else -1) if known else Quantity()
        case ast.Function(name, args):
            found = quantity_of(args[0], units)
            for arg in args[1:]:
                found = added(found, quantity_of(arg, units))
            return rooted(found) if name == 'sqrt' else found


def formula_words(formula: ast.Formula, units: Units) -> str:
    """The whole of a formula."""
    if isinstance(formula, ast.Compare):
        return f'at the start of the run: {atom_words(formula, units)}'
    return _formula(formula, units, outermost=True)


def atom_words(atom: ast.Compare, units: Units) -> str:
    """One comparison, its numbers with their unit."""
    dimension = compared_dimension(atom, units)
    return f'{_expr(atom.left, dimension)} {atom.op} {_expr(atom.right, dimension)}'


def compared_dimension(atom: ast.Compare, units: Units) -> Dimension | None:
    """Dimension of both sides of a comparison; None where it is not known."""
    return added(quantity_of(atom.left, units), quantity_of(atom.right, units)).dimension


def range_words(name: str, ends: Range, units: Units) -> str:
    """Where a signal stays: ``steering within ±0.261799 rad (15 deg)``; '' where nobody knows."""
    (low, high), dimension = ends, dimension_of(units.get(name, ''))
    if low == -high and high < INF:
        return f'{name} within ±{value_words(high, dimension)}'
    if low > -INF and high < INF:
        return f'{name} between {value_words(low, dimension)} and {value_words(high, dimension)}'
    return ''


def seconds_words(time_ns: float) -> str:
    """A time in seconds."""
    return f'{time_ns / NS_PER_S:g} s'


def _formula(formula: ast.Formula, units: Units, *, outermost: bool) -> str:
    def part(node: ast.Formula) -> str:
        text = _formula(node, units, outermost=outermost)
        return text if isinstance(node, ast.Compare) else f'({text})'

    match formula:
        case ast.Compare():
            return atom_words(formula, units)
        case ast.Not(child):
            return f'not {part(child)}'
        case ast.Logic('implies', left, right):
            return f'if {part(left)} then {part(right)}'
        case ast.Logic(op, left, right):
            return f'{part(left)} {op} {part(right)}'
        case ast.Temporal(op, interval, child):
            how = 'always' if op in ('always', 'historically') else 'at some time'
            when = _when(interval, outermost, past=op in ('historically', 'once'))
            return f'{how} {when}: {_formula(child, units, outermost=False)}'
        case ast.TemporalPair(op, interval, left, right):
            first, second = (_formula(node, units, outermost=False) for node in (left, right))
            when = _when(interval, outermost, past=op == 'since')
            return f'({first}) {op}, {when}, ({second})'


def _when(interval: ast.Interval, outermost: bool, *, past: bool) -> str:
    low, high = seconds_words(interval.low_ns), interval.high_ns
    if past:
        if high is None:
            return 'up to then' if not interval.low_ns else f'up to {low} before'
        return f'from {seconds_words(high)} to {low} before'
    if high is None:
        if interval.low_ns:
            return f'from {low} on' if outermost else f'from {low} later on'
        return 'over the run' if outermost else 'from then on'
    return f'from {low} to {seconds_words(high)}{"" if outermost else " later"}'


def _expr(expr: ast.Expr, dimension: Dimension | None) -> str:
    """An expression whose value has a dimension, which the numbers added in it have too."""
    match expr:
        case ast.Number(value):
            return value_words(value, dimension)
        case ast.Signal(name):
            return name
        case ast.Negative(ast.Number(value)):
            return value_words(-value, dimension)
        case ast.Negative(child):
            return f'-{_closed(child, dimension)}'
        case ast.Arithmetic(op, left, right):
            inside = dimension if op in '+-' else None
            return f'{_closed(left, inside)} {op} {_closed(right, inside)}'
        case ast.Function('abs', (arg,)):
            return f'|{_expr(arg, dimension)}|'
        case ast.Function(name, args):
            inside = None if name == 'sqrt' else dimension
            return f'{name}({", ".join(_expr(arg, inside) for arg in args)})'


def _closed(expr: ast.Expr, dimension: Dimension | None) -> str:
    compound = isinstance(expr, ast.Negative | ast.Arithmetic)
    return f'({_expr(expr, dimension)})' if compound else _expr(expr, dimension)
