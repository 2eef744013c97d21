"""Formula parser (operator precedence), with hints for likely mistakes."""

from __future__ import annotations

import decimal
import difflib
import functools
import math
import re
from collections.abc import Collection, Mapping
from typing import NamedTuple, NoReturn, cast

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.lexer import (
    MAX_TOKENS,
    RESERVED,
    WORDS,
    Token,
    check_parentheses,
    fail,
    tokens,
)
from taxinet_ros.core.mtl.margin import compile_margin
from taxinet_ros.core.units import (
    MEANT,
    PURE,
    UNITS,
    Quantity,
    added,
    dimension_of,
    in_si,
    kind_words,
    multiplied,
    rooted,
)
from taxinet_ros.errors import UsageError

_NO_STEP = 'samples have stamps and no fixed step: write a window, such as once[0.1:0.1]'
_SAYS = {
    '|': 'for an absolute value write abs(...)',
    '^': 'for a power write cte * cte',
    '**': 'for a power write cte * cte',
    '=': 'a comparison is one of <=, <, >=, > without a space in it',
    '==': 'two numbers are hardly ever equal: write abs(cte - 1) <= 0.01',
    '=>': 'that means implies; a comparison is written >=',
    '≠': 'write cte < 1 or cte > 1',
    '!=': 'write cte < 1 or cte > 1',
    '{': "a window stands in '[' and ']'",
    'next': _NO_STEP,
    'X': _NO_STEP,
    'prev': _NO_STEP,
    'previous': _NO_STEP,
    'true': 'write 0 <= 1',
    'false': 'write 1 <= 0',
    'xor': "write it with 'and', 'or' and 'not'",
    'iff': 'write (a implies b) and (b implies a)',
    '<->': 'write (a implies b) and (b implies a)',
    **dict.fromkeys(('alw', 'alw_', '[]'), 'write always(...), or always[0:10](...)'),
    **dict.fromkeys(('ev', 'ev_'), 'write eventually(...), or eventually[0:10](...)'),
    '<>': 'write eventually(...); for another number cte < 1 or cte > 1',
    'rise': 'write p and once[0.1:0.1](not p), with the time between two samples',
    'fall': 'write (not p) and once[0.1:0.1](p), with the time between two samples',
}
_OF_FORMULAS = {
    **dict.fromkeys(('=', '=='), f'for iff {_SAYS["iff"]}'),
    **dict.fromkeys(('!=', '≠'), f'for xor {_SAYS["xor"]}'),
}
"""What to write where formulas are compared as if they were numbers."""
_MEANS = {'cross_track_error': 'cte', 'heading': 'he', 'heading_error': 'he'}


def hint(token: Token, before: Token | None, names: Collection[str] = ()) -> str:
    """Hint to append to an error message, starting with '; ', or ''.

    Args:
        token: the unexpected token.
        before: the token before it.
        names: known signals and predicates.
    """
    said = _SAYS.get(token.raw)
    if said is None and token.kind == 'name' and token.raw not in names:
        of_number = before is not None and before.kind == 'number'
        said = _resembling(token.raw, [*names, *(UNITS if of_number else ())], of_number)
        if said is None and of_number:
            said = f'units are {", ".join(UNITS)}'
    return '' if said is None else f'; {said}'


def _resembling(word: str, names: Collection[str], of_number: bool) -> str | None:
    meant = MEANT.get(word) if of_number else _MEANS.get(word)
    if meant in names:
        return f'did you mean {meant!r}?'
    known = {name.lower(): name for name in [*WORDS, *names]}
    close = difflib.get_close_matches(word.lower(), known, n=1, cutoff=0.7)
    return f'did you mean {known[close[0]]!r}?' if close else None


MAX_DEPTH = 50
"""Maximum nesting of parentheses and prefix operators."""
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
_UNIT_NS = {'s': 10**9, 'ms': 10**6, 'us': 10**3, 'ns': 1, 'min': 60 * 10**9}
_TEMPORAL = frozenset({'always', 'eventually', 'historically', 'once'})
_COMPARISON = "'<=', '<', '>=' or '>'"
_Node = ast.Expr | ast.Formula


