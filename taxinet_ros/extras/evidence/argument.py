"""The argument from requirement to results, in Goal Structuring Notation (GSN).

Elements and their relations follow the GSN Community Standard, version 3 (2021): goals,
strategies, solutions, contexts, assumptions, justifications; *SupportedBy* and *InContextOf*. A
goal without support is marked undeveloped. Every solution points at an item with a hash.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from taxinet_ros.extras.evidence.figures import Verdict


class Kind(StrEnum):
    """Kind of an element."""

    GOAL = 'goal'
    STRATEGY = 'strategy'
    SOLUTION = 'solution'
    CONTEXT = 'context'
    ASSUMPTION = 'assumption'
    JUSTIFICATION = 'justification'


_LETTERS = {
    Kind.GOAL: 'G', Kind.STRATEGY: 'S', Kind.SOLUTION: 'Sn', Kind.CONTEXT: 'C',
    Kind.ASSUMPTION: 'A', Kind.JUSTIFICATION: 'J',
}
SUPPORTED_BY, IN_CONTEXT_OF = 'SupportedBy', 'InContextOf'
_MAY_SUPPORT = {
    Kind.GOAL: (Kind.GOAL, Kind.STRATEGY, Kind.SOLUTION), Kind.STRATEGY: (Kind.GOAL,),
}
"""What may support an element, by its kind; the others have no support."""
_BESIDE = (Kind.CONTEXT, Kind.ASSUMPTION, Kind.JUSTIFICATION)


@dataclass(frozen=True, kw_only=True, slots=True)
class Node:
    """An element.

    Attributes:
        name: identifier, such as ``G1``.
        kind: its kind.
        text: statement.
        verdict: of a goal: what the figures say of it; None for other elements.
        why: of a goal: sentence on the verdict, or on why it is undeveloped.
        undeveloped: of a goal: nothing supports it yet.
        item: of a solution, a context: id of the item that it refers to, or ''.
    """

    name: str
    kind: Kind
    text: str
    verdict: Verdict | None = None
    why: str = ''
    undeveloped: bool = False
    item: str = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class Edge:
    """A relation from an element to what supports it, or to its context."""

    source: str
    target: str
    kind: str


@dataclass(frozen=True, kw_only=True)
class Argument:
    """Elements and relations; the first element is the top goal."""

    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]

    def node(self, name: str) -> Node:
        """The element of a name."""
        return next(one for one in self.nodes if one.name == name)

    def below(self, name: str) -> tuple[Node, ...]:
        """What supports an element, in order."""
        return tuple(
            self.node(edge.target) for edge in self.edges
            if edge.source == name and edge.kind == SUPPORTED_BY
        )

    def beside(self, name: str) -> tuple[Node, ...]:
        """The context of an element, in order."""
        return tuple(
            self.node(edge.target) for edge in self.edges
            if edge.source == name and edge.kind == IN_CONTEXT_OF
        )

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return {
            'notation': 'GSN Community Standard, version 3',
            'nodes': [
                {
                    'id': one.name, 'kind': one.kind.value, 'text': one.text,
                    'verdict': one.verdict.value if one.verdict else None, 'why': one.why,
                    'undeveloped': one.undeveloped, 'item': one.item,
                } for one in self.nodes
            ],
            'edges': [
                {'from': one.source, 'to': one.target, 'kind': one.kind} for one in self.edges
            ],
        }


class Builder:
    """Numbers elements and joins them."""

    def __init__(self) -> None:
        self._nodes: list[Node] = []
        self._edges: list[Edge] = []

    def add(
        self, kind: Kind, text: str, *, above: str = '', item: str = '',
        found: tuple[Verdict, str] | None = None, undeveloped: str = '',
    ) -> str:
        """Add an element and return its name.

        Args:
            kind: its kind.
            text: statement.
            above: name of the element that it supports, or is context of; '' for the top.
            item: id of the item that it refers to.
            found: verdict of a goal, and why.
            undeveloped: why nothing supports a goal yet; '' if something does.
        """
        number = sum(one.kind is kind for one in self._nodes) + 1
        name = f'{_LETTERS[kind]}{number}'
        verdict, why = found or (None, undeveloped)
        self._nodes.append(Node(
            name=name, kind=kind, text=text, item=item, why=why, undeveloped=bool(undeveloped),
            verdict=Verdict.UNDETERMINED if undeveloped else verdict,
        ))
        if above:
            relation = IN_CONTEXT_OF if kind in _BESIDE else SUPPORTED_BY
            self._edges.append(Edge(source=above, target=name, kind=relation))
        return name

    def argument(self) -> Argument:
        """The argument; goals that others support have the verdict that follows from theirs."""
        found = Argument(nodes=tuple(self._nodes), edges=tuple(self._edges))
        nodes = tuple(
            replace(one, verdict=_combined(found, one), why=one.why or _combined_words(found, one))
            if one.kind is Kind.GOAL and one.verdict is None else one for one in found.nodes
        )
        return replace(found, nodes=nodes)


def _goals_below(argument: Argument, one: Node) -> Iterator[Node]:
    for child in argument.below(one.name):
        if child.kind is Kind.GOAL:
            yield child
        elif child.kind is Kind.STRATEGY:
            yield from _goals_below(argument, child)


def _combined(argument: Argument, one: Node) -> Verdict:
    """Refuted if a part is, supported if all are, else undetermined."""
    parts = [
        child.verdict or _combined(argument, child) for child in _goals_below(argument, one)
    ]
    if Verdict.REFUTED in parts:
        return Verdict.REFUTED
    whole = parts and all(part is Verdict.SUPPORTED for part in parts)
    return Verdict.SUPPORTED if whole else Verdict.UNDETERMINED


def _combined_words(argument: Argument, one: Node) -> str:
    parts = list(_goals_below(argument, one))
    verdicts = [child.verdict or _combined(argument, child) for child in parts]
    counts = ', '.join(
        f'{verdicts.count(verdict)} {verdict}' for verdict in Verdict if verdicts.count(verdict)
    )
    return f'of its parts: {counts}' if counts else ''


@dataclass(frozen=True, kw_only=True)
class Part:
    """A goal about one system with what supports it.

    Attributes:
        text: statement of the goal.
        found: verdict and why; None if it is undeveloped.
        solutions: texts and items of what supports it.
        undeveloped: why nothing does; ''.
    """

    text: str
    found: tuple[Verdict, str] | None = None
    solutions: tuple[tuple[str, str], ...] = ()
    undeveloped: str = ''


@dataclass(frozen=True, kw_only=True)
class SystemArgument:
    """What is argued about one system.

    Attributes:
        text: statement of its goal.
        contexts: texts and items of program, formula, network, versions.
        parts: the goals below it.
    """

    text: str
    contexts: tuple[tuple[str, str], ...]
    parts: tuple[Part, ...]


def build_argument(
    top: str, contexts: Sequence[tuple[str, str]], systems: Sequence[SystemArgument],
    limits: tuple[str, str],
) -> Argument:
    """Build the argument.

    Args:
        top: statement of the top goal.
        contexts: texts and items of its contexts.
        systems: the systems.
        limits: text and item of the known limits.
    """
    builder = Builder()
    goal = builder.add(Kind.GOAL, top)
    for text, item in contexts:
        builder.add(Kind.CONTEXT, text, above=goal, item=item)
    builder.add(Kind.CONTEXT, limits[0], above=goal, item=limits[1])
    builder.add(Kind.ASSUMPTION, 'What is true of the simulated world, camera and weather is true '
                'of the real ones', above=goal)
    strategy = builder.add(
        Kind.STRATEGY, 'Argue over each system that was run: program, formula, network, '
        'controller, world', above=goal,
    )
    builder.add(Kind.JUSTIFICATION, 'Rates are of runs that the program itself drew, with exact '
                '95 % intervals', above=strategy)
    for system in systems:
        name = builder.add(Kind.GOAL, system.text, above=strategy)
        for text, item in system.contexts:
            builder.add(Kind.CONTEXT, text, above=name, item=item)
        for part in system.parts:
            below = builder.add(
                Kind.GOAL, part.text, above=name, found=part.found, undeveloped=part.undeveloped
            )
            for text, item in part.solutions:
                builder.add(Kind.SOLUTION, text, above=below, item=item)
    return builder.argument()


def argument_faults(argument: Argument, hashes: Mapping[str, str | None]) -> list[str]:
    """What is wrong with an argument; empty if it is sound.

    Args:
        argument: the argument.
        hashes: SHA-256 of the items by id; None if it is not known.

    Sound is: every relation joins kinds that it may join; every element is below the top goal,
    without a cycle; every goal and strategy is supported, or a goal is marked undeveloped and is
    not; every solution points at an item with a hash.
    """
    return list(_faults(argument, hashes))


def _faults(argument: Argument, hashes: Mapping[str, str | None]) -> Iterator[str]:
    names = [one.name for one in argument.nodes]
    kinds = {one.name: one.kind for one in argument.nodes}
    if len(kinds) != len(names):
        yield 'two elements have one name'
    if not names or kinds[names[0]] is not Kind.GOAL:
        yield 'there is no top goal'
        return
    for edge in argument.edges:
        if edge.source not in kinds or edge.target not in kinds:
            yield f'{edge.source} to {edge.target}: no such element'
            return
        allowed = _MAY_SUPPORT.get(kinds[edge.source], ()) if edge.kind == SUPPORTED_BY else (
            _BESIDE if kinds[edge.source] in _MAY_SUPPORT else ()
        )
        if kinds[edge.target] not in allowed:
            yield (
                f'{edge.target}: a {kinds[edge.target]} cannot be {edge.kind} a '
                f'{kinds[edge.source]}'
            )
    if _has_cycle(argument):
        yield 'an element supports itself'
        return
    reached = set(_reached(argument, names[0]))
    yield from (f'{name}: is not below {names[0]}' for name in names if name not in reached)
    for one in argument.nodes:
        yield from _node_faults(argument, one, hashes)


def _node_faults(
    argument: Argument, one: Node, hashes: Mapping[str, str | None]
) -> Iterator[str]:
    below = argument.below(one.name)
    if one.kind is Kind.GOAL and bool(below) == one.undeveloped:
        yield f'{one.name}: is {"supported, but marked" if below else "not supported and not"} ' \
              'undeveloped'
    if one.kind is Kind.STRATEGY and not below:
        yield f'{one.name}: no goal follows'
    if one.kind is Kind.SOLUTION and not hashes.get(one.item):
        yield f'{one.name}: points at no item with a hash'
    if one.item and one.item not in hashes:
        yield f'{one.name}: points at {one.item}, which is no item'


def _has_cycle(argument: Argument) -> bool:
    left = {one.name for one in argument.nodes}
    while left:
        free = {
            name for name in left
            if not any(edge.source == name and edge.target in left for edge in argument.edges)
        }
        if not free:
            return True
        left -= free
    return False


def _reached(argument: Argument, name: str) -> Iterable[str]:
    yield name
    for edge in argument.edges:
        if edge.source == name:
            yield from _reached(argument, edge.target)


def argument_of(values: Mapping[str, Any]) -> Argument:
    """Inverse of :meth:`Argument.plain`.

    Raises:
        KeyError, TypeError, ValueError: a value is missing or unknown.
    """
    return Argument(
        nodes=tuple(
            Node(
                name=one['id'], kind=Kind(one['kind']), text=one['text'], why=one['why'],
                verdict=None if one['verdict'] is None else Verdict(one['verdict']),
                undeveloped=one['undeveloped'], item=one['item'],
            ) for one in values['nodes']
        ),
        edges=tuple(
            Edge(source=one['from'], target=one['to'], kind=one['kind'])
            for one in values['edges']
        ),
    )
