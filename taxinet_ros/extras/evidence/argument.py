"""The argument in Goal Structuring Notation: goals, what supports them, and its text for Mermaid.

GSN Community Standard, version 3: a goal is supported by a strategy, by other goals, or by
solutions, and stands in a context. A verdict is an addition to it: what the figures say of a goal.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from taxinet_ros.extras.evidence.figures import Verdict

_SHAPES = {
    'G': ('["', '"]'), 'S': ('[/"', '"/]'), 'Sn': ('(("', '"))'), 'C': ('("', '")'),
    'A': ('(["', '"])'),
}
"""Of goals, strategies, solutions, contexts and assumptions, by the first letters of their ids."""
_MARKUP = re.compile(r'[^\w\s.,:;()/%=+*|\'φρ≤≥…–-]')


class Reference(NamedTuple):
    """A solution or a context.

    Attributes:
        text: what it says.
        item: id of the item with a hash that it refers to; '' for none.
    """

    text: str
    item: str = ''


@dataclass(frozen=True, kw_only=True)
class Goal:
    """A goal with all below it.

    Attributes:
        text: statement.
        verdict: what the figures say of it.
        why: sentence on the verdict, or on why nothing supports it yet.
        undeveloped: nothing supports it yet.
        context, assumptions, solutions: what stands beside it and below it.
        strategy: how the parts argue for it; ''.
        parts: goals that support it.
    """

    text: str
    verdict: Verdict
    why: str = ''
    undeveloped: bool = False
    context: tuple[Reference, ...] = ()
    assumptions: tuple[Reference, ...] = ()
    solutions: tuple[Reference, ...] = ()
    strategy: str = ''
    parts: tuple[Goal, ...] = ()


def open_goal(text: str, why: str) -> Goal:
    """A goal that nothing supports yet."""
    return Goal(text=text, verdict=Verdict.UNDETERMINED, why=why, undeveloped=True)


def shown(text: str, found: tuple[Verdict, str], *solutions: Reference) -> Goal:
    """A goal that solutions speak on."""
    return Goal(text=text, verdict=found[0], why=found[1], solutions=solutions)


def whole(
    text: str, parts: Sequence[Goal], context: Sequence[Reference], *,
    assumptions: Sequence[Reference] = (), strategy: str = '',
) -> Goal:
    """A goal of parts: refuted if one of them is, supported if all are, else undetermined."""
    counts = Counter(one.verdict for one in parts)
    verdict = (
        Verdict.REFUTED if counts[Verdict.REFUTED]
        else Verdict.SUPPORTED if counts[Verdict.SUPPORTED] == len(parts)
        else Verdict.UNDETERMINED
    )
    words = ', '.join(f'{counts[one]} {one}' for one in Verdict if counts[one])
    return Goal(
        text=text, verdict=verdict, why=f'of its parts: {words}', parts=tuple(parts),
        context=tuple(context), assumptions=tuple(assumptions), strategy=strategy,
    )


def argument_values(top: Goal) -> dict[str, Any]:
    """The argument for JSON, with an id for each element, such as ``G1`` and ``Sn3``."""
    numbers: Counter[str] = Counter()

    def numbered(letters: str) -> str:
        numbers[letters] += 1
        return f'{letters}{numbers[letters]}'

    def beside(letters: str, found: Sequence[Reference]) -> list[dict[str, str]]:
        return [{'id': numbered(letters), **one._asdict()} for one in found]

    def values(goal: Goal) -> dict[str, Any]:
        return {
            'id': numbered('G'), 'text': goal.text, 'verdict': goal.verdict.value,
            'why': goal.why, 'undeveloped': goal.undeveloped,
            'context': beside('C', goal.context), 'assumptions': beside('A', goal.assumptions),
            'strategy': {'id': numbered('S'), 'text': goal.strategy} if goal.strategy else None,
            'solutions': beside('Sn', goal.solutions),
            'parts': [values(part) for part in goal.parts],
        }

    return values(top)


def goals(argument: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """All goals of the values of an argument, from the top down."""
    yield argument
    for part in argument['parts']:
        yield from goals(part)


def mermaid(argument: Mapping[str, Any]) -> str:
    """The argument as a Mermaid flowchart, which GitHub and many editors draw."""
    return '\n'.join(['flowchart TD', *_lines(argument)]) + '\n'


def _lines(goal: Mapping[str, Any]) -> Iterator[str]:
    name, verdict = goal['id'], 'undeveloped ◇' if goal['undeveloped'] else goal['verdict']
    yield _node(name, f'{goal["text"]}<br/>{verdict}')
    for one in (*goal['context'], *goal['assumptions']):
        yield _node(one['id'], one['text'])
        yield f'  {name} -.-> {one["id"]}'
    above = name
    if goal['strategy']:
        above = goal['strategy']['id']
        yield _node(above, goal['strategy']['text'])
        yield f'  {name} --> {above}'
    for one in goal['solutions']:
        yield _node(one['id'], one['text'])
        yield f'  {above} --> {one["id"]}'
    for part in goal['parts']:
        yield f'  {above} --> {part["id"]}'
        yield from _lines(part)


def _node(name: str, text: str) -> str:
    before, after = _SHAPES[name.rstrip('0123456789')]
    safe = _MARKUP.sub(lambda found: f'#{ord(found[0])};', text.replace('<br/>', '\n'))
    return f'  {name}{before}{name}: {safe.replace(chr(10), "<br/>")}{after}'