class _Part(NamedTuple):
    """A parsed part of a formula.

    Attributes:
        node: syntax tree.
        start: first token.
        quantity: dimension of a number, as far as known.
        unit: the first number in it that has a unit, and that unit; or None.
        constant: it is a number and reads no signal.
        clash: position and message of a sum or comparison of different dimensions; an error only if
            it is combined with a number that has a unit.
    """

    node: _Node
    start: Token
    quantity: Quantity = PURE
    unit: tuple[Token, str] | None = None
    constant: bool = False
    clash: tuple[Token, str] | None = None


def parse(
    text: str,
    signals: Collection[str],
    predicates: Mapping[str, str] | None = None,
    where: str = 'formula',
) -> ast.Formula:
    """Parse a formula.

    Args:
        text: e.g. ``eventually[0:10](always(abs(cte) <= 1.5))``.
        signals: names that the formula may read; a mapping gives their units too.
        predicates: formulas by name, which the text may use as in VerifAI's ``F[0, 10] G name``.
        where: description of the text; error messages start with it.

    Raises:
        UsageError: invalid formula; the message gives the column and what was expected.
    """
    named: dict[str, ast.Formula] = {}
    for name, body in (predicates or {}).items():
        if not name.isidentifier() or name in RESERVED or name in signals:
            raise UsageError(f'{where}: predicate {name!r}: choose another, unreserved name')
        named[name] = _Parser(body, signals, {}, f'{where}: predicate {name!r}').whole()
    formula = _Parser(text, signals, named, where).whole()
    _check_written_out(formula, signals, where)
    return formula


def _check_written_out(formula: ast.Formula, signals: Collection[str], where: str) -> None:
    """Check that the text written to bags and tables can be parsed again."""
    if ast.size(formula) <= MAX_TOKENS:
        try:
            _Parser(str(formula), signals, {}, where).whole()
            return
        except UsageError:
            pass
    fail(
        where, 1, 'expected fewer parts: written out with every parenthesis (and p unless q with '
        f'p twice) there may be at most {MAX_TOKENS} words and {MAX_DEPTH} levels',
    )


