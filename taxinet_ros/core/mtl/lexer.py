"""Formula tokenizer. Replaces aliases and Unicode signs by the plain words."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NoReturn

from taxinet_ros.errors import UsageError

Kind = Literal['number', 'name', 'word', 'sign', 'end']

MAX_TOKENS = 500
"""Longer formulas are rejected: they are unreadable, and evaluation recurses over the tree."""

_SHOWN = 40
"""Maximum number of characters of a word shown in an error message."""

WORDS = frozenset(
    {
        *('not', 'and', 'or', 'implies'),
        *('always', 'eventually', 'until', 'historically', 'once', 'since'),
        *('unless', 'release'),
        *('abs', 'min', 'max', 'sqrt', 'inf'),
    }
)
"""Reserved words; not allowed as names of signals or predicates."""

_ALIASES = {
    'G': 'always', 'globally': 'always', '□': 'always', '◻': 'always',
    'F': 'eventually', '◇': 'eventually', '◊': 'eventually', '⋄': 'eventually',
    'U': 'until', 'H': 'historically', 'O': 'once', 'S': 'since', 'W': 'unless', 'R': 'release',
    '∧': 'and', '&': 'and', '&&': 'and', '∨': 'or', '|': 'or', '||': 'or',
    '¬': 'not', '!': 'not', '->': 'implies', '=>': 'implies', '→': 'implies', '⇒': 'implies',
    '∞': 'inf',
}  # fmt: skip
_SIGN_ALIASES = {'≤': '<=', '≥': '>=', '−': '-'}

RESERVED = WORDS | {alias for alias in _ALIASES if alias.isalpha()}
"""Words and letter aliases."""

_TOKEN = re.compile(
    r'(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)'
    r'|(?P<name>[A-Za-z_][A-Za-z0-9_]*)'
    r'|(?P<sign>->|=>|<->|<>|\[\]|<=|>=|==|!=|&&|\|\||\*\*|[-+*/()\[\]:,;<>=!&|□◻◇◊⋄∧∨¬→⇒≤≥∞−^≠{}%°])'
)
_SPACE = re.compile(r'\s*')


@dataclass(frozen=True, slots=True)
class Token:
    """One token of a formula.

    Attributes:
        kind: kind of token.
        text: its plain form (``always`` for ``G``).
        column: start column, counted from 1.
        raw: the original text.
    """

    kind: Kind
    text: str
    column: int
    raw: str

    def __str__(self) -> str:
        if self.kind == 'end':
            return 'the end of the text'
        return repr(self.raw if len(self.raw) <= _SHOWN else f'{self.raw[:_SHOWN]}…')


def fail(where: str, column: int, message: str) -> NoReturn:
    """Raise a one-line error about a formula text."""
    raise UsageError(f'{where}: column {column}: {message}')


def tokens(text: str, where: str) -> list[Token]:
    """Split a formula text into tokens, followed by one of kind ``end``.

    Args:
        text: the formula.
        where: description of the text for error messages.

    Raises:
        UsageError: an invalid character, or more than :data:`MAX_TOKENS` tokens.
    """
    found: list[Token] = []
    at = _skip(text, 0)
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            fail(where, at + 1, f'expected a formula sign or name, got {text[at]!r}')
        if len(found) == MAX_TOKENS:
            fail(where, at + 1, f'expected the end: a formula has at most {MAX_TOKENS} words')
        found.append(_token(match))
        at = _skip(text, match.end())
    return [*found, Token('end', '', len(text) + 1, '')]


def check_parentheses(found: Sequence[Token], where: str) -> None:
    """Check for unmatched parentheses; the error is clearer than the parser's.

    Raises:
        UsageError: an unmatched parenthesis.
    """
    opened: list[Token] = []
    for token in found:
        if token.text in ('(', '['):
            opened.append(token)
        elif token.text in (')', ']'):
            if not opened:
                fail(where, token.column, f'expected no {token}: nothing is open')
            if opened.pop().text + token.text not in ('()', '[]'):
                return
    if opened and opened[-1].text == '(':
        start = opened[-1].column
        fail(where, found[-1].column, f"expected ')' to close '(' of column {start}")


def _skip(text: str, at: int) -> int:
    space = _SPACE.match(text, at)
    return at if space is None else space.end()


def _token(match: re.Match[str]) -> Token:
    text, column = match.group(), match.start() + 1
    if match.lastgroup == 'number':
        return Token('number', text, column, text)
    plain = _SIGN_ALIASES.get(text, _ALIASES.get(text, text))
    if plain in WORDS:
        return Token('word', plain, column, text)
    return Token('name' if match.lastgroup == 'name' else 'sign', plain, column, text)
