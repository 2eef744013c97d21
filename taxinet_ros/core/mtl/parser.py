"""Formula text to formula nodes, by operator precedence.

Loosest to tightest: implies; or; and; until, since, unless, release; not and the unary temporal
operators; comparison; + -; * /; unary minus. This is the precedence of the rtamt library's grammar,
except that a chain of ``implies``, which tools group differently, must be parenthesised. A window
is ``[a:b]`` or ``[a,b]`` in seconds or with a unit (s, ms, us, ns), and its end may be ``inf``.
"""

from __future__ import annotations

import decimal
import math
from collections.abc import Collection, Mapping
from typing import NoReturn, cast

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.hints import hint
from taxinet_ros.core.mtl.lexer import RESERVED, Token, check_parentheses, fail, tokens

MAX_DEPTH = 50
"""Deepest nesting of parentheses and prefix operators."""

_MAX_WINDOW_NS = 10**18
_EXACT = decimal.Context(
    prec=60, traps=[decimal.Inexact, decimal.InvalidOperation, decimal.Overflow]
)
_IMPLIES, _OR, _AND, _UNTIL, _PREFIX, _COMPARE, _SUM, _PRODUCT, _MINUS = range(1, 10)
_POWER = {
    'implies': _IMPLIES, 'or': _OR, 'and': _AND, 'until': _UNTIL, 'since': _UNTIL,
    'unless': _UNTIL, 'release': _UNTIL,
    '<=': _COMPARE, '<': _COMPARE, '>=': _COMPARE, '>': _COMPARE,
    '+': _SUM, '-': _SUM, '*': _PRODUCT, '/': _PRODUCT,
}  # fmt: skip
_UNIT_NS = {'s': 10**9, 'ms': 10**6, 'us': 10**3, 'ns': 1}
_TEMPORAL = frozenset({'always', 'eventually', 'historically', 'once'})
_COMPARISON = "'<=', '<', '>=' or '>'"

_Node = ast.Expr | ast.Formula
_Placed = tuple[_Node, Token]


def parse(
    text: str,
    signals: Collection[str],
    predicates: Mapping[str, str] | None = None,
    where: str = 'formula',
) -> ast.Formula:
    """Parse a formula.

    Args:
        text: e.g. ``eventually[0:10](always(abs(cte) <= 1.5))``.
        signals: names that the formula may read.
        predicates: formulas by name, which the text may use as in VerifAI's ``F[0, 10] G name``.
        where: what the text is, at the head of an error message.

    Raises:
        UsageError: the text is no formula; the message names the column and what was expected.
    """
    named: dict[str, ast.Formula] = {}
    for name, body in (predicates or {}).items():
        if not name.isidentifier() or name in RESERVED or name in signals:
            raise UsageError(f'{where}: predicate {name!r}: choose another, unreserved name')
        named[name] = _Parser(body, signals, {}, f'{where}: predicate {name!r}').whole()
    return _Parser(text, signals, named, where).whole()