class _Parser:
    def __init__(
        self, text: str, signals: Collection[str], named: Mapping[str, ast.Formula], where: str
    ) -> None:
        self._tokens = tokens(text, where)
        self._at = 0
        self._depth = 0
        self._signals = signals
        self._named = named
        self._names = [*signals, *named]
        self._where = where

    def whole(self) -> ast.Formula:
        check_parentheses(self._tokens, self._where)
        part = self._binary(_IMPLIES)
        if self._peek.text == ';':
            self._next()
        if self._peek.kind != 'end' or not _is_formula(part.node):
            self._expected("'and', 'or' or the end" if _is_formula(part.node) else _COMPARISON)
        return self._formula(part)

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
        told = hint(token, before, self._names)
        self._fail(token, f'expected {what}, got {token}{told}')

    def _take(self, text: str) -> None:
        if self._peek.text != text:
            self._expected(repr(text))
        self._next()

    def _formula(self, part: _Part) -> ast.Formula:
        if not _is_formula(part.node):
            self._fail(
                part.start, f'expected a formula such as cte <= 1.5, got the number {part.node}'
            )
        return cast(ast.Formula, part.node)

    def _expr(self, part: _Part) -> ast.Expr:
        if _is_formula(part.node):
            self._fail(part.start, f'expected a number or signal, got the formula {part.node}')
        return cast(ast.Expr, part.node)

    def _fail(self, token: Token, message: str) -> NoReturn:
        fail(self._where, token.column, message)

    def _binary(self, least: int) -> _Part:
        start = self._peek
        part = self._prefix()._replace(start=start)
        done = ''
        while (power := _POWER.get(self._peek.text, 0)) >= least:
            op = self._peek
            self._refuse_chain(op, done, part.node)
            self._next()
            interval = self._interval() if power == _UNTIL else ast.Interval()
            right = self._binary(power + 1)
            part = self._joined(op, interval, part, right)
            done = op.text
        if self._peek.text in ('=', '==', '!=', '≠', '^', '**') and not _is_formula(part.node):
            self._expected(_COMPARISON)
        if said := _OF_FORMULAS.get(self._peek.raw):
            self._fail(self._peek, f"expected 'and', 'or' or the end, got {self._peek}; {said}")
        return part

    def _refuse_chain(self, op: Token, done: str, left: _Node) -> None:
        if op.text == done == 'implies':
            self._fail(op, "expected parentheses in a chain of 'implies': a implies (b implies c)")
        if _POWER[op.text] == _COMPARE and isinstance(left, ast.Compare):
            middle = f'{left} and {left.right} {op.text} ...'
            self._fail(op, f"expected 'and', got {op}; write it as two: {middle}")
        if op.raw == '=>' and not _is_formula(left):
            self._expected(_COMPARISON, op)

    def _joined(self, op: Token, interval: ast.Interval, left: _Part, right: _Part) -> _Part:
        power = _POWER[op.text]
        if power >= _COMPARE:
            return self._calculated(op, left, right)
        first, second = self._formula(left), self._formula(right)
        if power == _UNTIL:
            return _Part(_pair(op.text, interval, first, second), left.start)
        return _Part(ast.Logic(cast(ast.LogicOp, op.text), first, second), left.start)

    def _calculated(self, op: Token, left: _Part, right: _Part) -> _Part:
        """Build a comparison, sum, difference, product or quotient."""
        low, high = self._expr(left), self._expr(right)
        if _POWER[op.text] == _COMPARE:
            both = self._beside(left, right)
            compared = ast.Compare(cast(ast.CompareOp, op.text), low, high)
            if both.constant and not math.isfinite(compile_margin(compared, ())(())):
                self._fail(left.start, f'{compared} has no finite margin')
            return _Part(compared, left.start)
        if op.text in '+-':
            both = self._beside(left, right)
        else:
            power = 1 if op.text == '*' else -1
            both = self._together(left, right, multiplied(left.quantity, right.quantity, power))
        node = ast.Arithmetic(cast(ast.ArithmeticOp, op.text), low, high)
        if op.text == '/' and right.constant and not _value(high):
            self._fail(op, f'{node} divides by zero')
        return self._finite(both._replace(node=node, start=left.start), op)

    def _finite(self, part: _Part, token: Token) -> _Part:
        """Reject a constant that is not finite: it would make every run invalid."""
        if part.constant and not math.isfinite(_value(cast(ast.Expr, part.node))):
            self._fail(token, f'{part.node} has no finite value')
        return part

    def _beside(self, left: _Part, right: _Part) -> _Part:
        """Combine two parts that are added or compared; returns the one with known dimension.

        A number with a unit of another dimension is rejected. Numbers without units are in SI and
        not checked.
        """
        known = right if left.quantity.pure else left
        if not left.quantity.agrees(right.quantity):
            wrong, other = (left, right) if left.unit and not right.unit else (right, left)
            one, two = other.quantity.dimension, wrong.quantity.dimension
            assert one is not None, 'what is not known agrees with everything'
            assert two is not None, 'what is not known agrees with everything'
            wanted = f'expected {kind_words(one)} to go with {other.node}'
            if wrong.unit:
                number, unit = wrong.unit
                self._fail(number, f'{wanted}, got {number.raw} {unit}')
            message = f'{wanted}, got {wrong.node}, {kind_words(two)}'
            known = known._replace(clash=left.clash or right.clash or (wrong.start, message))
        return self._together(known, left if known is right else right,
                              added(left.quantity, right.quantity))

    def _together(self, one: _Part, two: _Part, quantity: Quantity) -> _Part:
        """Merge two parts into the first; a clash combined with a unit is rejected."""
        clash, unit = one.clash or two.clash, one.unit or two.unit
        if clash and unit:
            self._fail(*clash)
        return one._replace(
            quantity=quantity, unit=unit, clash=clash, constant=one.constant and two.constant
        )

    def _prefix(self) -> _Part:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            self._fail(self._peek, f'expected at most {MAX_DEPTH} nested parentheses')
        part = self._one(self._next())
        self._depth -= 1
        return part

    def _one(self, token: Token) -> _Part:
        if token.kind == 'number':
            return self._number(token)
        if token.kind == 'name':
            return self._name(token)
        if token.text == '(':
            inner = self._binary(_IMPLIES)
            self._take(')')
            return inner
        if token.text == '-':
            part = self._binary(_MINUS)
            return part._replace(node=ast.Negative(self._expr(part)))
        if token.text in ast.FUNCTION_ARITY:
            return self._function(token)
        if token.text == 'not':
            return _Part(ast.Not(self._operand()), token)
        if token.text not in _TEMPORAL:
            self._expected("a signal, number, operator or '('", token)
        word = cast(ast.UnaryTemporalOp, token.text)
        return _Part(ast.Temporal(word, self._interval(), self._operand()), token)

    def _operand(self) -> ast.Formula:
        return self._formula(self._binary(_PREFIX))

    def _number(self, token: Token) -> _Part:
        unit = self._unit()
        value = in_si(token.text, unit) if unit else float(token.text)
        if not math.isfinite(value):
            self._expected('a finite number', token)
        if not value and re.match('[0.]*[1-9]', token.text):
            self._expected('a number of at least 5e-324, or 0', token)
        node = ast.Number(value)
        if not unit:
            return _Part(node, token, constant=True)
        return _Part(
            node, token, Quantity(UNITS[unit].dimension), (token, unit), constant=True
        )

    def _unit(self) -> str:
        """Consume a unit if one comes next; '' if not."""
        name, sign, per = (*self._tokens[self._at : self._at + 3], *self._tokens[-1:] * 2)[:3]
        ratio = f'{name.text}/{per.text}'
        if sign.text == '/' and ratio in UNITS and per.text not in self._names:
            self._at += 3
            return ratio
        if name.text in UNITS and name.text not in self._names:
            self._at += 1
            return name.text
        return ''

    def _name(self, token: Token) -> _Part:
        if token.text in self._named:
            return _Part(self._named[token.text], token)
        if token.text not in self._signals:
            told = hint(token, None, self._names)
            listed = ', '.join(self._names)
            self._fail(token, f'expected a signal, got unknown {token}{told}; known: {listed}')
        unit = self._signals[token.text] if isinstance(self._signals, Mapping) else ''
        return _Part(ast.Signal(token.text), token, Quantity(dimension_of(unit)))

    def _function(self, token: Token) -> _Part:
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
        whole = functools.reduce(self._beside, args)
        part = whole._replace(
            node=ast.Function(name, tuple(self._expr(arg) for arg in args)), start=token,
            quantity=rooted(whole.quantity) if name == 'sqrt' else whole.quantity,
        )
        return self._finite(part, token)

    def _argument(self) -> _Part:
        part = self._binary(_SUM)
        self._expr(part)
        return part

    def _interval(self) -> ast.Interval:
        if self._peek.text != '[':
            return ast.Interval()
        start = self._at
        self._next()
        low_token = self._peek
        low_ns = self._bound("':' or ','")
        if self._peek.text not in (':', ','):
            self._expected("':' or ','")
        self._next()
        high_ns = None
        if self._peek.text == 'inf':
            self._next()
        else:
            high_ns = self._bound("']'")
        self._take(']')
        if high_ns is not None and low_ns > high_ns:
            seen = ''.join(t.raw for t in self._tokens[start : self._at])
            self._fail(low_token, f'expected a window [a:b] with a <= b, got {seen}')
        return ast.Interval(low_ns, high_ns)

    def _bound(self, then: str) -> int:
        token = self._next()
        if token.text == '-':
            self._fail(token, "expected 0 seconds or more; 'once' and 'historically' look back")
        if token.kind != 'number':
            self._expected('a number of seconds', token)
        unit = self._next().text if self._peek.text in _UNIT_NS else 's'
        if (wrong := self._peek).kind in ('name', 'word'):
            meant = 's or min' if wrong.raw in ('m', 'M') else MEANT.get(wrong.raw)
            told = f'; did you mean {meant}?' if meant in (*_UNIT_NS, 's or min') else ''
            units = ', '.join(_UNIT_NS)
            self._fail(wrong, f'expected {then} or a unit ({units}), got {wrong}{told}')
        try:
            # Exact arithmetic: 0.1 is 100 ms to the nanosecond, nothing is rounded silently.
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
    """Node of until or since; unless (weak until) and release are expressed with until."""
    if word == 'unless':
        lasting = ast.Temporal('always', ast.Interval(0, interval.high_ns), left)
        return ast.Logic('or', ast.TemporalPair('until', interval, left, right), lasting)
    if word == 'release':
        neither = ast.TemporalPair('until', interval, ast.Not(left), ast.Not(right))
        return ast.Not(neither)
    return ast.TemporalPair(cast(ast.BinaryTemporalOp, word), interval, left, right)


def _value(expr: ast.Expr) -> float:
    """Value of an expression without signals; NaN if undefined."""
    return compile_margin(ast.Compare('<=', ast.Number(0.0), expr), ())(())


def _is_formula(node: _Node) -> bool:
    return isinstance(node, ast.Formula)
