"""Lint requirements before a run: readable form, errors and warnings.

Readable form: ``|steering| <= 0.3 rad (17.19 deg) all the time``. Checks windows, thresholds and
units.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.assumptions import ANYTHING, Range, enclose, margin_range
from taxinet_ros.core.mtl.offline import robustness_range
from taxinet_ros.core.mtl.sliding import INF
from taxinet_ros.core.mtl.specs import SWITCHES, Spec
from taxinet_ros.core.types import NS_PER_S, step_stamp_ns
from taxinet_ros.core.units import (
    ANGLE,
    PURE,
    Dimension,
    Quantity,
    added,
    dimension_of,
    multiplied,
    rooted,
    si_unit,
    value_words,
)
from taxinet_ros.errors import UsageError

UNSATISFIABLE = 'no run can satisfy it'

Units = Mapping[str, str]
"""Unit of each signal; missing or '' means unknown."""


def quantity_of(expr: ast.Expr, units: Units) -> Quantity:
    """Dimension of an expression in SI units, as far as known."""
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
            # A number may have been written with a unit, which is no longer known.
            known = one.pure == two.pure
            return multiplied(one, two, 1 if op == '*' else -1) if known else Quantity()
        case ast.Function(name, args):
            found = quantity_of(args[0], units)
            for arg in args[1:]:
                found = added(found, quantity_of(arg, units))
            return rooted(found) if name == 'sqrt' else found


def formula_words(formula: ast.Formula, units: Units) -> str:
    """Readable form of a formula."""
    match formula:
        case ast.Compare():
            return f'at the start of the run: {_plain_words(formula, units)}'
        case ast.Temporal('always', interval, ast.Compare() as atom):
            low, high = seconds_words(interval.low_ns), interval.high_ns
            when = f'from {low} to {"the end" if high is None else seconds_words(high)}'
            if not interval.low_ns and high is None:
                when = 'all the time'
            return f'{_plain_words(atom, units)} {when}'
        case ast.Temporal(
            'eventually', ast.Interval(0, int() as last),
            ast.Temporal('always', ast.Interval(0, None), ast.Compare() as atom),
        ):
            latest = f'from {seconds_words(last)} at the latest to the end'
            return f'{_plain_words(atom, units)} {latest}'
    return _formula(formula, units, outermost=True)


def _plain_words(atom: ast.Compare, units: Units) -> str:
    """A comparison as part of a sentence: ``within 1.5 m of the centreline``."""
    match atom:
        case ast.Compare('<=' | '<', ast.Function('abs', (ast.Signal('cte'),)), ast.Number(most)):
            tolerance = value_words(most, dimension_of(units.get('cte', '')))
            return f'within {tolerance} of the centreline'
    return atom_words(atom, units)


def atom_words(atom: ast.Compare, units: Units) -> str:
    """Readable form of a comparison, with units."""
    dimension = compared_dimension(atom, units)
    if not SWITCHES.isdisjoint(ast.signal_names(atom)):
        dimension = None
    return f'{_expr(atom.left, dimension)} {atom.op} {_expr(atom.right, dimension)}'


def compared_dimension(atom: ast.Compare, units: Units) -> Dimension | None:
    """Dimension of both sides of a comparison; None if unknown."""
    return added(quantity_of(atom.left, units), quantity_of(atom.right, units)).dimension


def rho_unit(formula: ast.Formula, units: Units) -> str:
    """SI unit of a formula's robustness; '' if it has none, or predicates have several."""
    found = {compared_dimension(atom, units) for atom in ast.atoms(formula)}
    return si_unit(found.pop()) if len(found) == 1 else ''


def range_words(name: str, ends: Range, units: Units) -> str:
    """Range of a signal as text: ``steering within ±0.261799 rad (15 deg)``; '' if unknown."""
    (low, high), dimension = ends, dimension_of('' if name in SWITCHES else units.get(name, ''))
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
    """Readable form of an expression; numbers added in it have the same dimension."""
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


_LARGE_RAD = 1.6
"""Larger integer angles were probably meant in degrees: as radians they exceed 90 degrees."""
_MOST_CASES = 256
"""Maximum number of cases tried per part of a formula."""
_Read = ast.Expr | ast.Formula | tuple[ast.Expr, ast.Expr]


