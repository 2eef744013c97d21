"""Why a run has its robustness: rho of every part of a formula, and the sample that decides.

The values are those of the monitor's own nodes, so they exist during the run too, as intervals.
Which sample decides follows from them: minimum and maximum are the value of one of their operands,
at one sample. From the whole formula down, the earliest such sample is taken, and of several parts
at the same sample the one that is written first.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.interval import RobustnessInterval
from taxinet_ros.core.mtl.lower_bounds.builder import Root
from taxinet_ros.core.mtl.normal_form import window_offsets
from taxinet_ros.core.mtl.offline import Array, robustness
from taxinet_ros.core.mtl.online import Monitor
from taxinet_ros.core.mtl.specs import Spec
from taxinet_ros.core.types import NS_PER_S, time_words

DECIDES = '  <- decides'
"""End of the line of the predicate that decides."""
_LOWER, _UPPER = 0, 1


@dataclass(frozen=True, kw_only=True, slots=True)
class Clause:
    """A part of a formula with its robustness over time.

    Attributes:
        text: the part, as in the formula's text.
        columns: its first and last column there, counted from 1.
        depth: number of operators around it; 0 for the whole formula.
        lower, upper: ends of its interval by sample; NaN at samples where the formula does not
            depend on it.
        row: index of the sample whose interval explains that of the part around it.
        interval: its interval at ``row``; None if the formula does not depend on it there.
        decides: whether the run's robustness is the value of this part at ``row``, or minus it.
        predicate: whether it is a comparison.
    """

    text: str
    columns: tuple[int, int]
    depth: int
    lower: tuple[float, ...] = field(repr=False)
    upper: tuple[float, ...] = field(repr=False)
    row: int
    interval: RobustnessInterval | None
    decides: bool
    predicate: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Explanation:
    """What a formula's robustness on a run comes from.

    Attributes:
        interval: the interval of the run's robustness; exact for a finished run.
        stamps_ns: stamps of the samples [ns].
        clauses: all parts of the formula in the order in which they are written, the whole first.
    """

    interval: RobustnessInterval
    stamps_ns: tuple[int, ...] = field(repr=False)
    clauses: tuple[Clause, ...]

    @property
    def witness(self) -> Clause | None:
        """The predicate that decides; its ``row`` is the sample.

        None if the sign of the robustness is not decided, or rests on no sample at all.
        """
        return next((one for one in self.clauses if one.decides and one.predicate), None)

    @property
    def witness_s(self) -> float:
        """Time of the sample that decides [s]; NaN if there is no witness."""
        found = self.witness
        return math.nan if found is None else self.stamps_ns[found.row] / NS_PER_S

    def lines(self) -> Iterator[str]:
        """One line for each part: its robustness, the time at which, and the part, indented."""
        known = [one.interval.words() if one.interval else 'not needed' for one in self.clauses]
        width = max(map(len, known))
        for one, words in zip(self.clauses, known, strict=True):
            time_s = self.stamps_ns[one.row] / NS_PER_S
            mark = DECIDES if one is self.witness else ''
            yield f'{words:<{width}}  {time_words(time_s, 5)}  {"  " * one.depth}{one.text}{mark}'

    def __str__(self) -> str:
        return '\n'.join(self.lines())


def explain_trace(
    spec: Spec, stamps_ns: Sequence[int], signals: Mapping[str, Sequence[float] | Array]
) -> Explanation:
    """Explain the robustness of a finished trace; see :func:`.offline.robustness`."""
    robustness(spec.formula, stamps_ns, signals)  # checks the trace
    end_ns = int(stamps_ns[-1]) + 1
    monitor = Monitor(spec, end_ns)
    names = ast.signal_names(spec.formula)
    for row, stamp_ns in enumerate(stamps_ns):
        monitor.push(int(stamp_ns), {name: signals[name][row] for name in names})
    monitor.push(end_ns + 1, {})
    return explain(monitor)


def explain(monitor: Monitor, *, over_time: bool = True) -> Explanation:
    """Explain the current interval of a monitor.

    Args:
        monitor: the monitor.
        over_time: whether to list the intervals at all samples; without them it is fast, also
            after many samples.

    Raises:
        UsageError: the monitor has no sample yet.
    """
    roots, stamps = monitor.roots(), monitor.stamps_ns
    whole = _Part(monitor.spec.formula, roots, flipped=False, start=1, depth=0)
    decides = _path(whole, 0, stamps)
    rows = dict(decides)
    clauses: list[Clause] = []

    def add(part: _Part, row: int) -> None:
        if id(part) not in rows:  # beside the path: what decides there
            rows.update({id(part): row} | _path(part, row, stamps))
        row = rows[id(part)]
        here = RobustnessInterval(*(bound(row) for bound in part.ends))
        listed = range(len(stamps) if over_time else 0)
        lower, upper = (tuple(map(bound, listed)) for bound in part.ends)
        clauses.append(Clause(
            text=part.text, columns=(part.start, part.start + len(part.text) - 1),
            depth=part.depth, lower=lower, upper=upper, row=row,
            interval=None if math.isnan(here.lower) else here, decides=id(part) in decides,
            predicate=not part.parts,
        ))
        for inner in part.parts:
            add(inner, row)

    add(whole, 0)
    now = monitor.reading.interval
    return Explanation(interval=now, stamps_ns=stamps, clauses=tuple(clauses))


class _Part:
    """A part of a formula at its place in the text.

    Attributes:
        ends: lower and upper end of its interval by sample.
        flipped: whether an odd number of negations is around it.
    """

    def __init__(
        self, formula: ast.Formula, roots: tuple[Root, Root], *, flipped: bool, start: int,
        depth: int,
    ) -> None:
        self.formula, self.text = formula, str(formula)
        self.flipped, self.start, self.depth = flipped, start, depth
        own, other = reversed(roots) if flipped else roots
        lower, minus_upper = own.bounds_of(formula, False), other.bounds_of(formula, True)
        # Adding 0.0 turns -0.0 into 0.0, as the monitor does.
        self.ends: tuple[Callable[[int], float], Callable[[int], float]] = (
            lambda row: lower(row) + 0.0, lambda row: 0.0 - minus_upper(row),
        )
        self.parts = tuple(
            _Part(
                inner, roots, flipped=flipped != negated, start=start + offset, depth=depth + 1
            )
            for inner, offset, negated in _operands(formula)
        )


def _operands(formula: ast.Formula) -> list[tuple[ast.Formula, int, bool]]:
    """Operands of a formula: each with its offset in the text, and whether it is negated."""
    match formula:
        case ast.Compare():
            return []
        case ast.Not(child):
            return [(child, len('not ('), True)]
        case ast.Temporal(op, interval, child):
            return [(child, len(f'{op}{interval}('), False)]
        case ast.Logic(op, left, right):
            between, negated = f') {op} (', op == 'implies'
        case ast.TemporalPair(op, interval, left, right):
            between, negated = f') {op}{interval} (', False
    return [(left, 1, negated), (right, 1 + len(str(left)) + len(between), False)]


def _path(part: _Part, row: int, stamps: Sequence[int]) -> dict[int, int]:
    """Index of the sample that decides a part at a sample, and each below it, by their identity.

    It ends at a predicate, or where no sample seen so far has the value. It is empty where the sign
    of the part is not decided.
    """
    lower, upper = (bound(row) for bound in part.ends)
    if not (lower > 0 or upper <= 0):
        return {}
    end, value = (_LOWER, lower) if lower > 0 else (_UPPER, upper)
    path = {id(part): row}
    while (found := _deciding(part, stamps, row, end, value)) is not None:
        inner, row = found
        if inner.flipped != part.flipped:
            end, value = 1 - end, -value
        part = inner
        path[id(part)] = row
    return path


def _deciding(
    part: _Part, stamps: Sequence[int], row: int, end: int, value: float
) -> tuple[_Part, int] | None:
    """The operand, and the sample, whose value is that of a part at a sample; None if none."""
    match part.formula:
        case ast.Temporal(op, interval, _):
            inner = part.parts[0]
            rows = _window(stamps, row, interval, past=op in ('historically', 'once'))
            return next(((inner, at) for at in rows if inner.ends[end](at) == value), None)
        case ast.TemporalPair(op, interval, _, _):
            past = op == 'since'
            rows = _window(stamps, row, interval, past=past)
            way = range(row, rows.start - 1, -1) if past else range(row, rows.stop)
            return _of_pair(part, way, rows, end, value)
    for inner in part.parts:
        flipped = inner.flipped != part.flipped
        if inner.ends[end ^ flipped](row) == (-value if flipped else value):
            return inner, row
    return None


def _window(stamps: Sequence[int], row: int, interval: ast.Interval, *, past: bool) -> range:
    """Indices of the samples in the window of a sample."""
    low_ns, high_ns = window_offsets(interval, past)
    return range(
        bisect_left(stamps, stamps[row] + low_ns), bisect_right(stamps, stamps[row] + high_ns)
    )


def _of_pair(
    part: _Part, way: range, rows: range, end: int, value: float
) -> tuple[_Part, int] | None:
    """The operand of until or since, and the sample, that decides at the first of a way."""
    left, right = part.parts
    # The left operand counts at all samples before the one at which the right one does.
    kept = accumulate((left.ends[end](at) for at in way), min, initial=math.inf)
    goals = [
        place for place, (at, guard) in enumerate(zip(way, kept, strict=False))
        if at in rows and min(right.ends[end](at), guard) == value
    ]
    if not goals:
        return None
    found = [(at, 0, left) for at in way[:goals[-1]] if left.ends[end](at) == value]
    found += [(way[at], 1, right) for at in goals if right.ends[end](way[at]) == value]
    if not found:
        return None
    at, _, inner = min(found, key=lambda one: one[:2])
    return inner, at
