"""What signals can still do: bounds and rate limits, and the margins that they leave possible.

Interval arithmetic on the expression of a predicate (Moore, Interval Analysis, 1966). Rounding to
nearest is monotone, so the enclosures hold for the floating-point value, not just the real one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.window import INF
from taxinet_ros.core.types import NS_PER_S

Range = tuple[float, float]
ANYTHING: Range = (-INF, INF)

_CONE_SLACK = 1e-6
_CHECK_SLACK = 5e-7


class Envelope:
    """Bounds and rates that the user vouches for, and the last sample.

    Args:
        names: signals that the formula reads, in the order of the value tuples.
        bounds: least and greatest value of some signals, in the unit of the signal.
        rates: greatest change per second of some signals, in the unit of the signal per second.

    Raises:
        UsageError: an empty or NaN range, or a rate that is negative or not finite.
    """

    def __init__(
        self,
        names: Sequence[str],
        bounds: Mapping[str, Range] | None,
        rates: Mapping[str, float] | None,
    ) -> None:
        for name, (low, high) in (bounds or {}).items():
            if not (low <= high and low < INF and high > -INF):
                raise UsageError(f'monitor: bounds of {name} are {low}:{high}, need low <= high')
        for name, rate in (rates or {}).items():
            if not 0 <= rate < INF:
                raise UsageError(
                    f'monitor: rate of {name} is {rate}, needs to be >= 0 per second, and finite'
                )
        self._bounds = {name: (bounds or {}).get(name, ANYTHING) for name in names}
        self._rates = {name: rate for name, rate in (rates or {}).items() if name in names}
        self._index = {name: index for index, name in enumerate(names)}
        self._last: Sequence[float] = ()
        self._last_ns = 0

    def breach(self, stamp_ns: int, values: Sequence[float]) -> str:
        """How a sample breaks the bounds, or the rates since the last one; '' where it does not."""
        for (name, (low, high)), value in zip(self._bounds.items(), values, strict=True):
            if not low <= value <= high:
                return f'{name} is {value:g}, bounds are {low:g}:{high:g}'
        if not self._last:
            return ''
        time_s = (stamp_ns - self._last_ns) / NS_PER_S
        for name, rate in self._rates.items():
            change = abs(values[self._index[name]] - self._last[self._index[name]])
            if not change <= rate * (time_s * (1 + _CHECK_SLACK)):
                return f'{name} changes by {change:g} in {time_s:g} s, its rate is {rate:g} per s'
        return ''

    def accept(self, stamp_ns: int, values: Sequence[float]) -> None:
        """Take a sample as the last one."""
        self._last_ns, self._last = stamp_ns, values

    def moves(self, atom: ast.Compare) -> bool:
        """Whether the atom's reachable margins depend on the last sample."""
        return any(name in self._rates for name in ast.signal_names(atom))

    def floor(self, atom: ast.Compare, negated: bool) -> float:
        """Least margin (or negated margin) that any sample can have."""
        return _least(atom, negated, self._bounds)

    def least_margin(self, atom: ast.Compare, negated: bool, until_ns: float) -> float:
        """Least margin (or negated margin) that is possible at a later sample up to a time."""
        box = dict(self._bounds)
        if self._last:
            # A little wider than the rate says, so that in spite of rounding the cone of a later
            # sample never leaves that of an earlier one.
            time_s = (until_ns - self._last_ns) / NS_PER_S * (1 + _CONE_SLACK)
            for name, rate in self._rates.items():
                value, (low, high) = self._last[self._index[name]], box[name]
                box[name] = max(low, value - rate * time_s), min(high, value + rate * time_s)
        return _least(atom, negated, box)


def _least(atom: ast.Compare, negated: bool, box: Mapping[str, Range]) -> float:
    low, high = margin_range(atom, box)
    return -high if negated else low


def margin_range(atom: ast.Compare, box: Mapping[str, Range]) -> Range:
    """Every finite margin of an atom for signals in a box lies in the returned range."""
    small, large = (atom.left, atom.right) if atom.op in ('<=', '<') else (atom.right, atom.left)
    return _arithmetic('-', enclose(large, box), enclose(small, box))


def enclose(expr: ast.Expr, box: Mapping[str, Range]) -> Range:
    """Every finite value of an expression for signals in a box lies in the returned range."""
    match expr:
        case ast.Number(value):
            return value, value
        case ast.Signal(name):
            return box[name]
        case ast.Negative(child):
            low, high = enclose(child, box)
            return -high, -low
        case ast.Arithmetic('*', left, right) if left == right:
            size = _function('abs', [enclose(left, box)])
            return _arithmetic('*', size, size)
        case ast.Arithmetic(op, left, right):
            return _arithmetic(op, enclose(left, box), enclose(right, box))
        case ast.Function(name, args):
            return _function(name, [enclose(arg, box) for arg in args])


def _arithmetic(op: ast.ArithmeticOp, left: Range, right: Range) -> Range:
    match op:
        case '+':
            return _sound([left[0] + right[0], left[1] + right[1]])
        case '-':
            return _sound([left[0] - right[1], left[1] - right[0]])
        case '*':
            # An infinite end means any finite value, however large, and 0 times that is 0.
            return _sound([a * b if a and b else 0.0 for a in left for b in right])
        case '/':
            if right[0] <= 0 <= right[1] or any(map(math.isinf, right)):
                return ANYTHING
            return _sound([a / b for a in left for b in right])


def _function(name: ast.FunctionName, args: list[Range]) -> Range:
    lows, highs = [low for low, _ in args], [high for _, high in args]
    match name:
        case 'min':
            return min(lows), min(highs)
        case 'max':
            return max(lows), max(highs)
        case 'abs':
            return max(0.0, lows[0], -highs[0]), max(-lows[0], highs[0])
        case 'sqrt':
            # A negative argument has no root; the sample that has one is refused.
            return (
                (math.sqrt(max(0.0, lows[0])), math.sqrt(highs[0])) if highs[0] >= 0 else ANYTHING
            )


def _sound(corners: list[float]) -> Range:
    if any(map(math.isnan, corners)):
        return ANYTHING
    return min(corners), max(corners)