@dataclass(frozen=True, kw_only=True, slots=True)
class Setting:
    """Known properties of the runs to be judged.

    Attributes:
        units: unit of each signal.
        ranges: known minimum and maximum of signals.
        horizon_ns: length of a run [ns].
        period_ns: time between samples [ns], or 0 if unknown.
    """

    units: Units
    ranges: Mapping[str, Range]
    horizon_ns: int
    period_ns: int = 0

    @property
    def stamps_ns(self) -> list[int]:
        """Stamps of the samples of a run."""
        return _stamps_ns(self.horizon_ns, self.period_ns)

    def box(self, formula: ast.Formula) -> dict[str, Range]:
        """Range of every signal read by a formula."""
        return {name: self.ranges.get(name, ANYTHING) for name in ast.signal_names(formula)}


def spec_line(spec: Spec, setting: Setting) -> str:
    """A parsed requirement in words."""
    return f'{spec.name}: {formula_words(spec.formula, setting.units)}'


def reach_words(spec: Spec, setting: Setting) -> str:
    """Known ranges of the signals that a requirement reads, and how far it looks."""
    box = setting.box(spec.formula)
    ranges = [range_words(name, ends, setting.units) for name, ends in box.items()]
    reach_ns = max((window.latest_ns for window in _windows(spec.formula)), default=0.0)
    horizon = seconds_words(min(reach_ns, setting.horizon_ns))
    return '; '.join([*filter(None, ranges), f'horizon {horizon}'])


def check_windows(spec: Spec, horizon_ns: int, period_ns: int = 0) -> None:
    """Check that every window can contain a sample of a run of this length.

    Args:
        spec: the requirement.
        horizon_ns: length of the run [ns].
        period_ns: time between samples [ns], or 0 if unknown.

    Raises:
        UsageError: a window cannot be evaluated: it starts after the end of the run, ends before
            its start, or can contain no sample.
    """
    length = seconds_words(horizon_ns)
    for window in _windows(spec.formula):
        where = f'spec {spec.name}: {window.words}'
        if window.earliest_ns > horizon_ns:
            raise UsageError(
                f'{where} begins {seconds_words(window.earliest_ns)} into the run, which lasts '
                f'{length}; it cannot be evaluated'
            )
        if window.latest_ns < 0:
            raise UsageError(f'{where} looks back to before the run; it cannot be evaluated')
    if not period_ns:
        return
    stamps = _stamps_ns(horizon_ns, period_ns)
    atoms = dict.fromkeys(ast.atoms(spec.formula), ANYTHING)
    low, high = robustness_range(spec.formula, stamps, atoms)
    if low == high and math.isinf(low):
        raise UsageError(
            f'spec {spec.name}: in a run of {length} the robustness is {low:g} whatever is '
            f'measured: some of its windows hold no sample (one every '
            f'{seconds_words(period_ns)}); change them'
        )


