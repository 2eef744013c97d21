"""Conversion of values and text for JSON and pages.

JSON has no NaN and no infinity, and text in a page must not become markup or code.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

from markupsafe import Markup


def signs(words: str) -> str:
    """A value with its unit as a page shows it: a true minus, and ``°`` for ``deg``."""
    words = f'−{words[1:]}' if words.startswith('-') else words
    return words.replace(' deg', '°')


# Characters that HTML cannot contain: control characters other than tab and line ends, lone
# surrogates, and the last two non-characters of the first plane.
_UNFIT = re.compile('[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]')
_IN_SCRIPT = str.maketrans({'<': r'\u003c', '>': r'\u003e', '&': r'\u0026'})


def clean(text: str) -> str:
    """``text`` with U+FFFD, the replacement character, for characters that HTML cannot contain."""
    return _UNFIT.sub('\ufffd', text)


def cleaned(value: Any) -> Any:
    """Like :func:`clean` for any value of a template; HTML markup is left unchanged."""
    return clean(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def data_block(value: Any) -> Markup:
    """JSON for the inside of a ``<script type="application/json">``.

    Characters that could end the element or open a comment in it, and all non-ASCII characters, are
    escaped.

    Raises:
        ValueError: a number is not finite; see :func:`plain_number`.
    """
    text = json.dumps(_all_clean(value), separators=(',', ':'), allow_nan=False)
    # It no longer contains HTML characters.
    return Markup(text.translate(_IN_SCRIPT))


def plain_number(value: float, decimals: int) -> float | int | str | None:
    """A rounded number for JSON; NaN is null, and infinities are words that the page knows."""
    if math.isnan(value):
        return None
    if math.isinf(value):
        return '∞' if value > 0 else '-∞'
    rounded = round(float(value), decimals)
    return int(rounded) if rounded == int(rounded) else rounded


def _all_clean(value: Any) -> Any:
    if isinstance(value, str):
        return clean(value)
    if isinstance(value, dict):
        return {clean(name): _all_clean(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_all_clean(inner) for inner in value]
    return value
