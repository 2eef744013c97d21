"""Finds the random choices that a compiled Scenic scenario depends on, and names them.

A name is the parameter or variable that holds the choice, else the property of the object that it
ends in, and the way from there: ``time_of_day``, ``weather``, ``weather[1].rain``,
``ego.position.x``, ``ego.heading``. Names and order follow from the program's text alone.

Only the Scenic child may import this module.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from scenic.core.distributions import (
    DiscreteRange,
    Distribution,
    MultiplexerDistribution,
    Normal,
    OperatorDistribution,
    Options,
    Range,
    TruncatedNormal,
    TupleDistribution,
    UniformDistribution,
    needsSampling,
)
from scenic.core.object_types import Constructible
from scenic.core.regions import PointInRegionDistribution
from scenic.core.vectors import Vector, VectorMethodDistribution, VectorOperatorDistribution

from taxinet_ros.campaign.scene_values import EGO_VALUES, of_scenario
from taxinet_ros.campaign.scenic_regions import coordinates
from taxinet_ros.campaign.search_words import buckets_of

QUANTILED = (Range, Normal, TruncatedNormal, DiscreteRange)
"""Choices whose inverse distribution function is known here; not their subclasses.

So it is for ``Options`` of ranges with fixed ends: they are found as one choice, of a real number.
"""

REQUIREMENTS = 'requirements'
"""Stands among the scenario's keys for what decides only whether a scene is accepted."""

_SHOWN_FIRST = ('position', 'heading')
_PARTS = ('low', 'high', 'mean', 'stddev')
_COMPUTED = (VectorMethodDistribution, VectorOperatorDistribution)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Found:
    """One random choice.

    Attributes:
        name: unique among those found.
        node: the distribution that draws.
        options: what a selector's number selects among, in order; None if it is no selector.
        part: which of its quantiles, where several together make one draw: a point in a region.
        feeds: keys of the scenario that depend on it, and :data:`REQUIREMENTS`.
        when: identities of the selectors by which alone it gets there, each with the number of the
            option that it is part of; empty where it counts whatever they select.
    """

    name: str
    node: Any
    options: tuple[Any, ...] | None
    feeds: frozenset[str]
    when: frozenset[tuple[int, int]] = frozenset()
    part: int = 0


def find_choices(scenario: Any) -> tuple[list[Found], list[str]]:
    """The choices that have quantiles, and the names of whatever else is random."""
    walk = _Walk(
        labels=_labels(scenario), coordinates=_coordinate_names(scenario.params),
        uses=_uses(scenario.dependencies),
    )
    for path, root in _roots(scenario):
        walk.visit(root, path)
    entries = _entries(scenario)
    feeds = {key: _below(values) for key, values in entries.items()}
    branches = _branches_to(itertools.chain.from_iterable(entries.values()))
    found = [
        Found(name=name, node=node, options=walk.selects.get(id(node)),
              feeds=frozenset(key for key, nodes in feeds.items() if id(node) in nodes),
              when=branches.get(id(node), frozenset()), part=part)
        for name, node, part in _unique(walk.found)
    ]
    soft = (f'{req} (holds in {req.prob:.0%} of scenes)'
            for req in scenario.userRequirements if req.prob < 1)
    return found, [*walk.others, *soft]


def random_keys(scenario: Any) -> list[str]:
    """Keys of the scenario whose values are not the same in every scene."""
    ego = scenario.egoObject
    moved = set(EGO_VALUES) if isinstance(ego, Constructible) and _draws(ego) else set()
    return sorted(moved | {
        key for key, values in _entries(scenario).items()
        if key != REQUIREMENTS and any(needsSampling(value) for value in values)
    })


