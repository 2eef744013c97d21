"""The argument in Goal Structuring Notation: goals, what supports them, and its text for Mermaid.

GSN Community Standard, version 3: a goal is supported by a strategy, by other goals, or by
solutions, and stands in a context. A verdict is an addition to it: what the figures say of a goal.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from taxinet_ros.extras.evidence.figures import Verdict

Values = Mapping[str, Any]
_SHAPES = {
    'G': ('["', '"]'), 'S': ('[/"', '"/]'), 'Sn': ('(("', '"))'), 'C': ('("', '")'),
    'A': ('(["', '"])'),
}
"""Of goals, strategies, solutions, contexts and assumptions, by the first letters of their ids."""
_MARKUP = re.compile(r'[^\w\s.,:;()/%=+*|\'φρ≤≥…–-]')
_LISTS = {'context': ('context', 'C'), 'assumption': ('assumptions', 'A'),
          'solution': ('solutions', 'Sn')}
"""Key and letters of what stands beside and below goals."""


def parse_argument(text: str) -> dict[str, Any]:
    """Goals from their lines, as ``argument.j2`` has them, with an id for each element.

    A goal of parts is refuted if one of them is, supported if all are, else undetermined; one
    without parts and solutions is undeveloped: nothing supports it yet.
    """
    numbers: Counter[str] = Counter()

    def named(letters: str, values: dict[str, Any]) -> dict[str, Any]:
        numbers[letters] += 1
        return {'id': f'{letters}{numbers[letters]}', **values}

    above: list[dict[str, Any]] = []
    for line in filter(str.strip, text.splitlines()):
        depth = (len(line) - len(line.lstrip())) // 2
        kind, _, words = line.strip().partition(': ')
        one = above[depth - 1] if depth else {}
        if kind in _LISTS:
            key, letters = _LISTS[kind]
            words, _, item = words.rpartition(' -> ') if ' -> ' in words else (words, '', '')
            one[key].append(named(letters, {'text': words, 'item': item}))
        elif kind == 'strategy':
            one['strategy'] = named('S', {'text': words})
        elif kind == 'why':
            one['why'] = '; '.join(filter(None, (one['why'], words)))
        else:
            above[depth:] = [named('G', {
                'text': words, 'verdict': kind, 'why': '', 'strategy': None, 'parts': [],
                **{key: [] for key, _ in _LISTS.values()},
            })]
            if depth:
                one['parts'].append(above[depth])
    _conclude(above[0])
    return above[0]


def _conclude(goal: dict[str, Any]) -> None:
    for part in goal['parts']:
        _conclude(part)
    goal['undeveloped'] = not (goal['parts'] or goal['solutions'])
    if goal['parts']:
        counts = Counter(part['verdict'] for part in goal['parts'])
        goal['verdict'] = (
            Verdict.REFUTED if counts[Verdict.REFUTED]
            else Verdict.SUPPORTED if counts[Verdict.SUPPORTED] == len(goal['parts'])
            else Verdict.UNDETERMINED
        ).value
        words = ', '.join(f'{counts[one]} {one}' for one in Verdict if counts[one])
        goal['why'] = f'of its parts: {words}'


def goals(argument: Values) -> Iterator[Values]:
    """All goals of an argument, from the top down."""
    yield argument
    for part in argument['parts']:
        yield from goals(part)


def mermaid(argument: Values) -> str:
    """The argument as a Mermaid flowchart, which GitHub and many editors draw."""
    return '\n'.join(['flowchart TD', *_lines(argument)]) + '\n'


def _lines(one: Values) -> Iterator[str]:
    name, verdict = one['id'], 'undeveloped ◇' if one['undeveloped'] else one['verdict']
    yield _node(name, one['text'], f'<br/>{_safe(verdict)}')
    for beside in (*one['context'], *one['assumptions']):
        yield _node(beside['id'], beside['text'])
        yield f'  {name} -.-> {beside["id"]}'
    above = name
    if one['strategy']:
        above = one['strategy']['id']
        yield _node(above, one['strategy']['text'])
        yield f'  {name} --> {above}'
    for solution in one['solutions']:
        yield _node(solution['id'], solution['text'])
        yield f'  {above} --> {solution["id"]}'
    for part in one['parts']:
        yield f'  {above} --> {part["id"]}'
        yield from _lines(part)


def _node(name: str, text: str, more: str = '') -> str:
    before, after = _SHAPES[name.rstrip('0123456789')]
    return f'  {name}{before}{name}: {_safe(text)}{more}{after}'


def _safe(text: str) -> str:
    return _MARKUP.sub(lambda found: f'#{ord(found[0])};', text)
