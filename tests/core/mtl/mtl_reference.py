"""Brute force, written from the definitions and sharing nothing with the product but the nodes.

``robustness_table`` is the semantics of the package docstring, quadratic or worse. ``rosi`` is the
robust satisfaction interval over all completions (future operators only, predicates unbounded).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from taxinet_ros.core.mtl import ast

INF = math.inf
Pair = tuple[float, float]


def expression(expr: ast.Expr, sample: Mapping[str, float]) -> float:
    match expr:
        case ast.Number(value):
            return value
        case ast.Signal(name):
            return sample[name]
        case ast.Negative(child):
            return -expression(child, sample)
        case ast.Arithmetic(op, left, right):
            a, b = expression(left, sample), expression(right, sample)
            if op == '/':
                return a / b
            return {'+': a + b, '-': a - b, '*': a * b}[op]
        case ast.Function(name, args):
            values = [expression(arg, sample) for arg in args]
            single = {'abs': abs, 'sqrt': math.sqrt}
            return (
                single[name](values[0])
                if name in single
                else {'min': min, 'max': max}[name](values)
            )


def margin(atom: ast.Compare, sample: Mapping[str, float]) -> float:
    left, right = expression(atom.left, sample), expression(atom.right, sample)
    return right - left if atom.op in ('<=', '<') else left - right


def inside(interval: ast.Interval, delta_ns: int) -> bool:
    return interval.low_ns <= delta_ns and (
        interval.high_ns is None or delta_ns <= interval.high_ns
    )


def robustness_table(
    formula: ast.Formula, stamps: Sequence[int], samples: Sequence[Mapping[str, float]]
) -> list[float]:
    """Robustness at every sample."""
    rows = range(len(stamps))

    def table(node: ast.Formula) -> list[float]:
        return robustness_table(node, stamps, samples)

    match formula:
        case ast.Compare():
            return [margin(formula, sample) for sample in samples]
        case ast.Not(child):
            return [-value for value in table(child)]
        case ast.Logic(op, left, right):
            pairs = list(zip(table(left), table(right), strict=True))
            pick = {'and': min, 'or': max, 'implies': lambda p: max(-p[0], p[1])}[op]
            return [pick(pair) for pair in pairs]
        case ast.Temporal(op, interval, child):
            values = table(child)
            sign = -1 if op in ('once', 'historically') else 1
            picked = [
                [values[j] for j in rows if inside(interval, sign * (stamps[j] - stamps[i]))]
                for i in rows
            ]
            if op in ('always', 'historically'):
                return [min(window, default=INF) for window in picked]
            return [max(window, default=-INF) for window in picked]
        case ast.TemporalPair(op, interval, left, right):
            guards, goals = table(left), table(right)
            sign = -1 if op == 'since' else 1
            return [
                max(
                    (
                        min([goals[j], *(guards[k] for k in between(op, i, j))])
                        for j in rows
                        if inside(interval, sign * (stamps[j] - stamps[i]))
                    ),
                    default=-INF,
                )
                for i in rows
            ]


def between(op: str, i: int, j: int) -> range:
    """Samples at which the left operand must hold: [i, j) for until, (j, i] for since."""
    return range(i, j) if op == 'until' else range(j + 1, i + 1)


@dataclass(frozen=True, kw_only=True)
class Prefix:
    """What was seen of a run up to ``now``, which is the stamp of its last sample."""

    stamps: Sequence[int]
    values: Sequence[float]
    horizon: int

    @property
    def rows(self) -> range:
        return range(len(self.stamps))

    @property
    def next(self) -> int:
        """The earliest stamp that a further sample can have."""
        return self.stamps[-1] + 1

    def window(self, interval: ast.Interval, i: int) -> list[int]:
        return [j for j in self.rows if inside(interval, self.stamps[j] - self.stamps[i])]

    def is_open(self, interval: ast.Interval, i: int) -> bool:
        """Whether further samples can fall into the window of sample i."""
        end = INF if interval.high_ns is None else self.stamps[i] + interval.high_ns
        start = max(self.next, self.stamps[i] + interval.low_ns)
        return start <= min(self.horizon, end)


def flip(pair: Pair) -> Pair:
    return -pair[1], -pair[0]


def rosi(formula: ast.Formula, prefix: Prefix) -> tuple[list[Pair], Pair]:
    """Interval at each sample, and at any sample still to come, for predicates on ``cte`` only.

    A completion is any number of samples with integer stamps up to the horizon and any values.
    """
    match formula:
        case ast.Compare():
            margins = [margin(formula, {'cte': value}) for value in prefix.values]
            return [(value, value) for value in margins], (-INF, INF)
        case ast.Not(child):
            seen, later = rosi(child, prefix)
            return [flip(pair) for pair in seen], flip(later)
        case ast.Logic('implies', left, right):
            return rosi(ast.Logic('or', ast.Not(left), right), prefix)
        case ast.Logic(op, left, right):
            pick = min if op == 'and' else max
            (a, a_later), (b, b_later) = rosi(left, prefix), rosi(right, prefix)
            pairs = zip([*a, a_later], [*b, b_later], strict=True)
            joined = [(pick(p[0], q[0]), pick(p[1], q[1])) for p, q in pairs]
            return joined[:-1], joined[-1]
        case ast.Temporal('eventually', interval, child):
            return rosi(ast.Not(ast.Temporal('always', interval, ast.Not(child))), prefix)
        case ast.Temporal('always', interval, child):
            return rosi_always(interval, *rosi(child, prefix), prefix)
        case ast.TemporalPair('until', interval, left, right):
            return rosi_until(interval, rosi(left, prefix), rosi(right, prefix), prefix)
    raise AssertionError(f'no interval for {formula}')


def rosi_always(
    interval: ast.Interval, seen: list[Pair], later: Pair, prefix: Prefix
) -> tuple[list[Pair], Pair]:
    out = []
    for i in prefix.rows:
        window = [seen[j] for j in prefix.window(interval, i)]
        low = min((pair[0] for pair in window), default=INF)
        high = min((pair[1] for pair in window), default=INF)
        # Further samples may be as low as they can, or not come at all.
        out.append((min(low, later[0]) if prefix.is_open(interval, i) else low, high))
    if prefix.next + interval.low_ns > prefix.horizon:
        return out, (INF, INF)
    return out, (later[0], later[1] if interval.low_ns == 0 else INF)


def rosi_until(
    interval: ast.Interval,
    left: tuple[list[Pair], Pair],
    right: tuple[list[Pair], Pair],
    prefix: Prefix,
) -> tuple[list[Pair], Pair]:
    (guard, guard_later), (goal, goal_later) = left, right
    out = []
    for i in prefix.rows:
        low, high = (
            max(
                (
                    min([goal[j][end], *(guard[k][end] for k in range(i, j))])
                    for j in prefix.window(interval, i)
                ),
                default=-INF,
            )
            for end in (0, 1)
        )
        if prefix.is_open(interval, i):
            # The goal may be met at the next sample, after all those that were seen.
            high = max(high, min([goal_later[1], *(guard[k][1] for k in prefix.rows[i:])]))
        out.append((low, high))
    if prefix.next + interval.low_ns > prefix.horizon:
        return out, (-INF, -INF)
    if interval.low_ns == 0:
        return out, goal_later
    return out, (-INF, min(goal_later[1], guard_later[1]))