@dataclass(kw_only=True, slots=True)
class _Walk:
    """Depth first, every node once."""

    labels: dict[int, str]
    coordinates: dict[int, dict[int, str]]
    uses: Counter[int]
    selects: dict[int, tuple[Any, ...]] = field(default_factory=dict)
    found: list[tuple[str, Any, int]] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    seen: set[int] = field(default_factory=set)

    def visit(self, value: Any, path: str) -> None:
        if id(value) in self.seen or not needsSampling(value):
            return
        self.seen.add(id(value))
        path = self.labels.get(id(value), path)
        node = value._conditioned  # what Scenic draws in its stead
        if self._is_mixture(node):
            self.found.append((path, node, 0))
            return
        if type(node) in QUANTILED:
            self.found.append((path, node, 0))
        elif in_region := _coordinates(node):
            self.found += [(f'{path}.{name}' if path else '', node, part)
                           for part, name in enumerate(in_region)]
        elif _draws(node):
            self.others.append(f'{path} ({_kind_words(node)})')
        for child_path, child in self._children(node, path):
            self.visit(child, child_path)

    def _is_mixture(self, node: Any) -> bool:
        """Whether these are Options of plain ranges that nothing else refers to."""
        return type(node) is Options and all(
            self.uses[id(part)] == 1 and buckets_of(part._conditioned) is None
            and (part is node.index or is_fixed_range(part._conditioned))
            for part in node._dependencies
        ) and len(node._dependencies) == 1 + len(node.options)

    def _children(self, node: Any, path: str) -> Iterable[tuple[str, Any]]:
        if isinstance(node, Constructible):
            return _properties(node, path)
        if isinstance(node, Vector):
            return zip((f'{path}.{axis}' for axis in 'xyz'), node.coordinates, strict=True)
        if isinstance(node, MultiplexerDistribution):
            return self._branches(node, path)
        if isinstance(node, TupleDistribution):
            names = self.coordinates.get(id(node), {})
            return [
                (f'{path}.{names[number]}' if number in names else f'{path}[{number}]', part)
                for number, part in enumerate(node.coordinates)
            ]
        if isinstance(node, UniformDistribution):
            return [*((path, option) for option in node.options), (path, node.selector)]
        if type(node) in QUANTILED:
            return [(f'{path}.{part}', vars(node)[part]) for part in _PARTS if part in vars(node)]
        return [(path, child) for child in node._dependencies]

    def _branches(self, node: Any, path: str) -> Iterator[tuple[str, Any]]:
        self.selects[id(node.index._conditioned)] = node.options
        yield path, node.index
        for number, option in enumerate(node.options):
            self.coordinates.setdefault(id(option), self.coordinates.get(id(node), {}))
            yield f'{path}[{number}]', option


def _coordinates(node: Any) -> tuple[str, ...]:
    """Names of the quantiles of a point in a region; empty for all else."""
    return coordinates(node.region) if type(node) is PointInRegionDistribution else ()


def _kind_words(node: Any) -> str:
    if isinstance(node, PointInRegionDistribution):
        return f'a point in {type(node.region._conditioned).__name__}'
    return 'mutated' if isinstance(node, Constructible) else type(node).__name__


def is_fixed_range(node: Any) -> bool:
    """Whether this is a uniform choice of a real number between two given ones."""
    return type(node) is Range and not (needsSampling(node.low) or needsSampling(node.high))


def _draws(node: Any) -> bool:
    """Whether a node throws dice of its own."""
    if isinstance(node, Constructible):
        scale = getattr(node, 'mutationScale', 0)
        return needsSampling(scale) or scale != 0
    computed = getattr(type(node), '_deterministic', True) or isinstance(node, _COMPUTED)
    return isinstance(node, Distribution) and not computed


def _properties(thing: Any, path: str) -> list[tuple[str, Any]]:
    rest = sorted(set(thing.properties) - set(_SHOWN_FIRST))
    names = [name for name in (*_SHOWN_FIRST, *rest) if name in thing.properties]
    return [(f'{path}.{name}', getattr(thing, name)) for name in names]


def _roots(scenario: Any) -> Iterator[tuple[str, Any]]:
    """Where choices enter a scene, in an order that does not change from process to process."""
    yield from of_scenario(scenario.params).items()
    if scenario.egoObject is not None:
        yield 'ego', scenario.egoObject
    for number, thing in enumerate(scenario._instances):
        yield f'object{number}', thing
    # Scenic keeps what its requirements depend on in a set, hence without an order.
    needed = _below(scenario.dependencies)
    for name, value in _variables(scenario).items():
        if id(value) in needed:
            yield name, value
    for value in scenario.dependencies:
        yield '', value


