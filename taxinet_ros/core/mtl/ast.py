"""Nodes of the formula syntax tree, and their text form.

Nodes are frozen, hashable and compare by structure. They take positional arguments because a tree
of keyword arguments is unreadable. Every operand of a logical or temporal operator is printed in
parentheses, so the text does not depend on precedence; it parses back to an equal tree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError

ArithmeticOp = Literal['+', '-', '*', '/']
FunctionName = Literal['abs', 'min', 'max', 'sqrt']
CompareOp = Literal['<=', '<', '>=', '>']
LogicOp = Literal['and', 'or', 'implies']
UnaryTemporalOp = Literal['always', 'eventually', 'historically', 'once']
BinaryTemporalOp = Literal['until', 'since']

FUNCTION_ARITY: dict[FunctionName, tuple[int, int | None]] = {
    'abs': (1, 1),
    'sqrt': (1, 1),
    'min': (2, None),
    'max': (2, None),
}
"""Minimum and maximum number of arguments of each function (None: unlimited)."""


@dataclass(frozen=True, slots=True)
class Number:
    """A constant, finite and not negative; a minus sign is a :class:`Negative` around it."""

    value: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.value) and math.copysign(1.0, self.value) > 0):
            raise UsageError(f'formula: number is {self.value}, needs to be finite and >= 0')

    def __str__(self) -> str:
        return repr(float(self.value)).removesuffix('.0')


@dataclass(frozen=True, slots=True)
class Signal:
    """The value of a named signal at the sample."""

    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Negative:
    """Minus an expression."""

    child: Expr

    def __str__(self) -> str:
        return f'-{_factor(self.child)}'


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """Sum, difference, product or quotient of two expressions (IEEE double precision)."""

    op: ArithmeticOp
    left: Expr
    right: Expr

    def __str__(self) -> str:
        return f'{_factor(self.left)} {self.op} {_factor(self.right)}'


@dataclass(frozen=True, slots=True)
class Function:
    """A function of expressions; the arity is in :data:`FUNCTION_ARITY`."""

    name: FunctionName
    args: tuple[Expr, ...]

    def __post_init__(self) -> None:
        least, most = FUNCTION_ARITY[self.name]
        if len(self.args) < least or (most is not None and len(self.args) > most):
            needs = f'{least}' if most == least else f'at least {least}'
            raise UsageError(f'formula: {self.name} takes {needs} arguments, not {len(self.args)}')

    def __str__(self) -> str:
        return f'{self.name}({", ".join(map(str, self.args))})'


Expr = Number | Signal | Negative | Arithmetic | Function


@dataclass(frozen=True, slots=True)
class Interval:
    """A closed time window [low_ns, high_ns] relative to the sample; high None is unbounded."""

    low_ns: int = 0
    high_ns: int | None = None

    def __post_init__(self) -> None:
        if self.low_ns < 0 or (self.high_ns is not None and self.high_ns < self.low_ns):
            raise UsageError(f'formula: window {self} needs 0 <= start <= end')

    def __str__(self) -> str:
        if self == Interval():
            return ''
        high = 'inf' if self.high_ns is None else _seconds(self.high_ns)
        return f'[{_seconds(self.low_ns)}:{high}]'


@dataclass(frozen=True, slots=True)
class Compare:
    """A predicate on expressions. Strict and non-strict forms have the same robustness."""

    op: CompareOp
    left: Expr
    right: Expr

    def __str__(self) -> str:
        return f'{self.left} {self.op} {self.right}'


@dataclass(frozen=True, slots=True)
class Not:
    """Negation."""

    child: Formula

    def __str__(self) -> str:
        return f'not ({self.child})'


@dataclass(frozen=True, slots=True)
class Logic:
    """Conjunction, disjunction or implication."""

    op: LogicOp
    left: Formula
    right: Formula

    def __str__(self) -> str:
        return f'({self.left}) {self.op} ({self.right})'


@dataclass(frozen=True, slots=True)
class Temporal:
    """Unary temporal operator: always, eventually (future); historically, once (past)."""

    op: UnaryTemporalOp
    interval: Interval
    child: Formula

    def __str__(self) -> str:
        return f'{self.op}{self.interval}({self.child})'


@dataclass(frozen=True, slots=True)
class TemporalPair:
    """Binary temporal operator: ``left until right`` (future), ``left since right`` (past)."""

    op: BinaryTemporalOp
    interval: Interval
    left: Formula
    right: Formula

    def __str__(self) -> str:
        return f'({self.left}) {self.op}{self.interval} ({self.right})'


Formula = Compare | Not | Logic | Temporal | TemporalPair


def atoms(formula: Formula) -> tuple[Compare, ...]:
    """Distinct predicates of a formula, in order of appearance."""
    found: dict[Compare, None] = {}

    def visit(node: Formula) -> None:
        match node:
            case Compare():
                found[node] = None
            case Not(child) | Temporal(_, _, child):
                visit(child)
            case Logic(_, left, right) | TemporalPair(_, _, left, right):
                visit(left)
                visit(right)

    visit(formula)
    return tuple(found)


def size(formula: Formula) -> int:
    """Number of formula nodes when written out; expression nodes are not counted.

    Shared subtrees, such as the left side of an ``unless``, cost no extra time.
    """
    done: dict[int, int] = {}

    def visit(node: Formula) -> int:
        if id(node) not in done:
            match node:
                case Compare():
                    below = 0
                case Not(child) | Temporal(_, _, child):
                    below = visit(child)
                case Logic(_, left, right) | TemporalPair(_, _, left, right):
                    below = visit(left) + visit(right)
            done[id(node)] = below + 1
        return done[id(node)]

    return visit(formula)


def signal_names(formula: Formula) -> tuple[str, ...]:
    """Names of the signals that a formula reads, sorted."""
    names: set[str] = set()

    def visit(node: Expr) -> None:
        match node:
            case Signal(name):
                names.add(name)
            case Negative(child):
                visit(child)
            case Arithmetic(_, left, right):
                visit(left)
                visit(right)
            case Function(_, args):
                for arg in args:
                    visit(arg)

    for atom in atoms(formula):
        visit(atom.left)
        visit(atom.right)
    return tuple(sorted(names))


def _factor(expr: Expr) -> str:
    compound = isinstance(expr, Negative | Arithmetic)
    return f'({expr})' if compound else str(expr)


def _seconds(time_ns: int) -> str:
    whole, rest = divmod(time_ns, NS_PER_S)
    return f'{whole}.{rest:09d}'.rstrip('0') if rest else str(whole)
