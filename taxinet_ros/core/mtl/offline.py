"""Robustness of a finished trace."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.margin import compile_margin
from taxinet_ros.core.mtl.normal import (
    Core,
    CoreAtom,
    CoreChain,
    CoreJoin,
    CoreShift,
    CoreWindow,
    normalise,
)
from taxinet_ros.core.mtl.window import INF, empty_value, slide

Array = npt.NDArray[Any]


def robustness(
    formula: ast.Formula,
    stamps_ns: Sequence[int] | Array,
    signals: Mapping[str, Sequence[float] | Array],
) -> float:
    """Robustness of a formula at the first sample of a trace; near-linear in its length.

    Args:
        formula: the formula.
        stamps_ns: (n,) integer nanoseconds since the start of the run, strictly increasing.
        signals: (n,) values of each signal that the formula reads; others are ignored.

    Returns:
        rho; +-inf where the answer rests on an empty window. Never NaN.

    Raises:
        UsageError: no samples, a stamp that is negative, repeated, backward or not an integer, a
            signal missing, of another length or not finite, or a predicate without finite value.
    """
    stamps = _checked_stamps(stamps_ns)
    names = ast.signal_names(formula)
    columns = [_checked_signal(name, signals, len(stamps)) for name in names]
    rows = list(zip(*columns, strict=True)) if columns else [()] * len(stamps)
    margins = {atom: _margins(atom, names, rows) for atom in ast.atoms(formula)}
    # Adding zero turns -0.0 into 0.0, the sign of which would depend on the order of evaluation.
    return _evaluate(normalise(formula), stamps, margins)[0] + 0.0


def _checked_stamps(stamps_ns: Sequence[int] | Array) -> list[int]:
    array = np.asarray(stamps_ns)
    if array.ndim != 1 or array.size == 0:
        raise UsageError(
            f'trace: no samples: stamps have shape {array.shape}, need (n,) with n > 0'
        )
    if array.dtype.kind not in 'iu':
        raise UsageError(f'trace: stamps are {array.dtype}, need integer nanoseconds')
    stamps: list[int] = array.tolist()
    if stamps[0] < 0:
        raise UsageError(f'trace: first stamp is {stamps[0]} ns, before the start of the run')
    for index, (before, after) in enumerate(itertools.pairwise(stamps), start=1):
        if after <= before:
            word = 'repeats' if after == before else 'goes back'
            raise UsageError(f'trace: stamp {word} at sample {index}: {before} then {after} ns')
    return stamps


def _checked_signal(
    name: str, signals: Mapping[str, Sequence[float] | Array], count: int
) -> list[float]:
    if name not in signals:
        raise UsageError(f'trace: signal {name!r} is missing; present: {", ".join(signals)}')
    array = np.asarray(signals[name], dtype=np.float64)
    if array.shape != (count,):
        raise UsageError(f'trace: signal {name!r} has shape {array.shape}, stamps have ({count},)')
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise UsageError(f'trace: signal {name!r} is {array[bad[0]]} at sample {bad[0]}')
    values: list[float] = array.tolist()
    return values


def _margins(
    atom: ast.Compare, names: Sequence[str], rows: Sequence[Sequence[float]]
) -> list[float]:
    margin = compile_margin(atom, names)
    values = [margin(row) for row in rows]
    for index, value in enumerate(values):
        if not math.isfinite(value):
            raise UsageError(f'trace: {atom} has margin {value} at sample {index}')
    return values


def _evaluate(
    core: Core, stamps: list[int], margins: Mapping[ast.Compare, list[float]]
) -> list[float]:
    match core:
        case CoreAtom(atom, negated):
            return [-value for value in margins[atom]] if negated else margins[atom]
        case CoreJoin(lowest, children):
            columns = [_evaluate(child, stamps, margins) for child in children]
            return list(map(min if lowest else max, *columns))
        case CoreWindow(lowest, past, interval, child):
            low, high = offsets(interval, past)
            values = _evaluate(child, stamps, margins)
            return slide(stamps, values, range(len(stamps)), low, high, lowest)
        case CoreChain(lowest, past, _, left, right):
            guards = None if left is None else _evaluate(left, stamps, margins)
            return _chain(lowest, past, guards, _evaluate(right, stamps, margins))
        case CoreShift(lowest, past, delay, child):
            return _shift(lowest, past, delay, stamps, _evaluate(child, stamps, margins))


def offsets(interval: ast.Interval, past: bool) -> tuple[float, float]:
    """Bounds of a window relative to the sample [ns]: ints, or +-inf where it is unbounded."""
    high = INF if interval.high_ns is None else interval.high_ns
    return (-high, -interval.low_ns) if past else (interval.low_ns, high)


def _chain(lowest: bool, past: bool, left: list[float] | None, right: list[float]) -> list[float]:
    own, other = (min, max) if lowest else (max, min)
    acc = empty_value(lowest)
    out = [acc] * len(right)
    for row in range(len(right)) if past else reversed(range(len(right))):
        acc = own(right[row], acc if left is None else other(left[row], acc))
        out[row] = acc
    return out


def _shift(
    lowest: bool, past: bool, delay: int, stamps: list[int], values: list[float]
) -> list[float]:
    if past:
        sources = [bisect_right(stamps, stamp - delay) - 1 for stamp in stamps]
    else:
        sources = [bisect_left(stamps, stamp + delay) for stamp in stamps]
    nothing = empty_value(lowest)
    return [values[row] if 0 <= row < len(values) else nothing for row in sources]
