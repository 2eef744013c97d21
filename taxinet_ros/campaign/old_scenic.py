"""What a line of Scenic 1 or 2, as the paper's programs have them, is in Scenic 3.

Scenic 3 makes objects with ``new``, draws between two numbers with ``Range``, and its parser says
of the older words no more than "invalid syntax". These are the places where a program of this
project differs; the text is not parsed, for it cannot be.
"""

from __future__ import annotations

import re

from taxinet_ros.campaign.programs import MODEL

_NUMBER = r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?'
_PAIR = rf'\(\s*({_NUMBER})\s*,\s*({_NUMBER})\s*\)'
_SPECIFIER = (
    r'(?:at|in|on|with|facing|offset|beyond|visible|not\s+visible|following|left\s+of|right\s+of|'
    r'ahead\s+of|behind|apparently|contained\s+in|using)'
)

_MADE = re.compile(rf'(^\s*|[=(,]\s*|\breturn\s+)([A-Z]\w*)(?=\s+{_SPECIFIER}\b)')
_EGO = re.compile(r'^(\s*ego\s*=\s*)([A-Z]\w*)(?=\s*$)')
_MODEL = re.compile(r'^\s*(?:model|from|import)\s+[\w.]*xplane[\w.]*(?:\s+import\s+.*)?$')

_SURE = (
    re.compile(rf'(?<![\w)\]]){_PAIR}(?=\s*(?:deg\b|@))'),
    re.compile(rf'(?<=@){_PAIR}'),
    re.compile(rf'(?<=@\s){_PAIR}'),
    re.compile(rf'(?<=\bfacing\s){_PAIR}'),
    re.compile(rf'(?<=\bparam\s)(?P<name>[^=]*=\s*){_PAIR}'),
)
"""A pair of numbers that can be nothing but an interval of Scenic 1."""

_LIKELY = (
    re.compile(rf'(?<=[=*/+-]\s){_PAIR}'),
    re.compile(rf'(?<![\w)\]]){_PAIR}(?=\s*[*/+:-])'),
    re.compile(rf'(?<=,\s){_PAIR}(?=\s*\)\s*:)'),
)
"""A pair that is an interval where others are; alone it may be a tuple."""

_PAIRS = re.compile(r'\b(?:tuple|sequence)\b')
_NAMES = re.compile(r"'(?:Plane|CLOUDS|RAIN_CLOUDS)' is not defined")
_KNOWS_MODEL = re.compile(rf'^\s*(?:model|from|import)\s+{MODEL}\b', re.MULTILINE)
_MOST_LINES = 8


def newer(text: str, *, pairs: bool = False) -> dict[int, str]:
    """The lines that Scenic 3 writes otherwise, by their number from 1.

    Args:
        text: of the program.
        pairs: whether it is known that a pair of numbers stands where a number has to.
    """
    lines = [line.partition('#')[0].rstrip() for line in text.splitlines()]
    changed = {number: _newer(line) for number, line in enumerate(lines, 1)}
    if pairs or any(line != lines[number - 1] for number, line in changed.items()):
        for number, line in changed.items():
            for pattern in _LIKELY:
                changed[number] = line = pattern.sub(_range, line)
    return {number: line for number, line in changed.items() if line != lines[number - 1]}


def hint(text: str, message: str) -> str:
    """What to add to an error of Scenic; empty where the program has nothing of Scenic 1 or 2.

    Args:
        text: of the program.
        message: what Scenic says.
    """
    lines = newer(text, pairs=bool(_PAIRS.search(message)))
    known = _KNOWS_MODEL.search(text) or f'model {MODEL}' in lines.values()
    model = '' if known else f'"model {MODEL}" as first line'
    if not lines:
        return f'write {model}' if model and _NAMES.search(message) else ''
    said = [f'line {number} "{line.strip()}"' for number, line in sorted(lines.items())]
    more = f' and {len(said) - _MOST_LINES} more' if len(said) > _MOST_LINES else ''
    words = [model, *said[:_MOST_LINES]] if model else said[:_MOST_LINES]
    return f'is this Scenic 1 or 2? Scenic 3 has {", ".join(words)}{more}'


def _newer(line: str) -> str:
    if _MODEL.match(line):
        return f'model {MODEL}'
    line = _EGO.sub(r'\1new \2', _MADE.sub(r'\1new \2', line))
    for pattern in _SURE:
        line = pattern.sub(_range, line)
    return line


def _range(found: re.Match[str]) -> str:
    name = found.groupdict().get('name') or ''
    low, high = found.groups()[-2:]
    return f'{name}Range({low}, {high})'
