"""Values of predicates: the signed margin by which a comparison holds, at one sample."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from taxinet_ros.core.mtl import ast

Values = Sequence[float]
"""Signal values at one sample, in the order of the names that the margin was compiled with."""

_Evaluator = Callable[[Values], float]


def compile_margin(atom: ast.Compare, names: Sequence[str]) -> _Evaluator:
    """A function that gives an atom's margin: right - left for ``<=`` and ``<``, else left - right.

    The offline and the online monitor both use it, so they agree to the last bit. The result is
    NaN or infinite where the expression has no finite value (division by zero, the root of a
    negative number, overflow); the caller must refuse such a sample.
    """
    small, large = (atom.left, atom.right) if atom.op in ('<=', '<') else (atom.right, atom.left)
    low, high = _compile(small, names), _compile(large, names)

    def margin(values: Values) -> float:
        try:
            return high(values) - low(values)
        except (ZeroDivisionError, ValueError):
            return math.nan

    return margin


def _compile(expr: ast.Expr, names: Sequence[str]) -> _Evaluator:
    match expr:
        case ast.Number(value):
            return lambda _: value
        case ast.Signal(name):
            index = names.index(name)
            return lambda values: values[index]
        case ast.Negative(child):
            inner = _compile(child, names)
            return lambda values: -inner(values)
        case ast.Arithmetic(op, left, right):
            return _arithmetic(op, _compile(left, names), _compile(right, names))
        case ast.Function(name, args):
            return _function(name, [_compile(arg, names) for arg in args])


def _arithmetic(op: ast.ArithmeticOp, left: _Evaluator, right: _Evaluator) -> _Evaluator:
    match op:
        case '+':
            return lambda values: left(values) + right(values)
        case '-':
            return lambda values: left(values) - right(values)
        case '*':
            return lambda values: left(values) * right(values)
        case '/':
            return lambda values: left(values) / right(values)


def _function(name: ast.FunctionName, args: list[_Evaluator]) -> _Evaluator:
    first = args[0]
    match name:
        case 'abs':
            return lambda values: abs(first(values))
        case 'sqrt':
            return lambda values: math.sqrt(first(values))
        case 'min':
            return lambda values: _extreme(min, args, values)
        case 'max':
            return lambda values: _extreme(max, args, values)


def _extreme(pick: Callable[..., float], args: list[_Evaluator], values: Values) -> float:
    results = [arg(values) for arg in args]
    # min and max drop a NaN or keep it, depending on the order; it must always come through.
    return math.nan if any(map(math.isnan, results)) else pick(results)