def _stamps_ns(horizon_ns: int, period_ns: int) -> list[int]:
    return [step_stamp_ns(seq, period_ns) for seq in range(horizon_ns // period_ns + 1)]


def warnings(spec: Spec, setting: Setting) -> list[str]:
    """Likely mistakes in a valid requirement, one line each."""
    found = list(_cut_windows(spec, setting.horizon_ns))
    if all(0 <= w.latest_ns < max(setting.period_ns, 1) for w in _windows(spec.formula)):
        found.append('evaluated at the first sample only; for the whole run write always(...)')
    box, atoms = setting.box(spec.formula), ast.atoms(spec.formula)
    margins = {atom: margin_range(atom, box) for atom in atoms}
    found += [text for atom in atoms for text in _atom_warnings(atom, setting, box)]
    vacuous = [
        text for atom in atoms if (text := _certain(atom, margins[atom], setting, box))
    ]
    certain = {atom for atom in atoms if margins[atom][0] > 0 or margins[atom][1] < 0}
    found += [
        f'{part}: nothing measured can {"violate" if truth else "satisfy"} it, for logical reasons'
        for part, truth in _settled(spec.formula) if certain.isdisjoint(ast.atoms(part))
    ]
    if setting.period_ns:
        low, high = robustness_range(spec.formula, setting.stamps_ns, margins)
        infinite = low == high and math.isinf(low)
        if (low > 0 or high <= 0) and not infinite:
            what = 'no run can violate it' if low > 0 else UNSATISFIABLE
            why = f': {"; ".join(vacuous)}' if vacuous else ''
            return [*(f'{spec.name}: {text}' for text in found), f'{spec.name}: {what}{why}']
    return [f'{spec.name}: {text}' for text in (*found, *vacuous)]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Window:
    """A window of a formula and its position in the run.

    Attributes:
        words: the operator without its operands.
        earliest_ns: start of its first position [ns].
        latest_ns: end of its last position [ns].
        first_end_ns: end of its first position [ns].
        ahead: whether it looks ahead.
    """

    words: str
    earliest_ns: float
    latest_ns: float
    first_end_ns: float
    ahead: bool


def _windows(
    formula: ast.Formula, begin_ns: float = 0, end_ns: float = 0
) -> Iterator[_Window]:
    """Windows of a formula that is evaluated from ``begin_ns`` to ``end_ns`` of a run."""
    match formula:
        case ast.Not(child):
            yield from _windows(child, begin_ns, end_ns)
        case ast.Logic(_, left, right):
            yield from _windows(left, begin_ns, end_ns)
            yield from _windows(right, begin_ns, end_ns)
        case ast.Temporal(op, interval, child):
            window = _window(op, interval, begin_ns, end_ns)
            yield window
            yield from _windows(child, max(window.earliest_ns, 0), window.latest_ns)
        case ast.TemporalPair(op, interval, left, right):
            window = _window(op, interval, begin_ns, end_ns)
            yield window
            first, last = max(window.earliest_ns, 0), window.latest_ns
            yield from _windows(left, min(begin_ns, first), max(end_ns, last))
            yield from _windows(right, first, last)


def _window(op: str, interval: ast.Interval, begin_ns: float, end_ns: float) -> _Window:
    low, high = interval.low_ns, INF if interval.high_ns is None else interval.high_ns
    ahead = op not in ('historically', 'once', 'since')
    return _Window(
        words=f'{op}{interval}', ahead=ahead,
        earliest_ns=begin_ns + low if ahead else begin_ns - high,
        latest_ns=end_ns + high if ahead else end_ns - low,
        first_end_ns=begin_ns + high if ahead else begin_ns - low,
    )


def _cut_windows(spec: Spec, horizon_ns: int) -> Iterator[str]:
    for window in _windows(spec.formula):
        if window.ahead and horizon_ns < window.first_end_ns < INF:
            yield (
                f'{window.words} ends at {seconds_words(window.first_end_ns)}, after the run of '
                f'{seconds_words(horizon_ns)}; only the part within the run is evaluated'
            )


def _atom_warnings(atom: ast.Compare, setting: Setting, box: Mapping[str, Range]) -> Iterator[str]:
    """Warnings on predicates that may be undefined or that likely have a wrong unit."""
    for part in (*_parts(atom.left), *_parts(atom.right)):
        match part:
            case ast.Arithmetic('/', _, right):
                low, high = enclose(right, box)
                if low <= 0 <= high:
                    yield f'{part} has no value where {right} is 0: this invalidates the run'
            case ast.Function('sqrt', (arg,)) if enclose(arg, box)[0] < 0:
                yield f'{part} has no value where {arg} is below 0: this invalidates the run'
    number = _threshold(atom)
    within = margin_range(atom, box)
    if (
        compared_dimension(atom, setting.units) == ANGLE and number is not None
        and _LARGE_RAD <= number <= 360 and number.is_integer() and within[0] <= 0 <= within[1]
    ):
        yield f'{atom_words(atom, setting.units)}: did you mean {number:g} deg?'


def _certain(
    atom: ast.Compare, margin: Range, setting: Setting, box: Mapping[str, Range]
) -> str:
    """Reason why a predicate is always true or always false, or ''."""
    if margin[0] <= 0 <= margin[1]:
        return ''
    names = ast.signal_names(atom)
    ranges = filter(None, (range_words(name, box[name], setting.units) for name in names))
    why = ', '.join(ranges) or 'by its numbers alone'
    truth = 'holds' if margin[0] > 0 else 'fails'
    number = _threshold(atom)
    meant = ''
    if compared_dimension(atom, setting.units) == ANGLE and number and 1 <= number <= 360:
        meant = f'; did you mean {number:g} deg?'
    return f'{atom_words(atom, setting.units)} always {truth} ({why}){meant}'


def _settled(formula: ast.Formula) -> Iterator[tuple[ast.Formula, bool]]:
    """Outermost parts that are logically constant, with their truth value."""
    match formula:
        case ast.Logic(_, left, right):
            truths = _truths(formula)
            if len(truths) == 1:
                yield formula, truths.pop()
                return
            parts: tuple[ast.Formula, ...] = (left, right)
        case ast.Not(child) | ast.Temporal(_, _, child):
            parts = (child,)
        case ast.TemporalPair(_, _, left, right):
            parts = (left, right)
        case ast.Compare():
            parts = ()
    for part in parts:
        yield from _settled(part)


def _truths(formula: ast.Formula) -> set[bool]:
    """Possible truth values of a part of a formula (conservative).

    Expressions and temporal parts are assumed independent. Their value range is split at every
    threshold, and one value of each open piece is tried; since rho is continuous, the thresholds
    need no extra case.
    """
    cuts: dict[_Read, set[float]] = {}
    for leaf in _leaves(formula):
        read, number, folded, _ = _reading(leaf)
        cuts.setdefault(read, set()).update((number, -number) if folded else (number,))
    pieces = [_inside(numbers) for numbers in cuts.values()]
    if math.prod(map(len, pieces)) > _MOST_CASES:
        return {True, False}
    cases = itertools.product(*pieces)
    return {_true(formula, dict(zip(cuts, case, strict=True))) for case in cases}


def _inside(cuts: set[float]) -> list[float]:
    """One value of each open piece between the cuts."""
    ends = sorted(cuts)
    first = (math.nextafter(low, INF) for low in ends)
    between = [at for at, high in zip(first, ends[1:], strict=False) if at < high]
    return [-INF, *between, INF]


def _true(formula: ast.Formula, case: Mapping[_Read, float]) -> bool:
    match formula:
        case ast.Not(child):
            return not _true(child, case)
        case ast.Logic(op, left, right):
            one, two = _true(left, case), _true(right, case)
            return one and two if op == 'and' else two or one is (op == 'or')
    read, number, folded, above = _reading(formula)
    value = abs(case[read]) if folded else case[read]
    return (value > number) is above


def _reading(leaf: ast.Formula) -> tuple[_Read, float, bool, bool]:
    """Expression of a leaf, its threshold, whether |.| is compared, whether it must be above."""
    if not isinstance(leaf, ast.Compare):
        return leaf, 0.0, False, True
    one, two, above = leaf.left, leaf.right, leaf.op in ('>', '>=')
    if _number(two) is None:
        one, two, above = two, one, not above
    number = _number(two)
    if number is None:
        return (leaf.left, leaf.right), 0.0, False, not above
    match one:
        case ast.Function('abs', (inner,)):
            return inner, number, True, above
    return one, number, False, above


def _leaves(formula: ast.Formula) -> Iterator[ast.Formula]:
    """Comparisons and temporal parts joined by and, or, not and implies."""
    match formula:
        case ast.Not(child):
            yield from _leaves(child)
        case ast.Logic(_, left, right):
            yield from _leaves(left)
            yield from _leaves(right)
        case _:
            yield formula


def _number(expr: ast.Expr) -> float | None:
    match expr:
        case ast.Number(value):
            return value
        case ast.Negative(ast.Number(value)):
            return -value
    return None


def _threshold(atom: ast.Compare) -> float | None:
    """Magnitude of a comparison's threshold, if it is a single number."""
    numbers = (_number(side) for side in (atom.right, atom.left))
    return next((abs(number) for number in numbers if number is not None), None)


def _parts(expr: ast.Expr) -> Iterator[ast.Expr]:
    yield expr
    match expr:
        case ast.Negative(child):
            yield from _parts(child)
        case ast.Arithmetic(_, left, right):
            yield from _parts(left)
            yield from _parts(right)
        case ast.Function(_, args):
            for arg in args:
                yield from _parts(arg)
