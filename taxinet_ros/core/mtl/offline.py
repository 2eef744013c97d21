"""Robustness of a finished trace."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.margin import Column, margin_column
from taxinet_ros.core.mtl.normal_form import (
    Core,
    CoreAtom,
    CoreChain,
    CoreJoin,
    CoreShift,
    CoreWindow,
    normalise,
    window_offsets,
)
from taxinet_ros.core.mtl.sliding import INF, empty_value, slide
from taxinet_ros.errors import UsageError

Array = npt.NDArray[Any]
Stamps = npt.NDArray[np.int64]

_TOO_LATE_NS = 2**62
"""Upper limit of stamps: a stamp plus the longest window must not overflow."""


def robustness(
    formula: ast.Formula,
    stamps_ns: Sequence[int] | Array,
    signals: Mapping[str, Sequence[float] | Array],
) -> float:
    """Robustness of a formula at the first sample of a trace; linear in its length.

    Args:
        formula: the formula.
        stamps_ns: (n,) integer nanoseconds since the start of the run, strictly increasing.
        signals: (n,) values of each signal that the formula reads; others are ignored.

    Returns:
        rho; +-inf if it results from an empty window. Never NaN.

    Raises:
        UsageError: no samples; a stamp that is negative, repeated, decreasing or not an integer; a
            signal that is missing, has another length or is not finite; a predicate that is not
            finite.
    """
    stamps = _checked_stamps(stamps_ns)
    names, atoms, core = _prepare(formula)
    columns = [_checked_signal(name, signals, len(stamps)) for name in names]
    margins = {atom: _margins(atom, names, columns, len(stamps)) for atom in atoms}
    rho = _Evaluator(
        stamps, lambda atom, negated: -margins[atom] if negated else margins[atom]
    ).at_first(core)
    # Adding 0.0 turns -0.0 into 0.0: the sign would depend on the order of evaluation.
    return rho + 0.0


def robustness_range(
    formula: ast.Formula, stamps_ns: Sequence[int] | Array,
    margins: Mapping[ast.Compare, tuple[float, float]],
) -> tuple[float, float]:
    """Minimum and maximum robustness of any trace with these stamps.

    Args:
        formula: the formula.
        stamps_ns: as for :func:`robustness`.
        margins: minimum and maximum margin of each predicate. Predicates are assumed independent,
            so the range may be wider than what traces reach, never narrower.

    Returns:
        Minimum and maximum; both are +inf, or both -inf, if rho depends on no sample.
    """
    stamps = _checked_stamps(stamps_ns)

    def lowest(atom: ast.Compare, negated: bool) -> Column:
        low, high = margins[atom]
        return np.full(len(stamps), -high if negated else low)

    lower = _Evaluator(stamps, lowest).at_first(normalise(formula))
    upper = -_Evaluator(stamps, lowest).at_first(normalise(formula, negated=True))
    return lower + 0.0, upper + 0.0


@functools.lru_cache
def _prepare(formula: ast.Formula) -> tuple[tuple[str, ...], tuple[ast.Compare, ...], Core]:
    """Parts of an evaluation that do not depend on the trace: signals, predicates, core form."""
    return ast.signal_names(formula), ast.atoms(formula), normalise(formula)


def _checked_stamps(stamps_ns: Sequence[int] | Array) -> Stamps:
    array = np.asarray(stamps_ns)
    if array.ndim != 1 or array.size == 0:
        raise UsageError(
            f'trace: no samples: stamps have shape {array.shape}, need (n,) with n > 0'
        )
    if array.dtype.kind not in 'iu':
        raise UsageError(f'trace: stamps are {array.dtype}, need integer nanoseconds')
    stamps = array.astype(np.int64, copy=False)
    if stamps[-1] >= _TOO_LATE_NS:
        raise UsageError(f'trace: last stamp is {stamps[-1]} ns, needs to be below 2**62')
    if stamps[0] < 0:
        raise UsageError(f'trace: first stamp is {stamps[0]} ns, before the start of the run')
    wrong = stamps[1:] <= stamps[:-1]
    if wrong.any():
        at = wrong.argmax()
        before, after = stamps[at], stamps[at + 1]
        word = 'repeats' if after == before else 'goes back'
        raise UsageError(f'trace: stamp {word} at sample {at + 1}: {before} then {after} ns')
    return stamps


def _checked_signal(
    name: str, signals: Mapping[str, Sequence[float] | Array], count: int
) -> Column:
    if name not in signals:
        raise UsageError(f'trace: signal {name!r} is missing; present: {", ".join(signals)}')
    array = np.asarray(signals[name], dtype=np.float64)
    if array.shape != (count,):
        raise UsageError(f'trace: signal {name!r} has shape {array.shape}, stamps have ({count},)')
    finite = np.isfinite(array)
    if not finite.all():
        at = finite.argmin()
        raise UsageError(f'trace: signal {name!r} is {array[at]} at sample {at}')
    return array


def _margins(
    atom: ast.Compare, names: tuple[str, ...], columns: Sequence[Column], count: int
) -> Column:
    values = margin_column(atom, names, columns, count)
    finite = np.isfinite(values)
    if not finite.all():
        at = finite.argmin()
        raise UsageError(f'trace: {atom} has margin {values[at]} at sample {at}')
    return values


class _Evaluator:
    """Evaluates core formulas on one trace."""

    def __init__(self, stamps: Stamps, margins: Callable[[ast.Compare, bool], Column]) -> None:
        self._stamps = stamps
        self._margins = margins
        self._done: dict[int, Column] = {}

    def at_first(self, core: Core) -> float:
        """Value at the first sample only; skips the windows of all others."""
        if isinstance(core, CoreJoin):
            return (min if core.lowest else max)(map(self.at_first, core.children))
        if not isinstance(core, CoreWindow) or core.past:
            return float(self._values(core)[0])
        low, high = window_offsets(core.interval, past=False)
        first = self._stamps[0]
        start = self._stamps.searchsorted(first + low, 'left')
        stop = len(self._stamps)
        if high != INF:
            stop = self._stamps.searchsorted(first + high, 'right')
        if start >= stop:
            return empty_value(core.lowest)
        window = self._values(core.child)[start:stop]
        return float(window.min() if core.lowest else window.max())

    def _values(self, core: Core) -> Column:
        """Values at all samples; shared subformulas are evaluated once."""
        if id(core) not in self._done:
            self._done[id(core)] = self._evaluated(core)
        return self._done[id(core)]

    def _evaluated(self, core: Core) -> Column:
        match core:
            case CoreAtom(atom, negated):
                return self._margins(atom, negated)
            case CoreJoin(lowest, children):
                first, *others = map(self._values, children)
                for other in others:
                    first = _extreme(lowest)(first, other)
                return first
            case CoreWindow():
                return self._window(core)
            case CoreChain(lowest, past, _, left, right):
                if left is None:
                    return _running(lowest, past, self._values(right))
                return _chain(lowest, past, self._values(left), self._values(right))
            case CoreShift():
                return self._shift(core)

    def _window(self, core: CoreWindow) -> Column:
        low, high = window_offsets(core.interval, core.past)
        values = self._values(core.child)
        if (low, high) == (0, INF):
            return _running(core.lowest, core.past, values)
        stamps = self._stamps.tolist()
        rows = range(len(stamps))
        return np.array(slide(stamps, values.tolist(), rows, low, high, core.lowest))

    def _shift(self, core: CoreShift) -> Column:
        stamps, values = self._stamps, self._values(core.child)
        if core.past:
            sources = stamps.searchsorted(stamps - core.delay_ns, 'right') - 1
        else:
            sources = stamps.searchsorted(stamps + core.delay_ns, 'left')
        # Absent samples have index n or -1; both select the appended value.
        return np.append(values, empty_value(core.lowest))[sources]


def _extreme(lowest: bool) -> np.ufunc:
    return np.minimum if lowest else np.maximum


def _running(lowest: bool, past: bool, values: Column) -> Column:
    """Extreme of all values up to each sample (past), or from it on."""
    if past:
        return _extreme(lowest).accumulate(values)
    return _extreme(lowest).accumulate(values[::-1])[::-1]


def _chain(lowest: bool, past: bool, left: Column, right: Column) -> Column:
    own, other = (min, max) if lowest else (max, min)
    guards, goals = left.tolist(), right.tolist()
    acc = empty_value(lowest)
    out = [acc] * len(goals)
    for row in range(len(goals)) if past else reversed(range(len(goals))):
        acc = own(goals[row], other(guards[row], acc))
        out[row] = acc
    return np.array(out)
