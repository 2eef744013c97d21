"""What somebody who wrote something wrong probably meant: the end of a formula's error message."""

from __future__ import annotations

import difflib
from collections.abc import Collection

from taxinet_ros.core.mtl.lexer import WORDS, Token
from taxinet_ros.core.mtl.units import MEANT, UNITS

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
}
_MEANS = {'cross_track_error': 'cte', 'heading': 'he', 'heading_error': 'he'}


def hint(token: Token, before: Token | None, names: Collection[str] = ()) -> str:
    """A half sentence to append, with its own '; ' at the head, or ''.

    Args:
        token: the token that was wrong.
        before: the token before it.
        names: signals and predicates that could be meant.
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