def _variables(scenario: Any) -> dict[str, Any]:
    names = scenario.dynamicScenario._dummyNamespace or {}
    return {
        name: value for name, value in names.items()
        if not name.startswith('_') and isinstance(value, (Distribution, Constructible))
    }


def _labels(scenario: Any) -> dict[int, str]:
    labels: dict[int, str] = {}
    named = itertools.chain(
        of_scenario(scenario.params).items(), [('ego', scenario.egoObject)],
        _variables(scenario).items(),
    )
    for name, value in named:
        labels.setdefault(id(value), name)
    return labels


def _coordinate_names(params: dict[str, Any]) -> dict[int, dict[int, str]]:
    """After ``param rain = weather[1]``, the second coordinate of ``weather`` is called rain."""
    names: dict[int, dict[int, str]] = {}
    for name, value in params.items():
        if isinstance(value, OperatorDistribution) and value.operator == '__getitem__':
            (number,) = value.operands
            if isinstance(number, int):
                names.setdefault(id(value.object), {}).setdefault(number, name)
    return names


def _entries(scenario: Any) -> dict[str, list[Any]]:
    """What each key of the scenario is drawn as, and what decides whether a scene is accepted."""
    entries = {key: [value] for key, value in of_scenario(scenario.params).items()}
    for key, name in EGO_VALUES.items():
        # An ego of another class is reported when its scene is drawn.
        entries[key] = [vars(scenario.egoObject or object).get(name)]
    judged = [value for req in scenario.userRequirements for value in req.dependencies]
    if len(scenario.objects) > 1:  # they may be in each other's way
        judged += scenario.objects
    return {**entries, REQUIREMENTS: judged}


def _branches_to(entries: Iterable[Any]) -> dict[int, frozenset[tuple[int, int]]]:
    """By identity of what is drawn: the selectors and options by which alone it has an effect.

    A value that an option is made of is drawn whichever option is taken, and then without effect;
    but for other ways there, which need not lead through options.
    """
    always = (0, 0)  # no object has this identity
    ways: dict[int, set[tuple[int, int]]] = {}
    waiting = [(value, always) for value in entries if needsSampling(value)]
    while waiting:
        value, way = waiting.pop()
        node = value._conditioned
        known = ways.setdefault(id(node), set())
        if way in known or always in known:
            continue
        known.add(way)
        options = node.options if isinstance(node, MultiplexerDistribution) else ()
        if options:
            selector = id(node.index._conditioned)
            waiting += [(option, (selector, number)) for number, option in enumerate(options)
                        if needsSampling(option)]
        waiting += [(part, way) for part in node._dependencies
                    if not any(part is option for option in options)]
    return {key: frozenset(known) for key, known in ways.items() if always not in known}


def _below(values: Iterable[Any]) -> set[int]:
    """Identities of all that the values are drawn from, themselves included."""
    return set(_uses(values))


def _uses(values: Iterable[Any]) -> Counter[int]:
    """How often each of the values, and of all that they are drawn from, is referred to."""
    uses: Counter[int] = Counter()
    waiting = [value for value in values if needsSampling(value)]
    while waiting:
        value = waiting.pop()
        uses[id(value)] += 1
        if uses[id(value)] == 1:
            uses[id(value._conditioned)] = max(uses[id(value._conditioned)], 1)
            waiting += value._conditioned._dependencies
    return uses


def _unique(found: list[tuple[str, Any, int]]) -> Iterator[tuple[str, Any, int]]:
    taken: set[str] = set()
    for path, node, part in found:
        # Several choices in one expression share its name: x, x.2; range1 where there is none.
        later = (f'{path}.{number}' for number in itertools.count(2))
        nameless = (f'{type(node).__name__.lower()}{number}' for number in itertools.count(1))
        tries = itertools.chain([path], later) if path else nameless
        name = next(name for name in tries if name not in taken)
        taken.add(name)
        yield name, node, part
