"""Assumed bounds and rates of signals, and the predicate margins they allow.

Text form: ``cte=-25:25`` for a bound, ``cte=3`` for a rate.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.sliding import INF
from taxinet_ros.core.mtl.specs import SIGNALS
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError


@dataclass(frozen=True, kw_only=True, slots=True)
class Assumptions:
    """Assumptions on signals; they narrow robustness intervals before the end of a run.

    Attributes:
        bounds: minimum and maximum by signal, in the unit of the signal.
        rates: maximum change per second by signal.
    """

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)

    def about(self, names: Collection[str]) -> Assumptions:
        """Restrict to some signals."""
        return Assumptions(
            bounds={name: ends for name, ends in self.bounds.items() if name in names},
            rates={name: rate for name, rate in self.rates.items() if name in names},
        )

NO_ASSUMPTIONS = Assumptions()


def parse_assumptions(
    bounds: Iterable[str], rates: Iterable[str], signals: Collection[str] | None = None
) -> Assumptions:
    """Parse bounds and rates, see :func:`parse_bounds` and :func:`parse_rates`.

    Raises:
        UsageError: an invalid bound or rate.
    """
    return Assumptions(bounds=parse_bounds(bounds, signals), rates=parse_rates(rates, signals))


def check_read(assumptions: Assumptions, formulas: Iterable[ast.Formula]) -> None:
    """Check that some formula reads each signal that is assumed about.

    Raises:
        UsageError: an assumption has no effect.
    """
    read = {name for formula in formulas for name in ast.signal_names(formula)}
    for kind, assumed in (('bounds', assumptions.bounds), ('rates', assumptions.rates)):
        for name in assumed:
            if name not in read:
                raise UsageError(f'{kind} {name}: has no effect: no requirement reads {name}')


def parse_bounds(
    texts: Iterable[str], signals: Collection[str] | None = None
) -> dict[str, tuple[float, float]]:
    """Parse bounds, each ``SIGNAL=LOW:HIGH`` in the unit of the signal; an end may be ``inf``.

    Args:
        texts: the bounds.
        signals: known names; None: those of a run (:data:`.specs.SIGNALS`).

    Returns:
        Minimum and maximum by signal, in the form that :class:`Monitor` takes.

    Raises:
        UsageError: an unknown or repeated signal, or an invalid range.
    """
    found: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, value = _split(text, 'bounds', '-25:25', found, signals)
        ends = [_number(end) for end in value.split(':')]
        if len(ends) != 2 or not ends[0] <= ends[1] or math.inf in (ends[0], -ends[1]):
            raise UsageError(
                f'bounds {text!r}: expected LOW:HIGH with LOW <= HIGH{_unit(name)}, '
                f'e.g. {name}=-25:25'
            )
        found[name] = (ends[0], ends[1])
    return found


def parse_rates(
    texts: Iterable[str], signals: Collection[str] | None = None
) -> dict[str, float]:
    """Parse rate limits, each ``SIGNAL=RATE`` in the unit of the signal per second.

    Args:
        texts: the limits.
        signals: known names; None: those of a run (:data:`.specs.SIGNALS`).

    Returns:
        Maximum change per second by signal, in the form that :class:`Monitor` takes.

    Raises:
        UsageError: an unknown or repeated signal, or an invalid rate.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, value = _split(text, 'rates', '3', found, signals)
        rate = _number(value)
        if not 0 <= rate < math.inf:
            raise UsageError(
                f'rates {text!r}: expected a number >= 0{_unit(name, " per s")}, e.g. {name}=3'
            )
        found[name] = rate
    return found


def _split(
    text: str, what: str, example: str, found: Collection[str], signals: Collection[str] | None
) -> tuple[str, str]:
    known = SIGNALS if signals is None else signals
    name, sign, value = (part.strip() for part in text.partition('='))
    if not sign:
        first = next(iter(known), 'cte')
        raise UsageError(f'{what} {text!r}: expected SIGNAL=..., e.g. {first}={example}')
    if name not in known:
        raise UsageError(f'{what} {text!r}: unknown signal {name!r}; known: {", ".join(known)}')
    if name in found:
        raise UsageError(f'{what} {text!r}: {name} has one already')
    return name, value


def _unit(name: str, per: str = '') -> str:
    return f' [{SIGNALS[name]}{per}]' if name in SIGNALS else ''


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


Range = tuple[float, float]
ANYTHING: Range = (-INF, INF)
_CONE_SLACK = 1e-6
_CHECK_SLACK = 5e-7


class Envelope:
    """Assumed bounds and rates, and the last sample.

    Args:
        names: signals that the formula reads, in the order of the value tuples.
        bounds: minimum and maximum of some signals, in the unit of the signal.
        rates: maximum change per second of some signals, in the unit of the signal per second.

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
        """Violation of bounds or rates by a sample, or ''."""
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
        """Minimum margin (or negated margin) of any sample."""
        return _least(atom, negated, self._bounds)

    def least_margin(self, atom: ast.Compare, negated: bool, until_ns: float) -> float:
        """Minimum possible margin (or negated margin) at a later sample up to a time."""
        box = dict(self._bounds)
        if self._last:
            # Slightly wider than the rate, so that despite rounding the cone of a later sample
            # never leaves that of an earlier one.
            time_s = (until_ns - self._last_ns) / NS_PER_S * (1 + _CONE_SLACK)
            for name, rate in self._rates.items():
                value, (low, high) = self._last[self._index[name]], box[name]
                box[name] = max(low, value - rate * time_s), min(high, value + rate * time_s)
        return _least(atom, negated, box)


def _least(atom: ast.Compare, negated: bool, box: Mapping[str, Range]) -> float:
    low, high = margin_range(atom, box)
    return -high if negated else low


def margin_range(atom: ast.Compare, box: Mapping[str, Range]) -> Range:
    """Range that encloses every finite margin of an atom for signals in a box."""
    small, large = (atom.left, atom.right) if atom.op in ('<=', '<') else (atom.right, atom.left)
    return _arithmetic('-', enclose(large, box), enclose(small, box))


def enclose(expr: ast.Expr, box: Mapping[str, Range]) -> Range:
    """Range that encloses every finite value of an expression for signals in a box."""
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
            # An infinite end stands for arbitrarily large finite values, so 0 times it is 0.
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
            # A negative argument has no root; samples with one are rejected.
            return (
                (math.sqrt(max(0.0, lows[0])), math.sqrt(highs[0])) if highs[0] >= 0 else ANYTHING
            )


def _sound(corners: list[float]) -> Range:
    if any(map(math.isnan, corners)):
        return ANYTHING
    return min(corners), max(corners)
