"""Margins of predicates: the signed distance by which a comparison holds.

A comparison is compiled to Python once, for single samples or for whole columns. Both come from the
same text and do the same IEEE operations in the same order, so online and offline evaluation agree
bit for bit.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from taxinet_ros.core.mtl import ast

Values = Sequence[float]
"""Signal values at one sample, in the order of the names passed at compilation."""

Column = npt.NDArray[np.float64]


class Margins:
    """Margins of a formula's predicates at each sample of a growing trace.

    Args:
        formula: the formula.
        names: signals that it reads, in the order of the values of a sample.
    """

    __slots__ = ('_appends', '_columns', '_evaluators')

    def __init__(self, formula: ast.Formula, names: tuple[str, ...]) -> None:
        atoms = ast.atoms(formula)
        self._evaluators = [_compile_sample(atom, names) for atom in atoms]
        self._columns: dict[ast.Compare, tuple[list[float], list[float]]]
        self._columns = {atom: ([], []) for atom in atoms}
        self._appends = [
            (plain.append, negated.append) for plain, negated in self._columns.values()
        ]

    def of(self, values: Values) -> list[float]:
        """Margin of each predicate at a sample; NaN or infinite where undefined."""
        try:
            return [evaluate(values) for evaluate in self._evaluators]
        except (ZeroDivisionError, ValueError):
            return [math.nan]

    def append(self, margins: list[float]) -> None:
        """Append the margins of the next sample, as returned by :meth:`of`."""
        for at, (append, append_negated) in enumerate(self._appends):
            append(margins[at])
            append_negated(-margins[at])

    def column(self, atom: ast.Compare, negated: bool) -> Sequence[float]:
        """Margins of a predicate, or minus them; the sequence grows with the trace."""
        return self._columns[atom][negated]


def compile_margin(atom: ast.Compare, names: Sequence[str]) -> Callable[[Values], float]:
    """Compile an atom's margin: right - left for ``<=`` and ``<``, else left - right.

    The result is NaN or infinite where the expression has no finite value (division by zero, root
    of a negative number, overflow); the caller must reject such a sample.
    """
    evaluate = _compile_sample(atom, tuple(names))

    def margin(values: Values) -> float:
        try:
            return evaluate(values)
        except (ZeroDivisionError, ValueError):
            return math.nan

    return margin


@functools.lru_cache
def _compile_sample(atom: ast.Compare, names: tuple[str, ...]) -> Callable[[Values], float]:
    """Like :func:`compile_margin`, but may raise ZeroDivisionError or ValueError if undefined."""
    words = {'abs': abs, 'sqrt': math.sqrt, 'min': _least, 'max': _greatest}
    margin: Callable[[Values], float] = _compile(atom, names, words)
    return margin


@functools.lru_cache
def _compile_column(
    atom: ast.Compare, names: tuple[str, ...]
) -> Callable[[Sequence[Column]], Column]:
    words = {'abs': np.abs, 'sqrt': np.sqrt, 'min': _least_of, 'max': _greatest_of}
    margins: Callable[[Sequence[Column]], Column] = _compile(atom, names, words)
    return margins


def margin_column(
    atom: ast.Compare, names: tuple[str, ...], columns: Sequence[Column], count: int
) -> Column:
    """Compute the margins of an atom at all samples of a trace.

    Args:
        atom: the predicate.
        names: signals that it may read.
        columns: (count,) finite values of each.
        count: number of samples, > 0.

    Returns:
        (count,) margins; NaN or infinite where there is no finite value.
    """
    try:
        # An exception means that there is no finite value at some sample.
        with np.errstate(divide='raise', invalid='raise', over='ignore', under='ignore'):
            margins = _compile_column(atom, names)(columns)
        return margins if np.ndim(margins) else np.full(count, margins)
    except (FloatingPointError, ZeroDivisionError):
        margin = compile_margin(atom, names)
        rows = np.transpose(columns).tolist() if columns else [[]] * count
        return np.array([margin(row) for row in rows])


def _compile(atom: ast.Compare, names: Sequence[str], words: Mapping[str, Any]) -> Any:
    small, large = (atom.left, atom.right) if atom.op in ('<=', '<') else (atom.right, atom.left)
    # Safe: nodes contain only numbers, operators and the function names of ``words``.
    text = f'lambda v: {_python(large, names)} - {_closed(small, names)}'
    return eval(text, {'__builtins__': {}, **words})


def _python(expr: ast.Expr, names: Sequence[str]) -> str:
    match expr:
        case ast.Number(value):
            return repr(float(value))
        case ast.Signal(name):
            return f'v[{names.index(name)}]'
        case ast.Negative(child):
            return f'-{_closed(child, names)}'
        case ast.Arithmetic(op, left, right):
            # Python is left-associative too, so a long sum needs no parentheses (Python allows at
            # most 200 nested ones).
            sum_in_product = op in '*/' and isinstance(left, ast.Arithmetic) and left.op in '+-'
            first = (_closed if sum_in_product else _python)(left, names)
            return f'{first} {op} {_closed(right, names)}'
        case ast.Function(name, args):
            return f'{name}({", ".join(_python(arg, names) for arg in args)})'


def _closed(expr: ast.Expr, names: Sequence[str]) -> str:
    compound = isinstance(expr, ast.Negative | ast.Arithmetic)
    return f'({_python(expr, names)})' if compound else _python(expr, names)


def _least(*args: float) -> float:
    # Whether min and max keep a NaN depends on the argument order; it must always propagate.
    return math.nan if any(map(math.isnan, args)) else min(args)


def _greatest(*args: float) -> float:
    return math.nan if any(map(math.isnan, args)) else max(args)


def _least_of(*columns: Column) -> Column:
    return functools.reduce(np.minimum, columns)


def _greatest_of(*columns: Column) -> Column:
    return functools.reduce(np.maximum, columns)
