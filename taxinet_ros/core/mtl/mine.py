"""Formulas with parameters, and the tightest value with which a trace satisfies one.

A parameter is a name that begins with a capital letter, for a number or for an end of a window:
``always[T:30](abs(cte) <= A)``. Robustness has to be monotone in it, which is read off the formula:
always shrinks as its window grows, a comparison grows with its larger side, and a negation turns
the direction around (Asarin, Donzé, Maler and Nickovic, Parametric identification of temporal
properties, RV 2011). Then the values with which a trace satisfies the formula have one end, which
bisection finds.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.lexer import RESERVED, fail, tokens
from taxinet_ros.core.mtl.margin import compile_margin
from taxinet_ros.core.mtl.offline import Array, robustness
from taxinet_ros.core.mtl.parser import parse
from taxinet_ros.core.mtl.specs import SIGNALS
from taxinet_ros.core.types import NS_PER_S, step_stamp_ns, steps_in
from taxinet_ros.errors import UsageError

Signs = Iterator[tuple[str | int, int]]
"""Parameters where they stand, by name or mark: whether robustness rises with each."""

_WHERE = 'mine'
_MOST = 2
_MARKS_NS = (7_919, 3_600 * NS_PER_S + 7_919)
"""Times that stand for a window's parameter in a parsed formula: an early and a late one."""
_GREATEST = 1e12
_PRECISION = 1e-9


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """A parameter of a formula.

    Attributes:
        name: its name.
        rises: whether robustness rises with it, so that its tightest value is the least; if not,
            robustness falls, and the tightest is the greatest.
        mark_ns: for an end of a window, the time that stands for it in the formula [ns]; 0 for a
            number.
        least_ns, most_ns: for an end of a window, the range set by its other ends [ns]; None: by
            the run's.
        step_ns: its resolution [ns].
    """

    name: str
    rises: bool
    mark_ns: int = 0
    least_ns: int = 0
    most_ns: int | None = None
    step_ns: int = 1

    def times_s(self, end_ns: int) -> list[float]:
        """Values that an end of a window can have in a run, from the tightest to the loosest."""
        most_ns = end_ns if self.most_ns is None else min(self.most_ns, end_ns)
        steps = range(steps_in(self.least_ns, self.step_ns), most_ns // self.step_ns + 1)
        ordered = steps if self.rises else steps[::-1]
        return [step_stamp_ns(step, self.step_ns) / NS_PER_S for step in ordered]


@dataclass(frozen=True, kw_only=True, slots=True)
class Template:
    """A formula with parameters.

    Attributes:
        formula: the formula; numbers are signals of the parameter's name.
        parameters: its parameters in the order in which they are written.
    """

    formula: ast.Formula
    parameters: tuple[Parameter, ...]

    def read(self) -> set[str]:
        """Names of the signals of a run that it reads."""
        return {*ast.signal_names(self.formula)} - {one.name for one in self.parameters}

    def robustness(
        self, values: Mapping[str, float], stamps_ns: Sequence[int] | Array,
        signals: Mapping[str, Sequence[float] | Array],
    ) -> float:
        """Robustness of a finished trace with values of all parameters; windows in seconds."""
        times_ns = {
            one.mark_ns: round(values[one.name] * NS_PER_S)
            for one in self.parameters if one.mark_ns
        }
        constants = {name: np.full(len(stamps_ns), value) for name, value in values.items()}
        return robustness(_with_times(self.formula, times_ns), stamps_ns, {**signals, **constants})

    def tightest(
        self, parameter: Parameter, others: Mapping[str, float],
        stamps_ns: Sequence[int] | Array, signals: Mapping[str, Sequence[float] | Array],
    ) -> float:
        """The tightest value with which a finished trace satisfies the formula.

        Args:
            parameter: the parameter.
            others: values of the other ones.
            stamps_ns: stamps of the trace [ns].
            signals: its signals.

        Returns:
            The value, which satisfies it; that of a number is found to nine digits, and that of a
            window in steps. Where none does, infinity, with the sign of the looser values;
            where all do, with the sign of the tighter ones (a window has a tightest value).
        """
        sign = 1.0 if parameter.rises else -1.0

        def rho(looseness: float) -> float:
            values = {**others, parameter.name: sign * looseness}
            return self.robustness(values, stamps_ns, signals)

        if not parameter.mark_ns:
            return sign * _least(rho)
        times_s = parameter.times_s(int(stamps_ns[-1]))
        first = bisect_left(times_s, True, key=lambda time_s: rho(sign * time_s) > 0)
        # A window without samples satisfies nothing: robustness is infinite there.
        if first == len(times_s) or math.isinf(rho(sign * times_s[first])):
            return sign * math.inf
        return times_s[first]


def parse_template(text: str, step_ns: int) -> Template:
    """Parse a formula with one or two parameters over the signals of a run.

    Args:
        text: the formula.
        step_ns: resolution of times: the distance of samples [ns].

    Raises:
        UsageError: an invalid formula, no parameter or too many, or one in which robustness is not
            monotone.
    """
    found: dict[str, int] = {}
    in_window: dict[str, bool] = {}
    depth = 0
    for token, after in itertools.pairwise(tokens(text, _WHERE)):
        depth += {'[': 1, ']': -1}.get(token.text, 0)
        if token.kind == 'name' and token.text[0].isupper() and token.text not in RESERVED:
            if in_window.setdefault(token.text, depth > 0) != (depth > 0):
                fail(_WHERE, token.column, f'{token} is a number and a time; name two parameters')
            if depth and after.kind in ('name', 'word'):
                fail(_WHERE, after.column, f'{token} has a unit; a time is in seconds without one')
            found.setdefault(token.text, token.column)
    if not 0 < len(found) <= _MOST:
        letters = ', '.join(sorted(word for word in RESERVED if len(word) == 1))
        raise UsageError(
            f'{_WHERE}: {len(found)} parameters in {text!r}; write one or two names that begin '
            f'with a capital letter, such as A, B or T (operators are {letters})'
        )
    formula, marks = _parsed(text, in_window)
    of: frozenset[str | int] = frozenset((*in_window, *marks.values()))
    signs: dict[str | int, set[int]] = {}
    for key, sign in _signs(formula, of):
        signs.setdefault(key, set()).add(sign)
    parameters = []
    for name, column in found.items():
        mark_ns = marks.get(name, 0)
        seen = signs.get(mark_ns or name, set())
        if len(seen) != 1 or 0 in seen:
            fail(_WHERE, column, f'robustness is not monotone in {name}: no value is the tightest')
        least_ns, most_ns = _range(formula, mark_ns, [*marks.values()])
        parameters.append(Parameter(
            name=name, rises=1 in seen, mark_ns=mark_ns, least_ns=least_ns, most_ns=most_ns,
            step_ns=step_ns,
        ))
    return Template(formula=formula, parameters=tuple(parameters))


def _parsed(text: str, in_window: Mapping[str, bool]) -> tuple[ast.Formula, dict[str, int]]:
    """The formula, and the time that stands for each parameter of a window."""
    signals = {**SIGNALS, **{name: '' for name, window in in_window.items() if not window}}
    times = [name for name, window in in_window.items() if window]
    error: UsageError | None = None
    # Ends of a window are in order; which mark is one depends on the other end.
    for marks in itertools.product(_MARKS_NS, repeat=len(times)):
        named = {name: mark + at for at, (name, mark) in enumerate(zip(times, marks, strict=True))}
        parts = list(text)
        for token in reversed(tokens(text, _WHERE)):
            if token.text in named:
                start = token.column - 1
                parts[start:start + len(token.raw)] = f'{named[token.text] / NS_PER_S:.9f}'
        replaced = ''.join(parts)
        # The columns in an error are those of this text.
        where = f'{_WHERE}: {replaced}' if times else _WHERE
        try:
            return parse(replaced, signals, where=where), named
        except UsageError as failed:
            error = error or failed
    assert error is not None
    raise error


def _parts(formula: ast.Formula) -> Iterator[ast.Formula]:
    yield formula
    match formula:
        case ast.Not(child) | ast.Temporal(_, _, child):
            yield from _parts(child)
        case ast.Logic(_, left, right) | ast.TemporalPair(_, _, left, right):
            yield from _parts(left)
            yield from _parts(right)


def _range(
    formula: ast.Formula, mark_ns: int, marks_ns: Collection[int]
) -> tuple[int, int | None]:
    """Range of an end of a window that the other ends leave [ns]."""
    least_ns, most_ns = 0, None
    for part in _parts(formula):
        if not mark_ns or not isinstance(part, ast.Temporal | ast.TemporalPair):
            continue
        low_ns, high_ns = part.interval.low_ns, part.interval.high_ns
        if mark_ns in (low_ns, high_ns) and low_ns in marks_ns and high_ns in marks_ns:
            raise UsageError(f'{_WHERE}: both ends of a window are parameters; give one of them')
        if high_ns == mark_ns:
            least_ns = max(least_ns, low_ns)
        if low_ns == mark_ns and high_ns is not None:
            most_ns = high_ns if most_ns is None else min(most_ns, high_ns)
    return least_ns, most_ns


def _with_times(formula: ast.Formula, times_ns: Mapping[int, int]) -> ast.Formula:
    """The formula with other times in place of marks."""
    if not times_ns or isinstance(formula, ast.Compare):
        return formula
    match formula:
        case ast.Not(child):
            return ast.Not(_with_times(child, times_ns))
        case ast.Logic(op, left, right):
            return ast.Logic(op, _with_times(left, times_ns), _with_times(right, times_ns))
    low_ns, high_ns = formula.interval.low_ns, formula.interval.high_ns
    interval = ast.Interval(
        times_ns.get(low_ns, low_ns), None if high_ns is None else times_ns.get(high_ns, high_ns)
    )
    if isinstance(formula, ast.Temporal):
        return replace(formula, interval=interval, child=_with_times(formula.child, times_ns))
    return replace(
        formula, interval=interval, left=_with_times(formula.left, times_ns),
        right=_with_times(formula.right, times_ns),
    )


def _signs(formula: ast.Formula, of: frozenset[str | int], sign: int = 1) -> Signs:
    """How robustness goes with each parameter where it stands: 1 up, -1 down, 0 not known."""
    match formula:
        case ast.Compare(op, left, right):
            yield from _expr_signs(left, of, -sign if op in ('<=', '<') else sign)
            yield from _expr_signs(right, of, sign if op in ('<=', '<') else -sign)
        case ast.Not(child):
            yield from _signs(child, of, -sign)
        case ast.Logic(op, left, right):
            yield from _signs(left, of, -sign if op == 'implies' else sign)
            yield from _signs(right, of, sign)
        case ast.Temporal(op, interval, child):
            # More samples lower a minimum and raise a maximum.
            more = -sign if op in ('always', 'historically') else sign
            yield from _interval_signs(interval, of, more)
            yield from _signs(child, of, sign)
        case ast.TemporalPair(_, interval, left, right):
            yield from _interval_signs(interval, of, sign)
            yield from _signs(left, of, sign)
            yield from _signs(right, of, sign)


def _interval_signs(interval: ast.Interval, of: frozenset[str | int], more: int) -> Signs:
    if interval.low_ns in of:
        yield interval.low_ns, -more
    if interval.high_ns is not None and interval.high_ns in of:
        yield interval.high_ns, more


def _expr_signs(expr: ast.Expr, of: frozenset[str | int], sign: int) -> Signs:
    match expr:
        case ast.Signal(name) if name in of:
            yield name, sign
        case ast.Negative(child):
            yield from _expr_signs(child, of, -sign)
        case ast.Arithmetic(op, left, right):
            yield from _expr_signs(left, of, sign * (_factor(right) if op in '*/' else 1))
            other = {'+': 1, '-': -1, '*': _factor(left), '/': 0}[op]
            yield from _expr_signs(right, of, sign * other)
        case ast.Function(name, args):
            for arg in args:
                yield from _expr_signs(arg, of, 0 if name == 'abs' else sign)


def _factor(expr: ast.Expr) -> int:
    """Sign of a constant; 0 if it is none."""
    atom = ast.Compare('<=', ast.Number(0.0), expr)
    if ast.signal_names(atom):
        return 0
    value = compile_margin(atom, ())(())
    return (value > 0) - (value < 0)


def _least(rho: Callable[[float], float]) -> float:
    """The least number at which a function that never falls is positive."""
    # Most margins grow as fast as the parameter, so the end is near here.
    guess = -rho(0.0)
    if math.isinf(guess):
        return math.inf
    step = _PRECISION * max(1.0, abs(guess))
    high, width = guess, step
    while rho(high) <= 0:
        high, width = high + width, 4 * width
        if high > _GREATEST:
            return math.inf
    low, width = high - step, step
    while rho(low) > 0:
        high, low, width = low, low - width, 4 * width
        if low < -_GREATEST:
            return -math.inf
    while high - low > _PRECISION * max(1.0, abs(high)):
        middle = (low + high) / 2
        low, high = (low, middle) if rho(middle) > 0 else (middle, high)
    return high