class _Parser:
    def __init__(
        self, text: str, signals: Collection[str], named: Mapping[str, ast.Formula], where: str
    ) -> None:
        self._tokens = tokens(text, where)
        self._at = 0
        self._depth = 0
        self._signals = signals
        self._named = named
        self._where = where

    def whole(self) -> ast.Formula:
        check_parentheses(self._tokens, self._where)
        start = self._peek
        node = self._binary(_IMPLIES)
        if self._peek.text == ';':
            self._next()
        if self._peek.kind != 'end' or not _is_formula(node):
            self._expected("'and', 'or' or the end" if _is_formula(node) else _COMPARISON)
        return self._formula(node, start)

    @property
    def _peek(self) -> Token:
        return self._tokens[self._at]

    def _next(self) -> Token:
        token = self._peek
        self._at = min(self._at + 1, len(self._tokens) - 1)
        return token

    def _expected(self, what: str, token: Token | None = None) -> NoReturn:
        token = token or self._peek
        place = self._tokens.index(token)
        before = self._tokens[place - 1] if place else None
        told = hint(token, before, [*self._signals, *self._named])
        self._fail(token, f'expected {what}, got {token}{told}')

    def _take(self, text: str) -> None:
        if self._peek.text != text:
            self._expected(repr(text))
        self._next()

    def _formula(self, node: _Node, start: Token) -> ast.Formula:
        if not _is_formula(node):
            self._fail(start, f'expected a formula such as cte <= 1.5, got the number {node}')
        return cast(ast.Formula, node)

    def _expr(self, node: _Node, start: Token) -> ast.Expr:
        if _is_formula(node):
            self._fail(start, f'expected a number or signal, got the formula {node}')
        return cast(ast.Expr, node)

    def _fail(self, token: Token, message: str) -> NoReturn:
        fail(self._where, token.column, message)

    def _binary(self, least: int) -> _Node:
        start = self._peek
        node = self._prefix()
        done = ''
        while (power := _POWER.get(self._peek.text, 0)) >= least:
            op = self._peek
            self._refuse_chain(op, done, node)
            self._next()
            interval = self._interval() if power == _UNTIL else ast.Interval()
            right_start = self._peek
            right = self._binary(power + 1)
            node = self._joined(op, interval, (node, start), (right, right_start))
            done = op.text
        if self._peek.text in ('=', '==', '!=', '≠', '^', '**') and not _is_formula(node):
            self._expected(_COMPARISON)
        return node

    def _refuse_chain(self, op: Token, done: str, left: _Node) -> None:
        if op.text == done == 'implies':
            self._fail(op, "expected parentheses in a chain of 'implies': a implies (b implies c)")
        if _POWER[op.text] == _COMPARE and isinstance(left, ast.Compare):
            middle = f'{left} and {left.right} {op.text} ...'
            self._fail(op, f"expected 'and', got {op}; write it as two: {middle}")
        if op.raw == '=>' and not _is_formula(left):
            self._expected(_COMPARISON, op)

    def _joined(self, op: Token, interval: ast.Interval, left: _Placed, right: _Placed) -> _Node:
        power = _POWER[op.text]
        if power >= _COMPARE:
            low, high = self._expr(*left), self._expr(*right)
            if power == _COMPARE:
                return ast.Compare(cast(ast.CompareOp, op.text), low, high)
            return ast.Arithmetic(cast(ast.ArithmeticOp, op.text), low, high)
        first, second = self._formula(*left), self._formula(*right)
        if power == _UNTIL:
            return _pair(op.text, interval, first, second)
        return ast.Logic(cast(ast.LogicOp, op.text), first, second)

    def _prefix(self) -> _Node:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            self._fail(self._peek, f'expected at most {MAX_DEPTH} nested parentheses')
        node = self._one(self._next())
        self._depth -= 1
        return node

    def _one(self, token: Token) -> _Node:
        if token.kind == 'number':
            return self._number(token)
        if token.kind == 'name':
            return self._name(token)
        if token.text == '(':
            inner = self._binary(_IMPLIES)
            self._take(')')
            return inner
        if token.text == '-':
            start = self._peek
            return ast.Negative(self._expr(self._binary(_MINUS), start))
        if token.text in ast.FUNCTION_ARITY:
            return self._function(token)
        if token.text == 'not':
            return ast.Not(self._operand())
        if token.text not in _TEMPORAL:
            self._expected("a signal, number, operator or '('", token)
        word = cast(ast.UnaryTemporalOp, token.text)
        return ast.Temporal(word, self._interval(), self._operand())

    def _operand(self) -> ast.Formula:
        start = self._peek
        return self._formula(self._binary(_PREFIX), start)

    def _number(self, token: Token) -> ast.Number:
        value = float(token.text)
        if not math.isfinite(value):
            self._expected('a finite number', token)
        return ast.Number(value)

    def _name(self, token: Token) -> _Node:
        if token.text in self._named:
            return self._named[token.text]
        if token.text not in self._signals:
            known = [*self._signals, *self._named]
            told = hint(token, None, known)
            listed = ', '.join(known)
            self._fail(token, f'expected a signal, got unknown {token}{told}; known: {listed}')
        return ast.Signal(token.text)

    def _function(self, token: Token) -> ast.Function:
        name = cast(ast.FunctionName, token.text)
        if self._peek.text != '(':
            self._expected(f"'(' after {name}")
        self._next()
        args = [self._argument()]
        while self._peek.text == ',':
            self._next()
            args.append(self._argument())
        self._take(')')
        least, most = ast.FUNCTION_ARITY[name]
        if len(args) < least or len(args) > (most or len(args)):
            needs = f'{least} argument' if most else f'at least {least} arguments'
            self._fail(token, f'expected {needs} of {name}, got {len(args)}')
        return ast.Function(name, tuple(args))

    def _argument(self) -> ast.Expr:
        start = self._peek
        return self._expr(self._binary(_SUM), start)

    def _interval(self) -> ast.Interval:
        if self._peek.text != '[':
            return ast.Interval()
        start = self._at
        self._next()
        low_token = self._peek
        low_ns = self._bound()
        if self._peek.text not in (':', ','):
            self._expected("':' or ','")
        self._next()
        high_ns = None
        if self._peek.text == 'inf':
            self._next()
        else:
            high_ns = self._bound()
        if self._peek.kind in ('name', 'word'):
            self._expected(f"']' or a unit ({', '.join(_UNIT_NS)})")
        self._take(']')
        if high_ns is not None and low_ns > high_ns:
            seen = ''.join(t.raw for t in self._tokens[start : self._at])
            self._fail(low_token, f'expected a window [a:b] with a <= b, got {seen}')
        return ast.Interval(low_ns, high_ns)

    def _bound(self) -> int:
        token = self._next()
        if token.text == '-':
            self._fail(token, "expected 0 seconds or more; 'once' and 'historically' look back")
        if token.kind != 'number':
            self._expected('a number of seconds', token)
        unit = self._next().text if self._peek.text in _UNIT_NS else 's'
        try:
            # Exact, so that 0.1 is 100 ms to the nanosecond and nothing is rounded silently.
            time_ns = _EXACT.multiply(_EXACT.create_decimal(token.text), _UNIT_NS[unit])
            whole_ns = _EXACT.to_integral_exact(time_ns)
        except decimal.DecimalException:
            seen = f'{token.text:.40} {unit}'
            self._fail(token, f'expected a whole number of nanoseconds, got {seen}')
        if whole_ns > _MAX_WINDOW_NS:
            self._fail(token, f"expected at most {_MAX_WINDOW_NS // 10**9} s, or 'inf'")
        return int(whole_ns)


def _pair(
    word: str, interval: ast.Interval, left: ast.Formula, right: ast.Formula
) -> ast.Formula:
    """Until and since are nodes; unless (weak until) and release are said with until."""
    if word == 'unless':
        lasting = ast.Temporal('always', ast.Interval(0, interval.high_ns), left)
        return ast.Logic('or', ast.TemporalPair('until', interval, left, right), lasting)
    if word == 'release':
        neither = ast.TemporalPair('until', interval, ast.Not(left), ast.Not(right))
        return ast.Not(neither)
    return ast.TemporalPair(cast(ast.BinaryTemporalOp, word), interval, left, right)


def _is_formula(node: _Node) -> bool:
    return isinstance(node, ast.Formula)
