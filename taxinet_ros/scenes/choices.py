"""Find and name the random choices of a compiled Scenic scenario, and set their quantiles.

A name is the parameter or variable that holds the choice, or else the object property that it
feeds, and the path from there: ``time_of_day_h``, ``weather``, ``weather[1].rain_percent``,
``ego.position.x``, ``ego.heading``. Names and order depend on the program's text alone. Each
choice takes the value at a quantile of its own prior, by the inverse distribution function.

Only the Scenic child may import this module.
"""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from statistics import NormalDist
from typing import Any

from scenic.core import requirements
from scenic.core.distributions import (
    DiscreteRange,
    Distribution,
    MultiplexerDistribution,
    Normal,
    OperatorDistribution,
    Options,
    Range,
    RejectionException,
    Samplable,
    TruncatedNormal,
    TupleDistribution,
    UniformDistribution,
    needsSampling,
    supportInterval,
)
from scenic.core.dynamics import scenarios
from scenic.core.object_types import Constructible
from scenic.core.regions import PointInRegionDistribution
from scenic.core.vectors import Vector, VectorMethodDistribution, VectorOperatorDistribution

from taxinet_ros.samplers.space import Branch, Dimension
from taxinet_ros.scenes.regions import coordinates, ends, point_at
from taxinet_ros.scenes.values import (
    PLANE_KEYS,
    TRAFFIC_KEY,
    is_ground_object,
    plane_property,
    scenario_parameters,
)
from taxinet_ros.scenes.verifai_choices import (
    buckets_of,
    check_reach,
    default_buckets,
    pieces_of,
    place_of,
)

QUANTILED = (Range, Normal, TruncatedNormal, DiscreteRange)
"""Choices with a known inverse distribution function, excluding subclasses.

``Options`` of ranges with fixed ends have one too: they count as one real-valued choice.
"""
REQUIREMENTS = 'requirements'
"""Pseudo-key for choices that only decide whether a scene is accepted."""
_SHOWN_FIRST = ('position', 'heading')
_PARTS = ('low', 'high', 'mean', 'stddev')
_COMPUTED = (VectorMethodDistribution, VectorOperatorDistribution)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Found:
    """One random choice.

    Attributes:
        name: unique among those found.
        node: the Scenic distribution.
        options: the options of a selector, in order; None if it is no selector.
        part: index of the quantile, if one draw takes several, as a point in a region does.
        feeds: parameters and keys of the scenario that depend on it, and :data:`REQUIREMENTS`.
        when: identities of the selectors that gate it, each with the number of the option that it
            is part of; empty if it is always in effect.
    """

    name: str
    node: Any
    options: tuple[Any, ...] | None
    feeds: frozenset[str]
    when: frozenset[tuple[int, int]] = frozenset()
    part: int = 0


class _Ordered(dict[Any, None]):
    """A set that keeps the order in which its members were added."""

    def add(self, member: Any) -> None:
        self[member] = None

    def update(self, members: Iterable[Any]) -> None:  # type: ignore[override]  # as of a set
        super().update(dict.fromkeys(members))


_NUMBER = '_taxinet_number'
_numbers = itertools.count(1 << 40)  # no hash of the small numbers that options are


def _number(value: Any) -> int:
    """The number of a random value or object, in the order in which they are asked for theirs."""
    kept = value.__dict__.get(_NUMBER)
    if kept is None or kept[0] != id(value):  # a copy has that of its original
        kept = value.__dict__[_NUMBER] = id(value), next(_numbers)
    return int(kept[1])


def keep_order() -> None:
    """Make Scenic draw what requirements depend on in the order in which they name it.

    The order of its sets depends on addresses: it would give other scenes in each process. So would
    that of a program's own sets, whose members get numbers as hashes.
    """
    for module in (requirements, scenarios):
        module.set = _Ordered
    for kind in (Samplable, Distribution):
        kind.__hash__ = _number


def find_choices(scenario: Any) -> tuple[list[Found], list[str]]:
    """The choices that have quantiles, and the names of other random values."""
    walk = _Walk(
        labels=_labels(scenario), coordinates=_coordinate_names(scenario.params),
        uses=_uses(scenario.dependencies),
    )
    for path, root in _roots(scenario):
        walk.visit(root, path)
    for name, value in _namespace(scenario):
        walk.labels.setdefault(id(value), name)
    for path, root in _required(scenario):
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
    """Parameters and keys of the scenario whose values vary between scenes."""
    ego = scenario.egoObject
    moved = set(PLANE_KEYS) if isinstance(ego, Constructible) and _draws(ego) else set()
    return sorted(moved | {
        key for key, values in _entries(scenario).items()
        if key != REQUIREMENTS and any(needsSampling(value) for value in values)
    })


@dataclass(kw_only=True, slots=True)
class _Walk:
    """Depth-first traversal that visits every node once."""

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
        node = value._conditioned  # what Scenic samples instead
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
        """Whether the node is an Options of plain ranges that nothing else refers to."""
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
        if isinstance(node, scenarios.LocalsSnapshot):
            return list(node._locs.items())
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
    """Names of the quantiles of a point in a region; empty for other nodes."""
    return coordinates(node.region) if type(node) is PointInRegionDistribution else ()


def _kind_words(node: Any) -> str:
    if isinstance(node, PointInRegionDistribution):
        return f'a point in {type(node.region._conditioned).__name__}'
    return 'mutated' if isinstance(node, Constructible) else type(node).__name__


def is_fixed_range(node: Any) -> bool:
    """Whether the node is a uniform real number between two constants."""
    return type(node) is Range and not (needsSampling(node.low) or needsSampling(node.high))


def _draws(node: Any) -> bool:
    """Whether a node draws random numbers itself."""
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
    """Roots of the choices that a scene shows."""
    yield from scenario_parameters(scenario.params).items()
    if scenario.egoObject is not None:
        yield 'ego', scenario.egoObject
    for number, thing in enumerate(scenario._instances):
        yield f'object{number}', thing


def _required(scenario: Any) -> Iterator[tuple[str, Any]]:
    """Roots of the choices that only requirements read."""
    needed = _below(scenario.dependencies)
    for name, value in itertools.chain(_variables(scenario).items(), _bound(scenario)):
        if id(value) in needed:
            yield name, value
    for value in scenario.dependencies:
        yield '', value


def _bound(scenario: Any) -> Iterator[tuple[str, Any]]:
    """What requirements read, by the names that it has where each is written."""
    for requirement in scenario.userRequirements:
        kept = inspect.getclosurevars(requirement.closure).nonlocals
        variables, cells = kept['globalBindings'], kept['cells']
        readers = [atom.closure for atom in kept['condition'].atomics()]
        readers += filter(inspect.isfunction, [*variables.values(), *(value for _, value in cells)])
        names = {id(cell): name for one in readers if one.__closure__
                 for name, cell in zip(one.__code__.co_freevars, one.__closure__, strict=True)}
        yield from variables.items()
        yield from ((names.get(id(cell), ''), value) for cell, value in cells)


def _namespace(scenario: Any) -> list[tuple[str, Any]]:
    names = scenario.dynamicScenario._dummyNamespace or {}
    return [(name, value) for name, value in names.items() if not name.startswith('_')]


def _variables(scenario: Any) -> dict[str, Any]:
    return {name: value for name, value in _namespace(scenario)
            if isinstance(value, (Distribution, Constructible))}


def _labels(scenario: Any) -> dict[int, str]:
    labels: dict[int, str] = {}
    named = itertools.chain(
        scenario_parameters(scenario.params).items(), [('ego', scenario.egoObject)],
        _variables(scenario).items(),
    )
    for name, value in named:
        labels.setdefault(id(value), name)
    return labels


def _coordinate_names(params: dict[str, Any]) -> dict[int, dict[int, str]]:
    """Names of coordinates: ``param rain_percent = weather[1]`` names that one of ``weather``."""
    names: dict[int, dict[int, str]] = {}
    for name, value in params.items():
        if isinstance(value, OperatorDistribution) and value.operator == '__getitem__':
            (number,) = value.operands
            if isinstance(number, int):
                names.setdefault(id(value.object), {}).setdefault(number, name)
    return names


def _entries(scenario: Any) -> dict[str, list[Any]]:
    """Random values behind each parameter and key, and those that decide acceptance."""
    entries = {name: [value] for name, value in scenario_parameters(scenario.params).items()}
    for key in PLANE_KEYS:
        # A wrong class of ego is reported when its scene is drawn.
        entries[key] = [plane_property(scenario.egoObject, key)]
    if others := [thing for thing in scenario.objects if is_ground_object(thing)]:
        entries[TRAFFIC_KEY] = others
    judged = [value for req in scenario.userRequirements for value in req.dependencies]
    colliding = [thing for thing in scenario.objects if thing.allowCollisions is not True]
    if len(colliding) > 1:  # Scenic refuses scenes in which they overlap
        judged += colliding
    return {**entries, REQUIREMENTS: judged}


def _branches_to(entries: Iterable[Any]) -> dict[int, frozenset[tuple[int, int]]]:
    """Selectors and options that gate each random value, by the value's identity.

    A value that feeds an option is drawn whichever option is selected, but has no effect unless
    that option is selected or another path leads to it.
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
    """Identities of the values and of all their dependencies."""
    return set(_uses(values))


def _uses(values: Iterable[Any]) -> Counter[int]:
    """Number of references to each of the values and of their dependencies."""
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
        # Several choices in one expression share its name: x, x.2; unnamed ones: range1.
        later = (f'{path}.{number}' for number in itertools.count(2))
        nameless = (f'{type(node).__name__.lower()}{number}' for number in itertools.count(1))
        tries = itertools.chain([path], later) if path else nameless
        name = next(name for name in tries if name not in taken)
        taken.add(name)
        yield name, node, part


MAX_CATEGORIES = 100
"""Integer ranges with more values than this become a continuous dimension."""
_STANDARD = NormalDist()
_SHOWN_SIGMAS = 4.0
"""Displayed range of an unbounded normal, on either side of its mean [sigma]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Choice:
    """A found choice and its dimension."""

    found: Found
    dimension: Dimension

    def describe(self) -> dict[str, Any]:
        """Description for the parent process, as JSON values."""
        node = self.found.node
        return {
            'dimension': dataclasses.asdict(self.dimension), 'feeds': sorted(self.found.feeds),
            'place': place_of(node.index if type(node) is Options else node),
            'pieces': self._pieces(), 'options': _constants(self),
            'law': None if self._pieces() or self.dimension.discrete else _law(node),
        }


    def _pieces(self) -> list[list[float]]:
        low, high = self.dimension.low, self.dimension.high
        if isinstance(self.found.node, PointInRegionDistribution):
            return [] if math.isnan(low) else [[0.0, 1.0, low, high]]
        return _pieces(self.found.node)


class Choices:
    """The searchable choices of a scenario, and the names of the others."""

    def __init__(self, scenario: Any) -> None:
        """Find the choices; if any is marked for search, the unmarked ones keep their prior."""
        found, others = find_choices(scenario)
        marked = any(buckets_of(choice.node) is not None for choice in found)
        searched: list[Found] = []
        self._unsearched = others
        for choice in found:
            if not choice.feeds:
                self._unsearched.append(f'{choice.name} (without effect)')
            elif marked and buckets_of(choice.node) is None:
                self._unsearched.append(f'{choice.name} (not marked for search)')
            else:
                searched.append(choice)
        self._choices = _conditional(searched, found)
        self._drawn = random_keys(scenario)
        self._soft = any(requirement.prob < 1 for requirement in scenario.userRequirements)

    def describe(self) -> dict[str, Any]:
        """The search space as JSON values."""
        return {
            'choices': [choice.describe() for choice in self._choices],
            'unsearched': self._unsearched, 'drawn': self._drawn, 'soft': self._soft,
        }

    @contextlib.contextmanager
    def placed(self, point: Sequence[float | None]) -> Iterator[None]:
        """Context in which each choice with a quantile in ``point`` takes the value there.

        The others are drawn as usual. The compiled scenario is restored on exit.
        """
        placed: dict[int, tuple[Choice, list[float]]] = {}
        for choice, quantile in zip(self._choices, point, strict=True):
            if quantile is not None:
                # The quantiles of a point in a region are consecutive.
                placed.setdefault(id(choice.found.node), (choice, []))[1].append(quantile)
        for choice, quantiles in placed.values():
            choice.found.node.sampleGiven = partial(_value, choice, quantiles)
        try:
            yield
        finally:
            for choice, _ in placed.values():
                del choice.found.node.sampleGiven


def _conditional(searched: Sequence[Found], found: Sequence[Found]) -> list[Choice]:
    """The choices as dimensions, each after those that gate it.

    If an unsearched choice gates it, the dimension counts as active wherever it may be: its
    quantile then has no effect in some of the scenes.
    """
    by_node = {id(choice.node): choice for choice in found}
    selectors = {id(choice.node): choice.name for choice in searched if choice.options is not None}
    order = {choice.name: number for number, choice in enumerate(searched)}

    def branches(choice: Found) -> dict[str, set[int]]:
        """Gating categories by name of the dimension; empty if always active."""
        merged: dict[str, set[int]] = {}
        for selector, number in choice.when:
            if selector in selectors:
                ways = {selectors[selector]: {number}}
            else:
                ways = branches(by_node[selector]) if selector in by_node else {}
                if not ways:
                    return {}
            for name, numbers in ways.items():
                merged.setdefault(name, set()).update(numbers)
        return merged

    choices: dict[str, Choice] = {}

    def add(choice: Found) -> None:
        when = branches(choice)
        for parent in sorted(when, key=order.__getitem__):
            add(searched[order[parent]])
        ways = tuple(Branch(name, tuple(sorted(when[name])))
                     for name in sorted(when, key=order.__getitem__))
        dimension = dataclasses.replace(_dimension(choice), when=ways)
        choices.setdefault(choice.name, Choice(found=choice, dimension=dimension))

    for choice in searched:
        add(choice)
    return list(choices.values())


def _dimension(found: Found) -> Dimension:
    node = found.node
    buckets = buckets_of(node) or default_buckets()
    weights = _weights(node)
    if found.options is not None and not weights:
        weights = (1.0,) * len(found.options)
    low, high = (ends(node.region, found.part) if isinstance(node, PointInRegionDistribution)
                 else _shown_range(node))
    return Dimension(name=found.name, weights=weights, low=low, high=high, buckets=buckets)


def _weights(node: Any) -> tuple[float, ...]:
    if type(node) is not DiscreteRange or needsSampling(node.low) or needsSampling(node.high):
        return ()
    if node.weights:
        return tuple(float(weight) for weight in node.weights)
    number = math.floor(node.high) - math.ceil(node.low) + 1
    return (1.0,) * number if 0 < number <= MAX_CATEGORIES else ()


def _shown_range(node: Any) -> tuple[float, float]:
    if pieces := _pieces(node):
        return pieces[0][2], pieces[-1][3]
    if type(node) is Normal:
        ends = [_ends(node.mean, side) + side * _SHOWN_SIGMAS * _ends(node.stddev, 1)
                for side in (-1, 1)]
    else:
        ends = [_ends(node.low, -1), _ends(node.high, 1)]
    return ends[0], ends[1]


def _ends(value: Any, side: int) -> float:
    """Lower (-1) or upper (1) bound of a constant or random value; NaN if unknown."""
    end = supportInterval(value)[0 if side < 0 else 1]
    return math.nan if end is None else float(end)


def _pieces(node: Any) -> list[list[float]]:
    """Linear pieces of the inverse distribution function: quantiles from, to; values from, to.

    Empty if it is not piecewise linear, or depends on other choices.
    """
    if type(node) is Options:
        return _mixture_pieces(node)
    if is_fixed_range(node):
        return pieces_of(node) or [[0.0, 1.0, float(node.low), float(node.high)]]
    return []


def _mixture_pieces(node: Any) -> list[list[float]]:
    """Pieces of an Options of ranges, sorted so that values increase with the quantile."""
    weights = _weights(node.index)
    parts = sorted(
        (float(part._conditioned.low), float(part._conditioned.high), weight)
        for part, weight in zip(node.options, weights, strict=True)
    )
    edges = Dimension(name='', weights=tuple(weight for *_, weight in parts)).edges
    return [
        [*quantiles, low, high]
        for quantiles, (low, high, _) in zip(itertools.pairwise(edges), parts, strict=True)
    ]


def _law(node: Any) -> dict[str, Any] | None:
    """Kind and constants of a distribution of numbers, for the parent."""
    if type(node) not in _INVERSES or type(node) is Options:
        return None
    parts = {part: vars(node)[part] for part in ('mean', 'stddev', 'low', 'high')
             if part in vars(node)}
    return {
        'kind': type(node).__name__,
        **{part: None if needsSampling(value) or math.isinf(value) else float(value)
           for part, value in parts.items()},
    }


def _constants(choice: Choice) -> list[Any] | None:
    """The options of a discrete choice, if all are plain values."""
    if not choice.dimension.discrete:
        return None
    options = choice.found.options
    if options is None:
        first = math.ceil(choice.found.node.low)
        return list(range(first, first + len(choice.dimension.weights)))
    plain = all(isinstance(option, (bool, int, float, str)) for option in options)
    return list(options) if plain else None


def _value(choice: Choice, quantiles: Sequence[float], given: Mapping[Any, Any]) -> Any:
    """Replacement for ``sampleGiven``: the value at a quantile, ``given`` its dependencies."""
    node = choice.found.node
    if isinstance(node, PointInRegionDistribution):
        return point_at(given[node.region], quantiles)
    (quantile,) = quantiles
    if choice.dimension.discrete:
        return math.ceil(given[node.low]) + choice.dimension.bin(quantile)
    return _INVERSES[type(node)](node, quantile, given)


def _range(node: Any, quantile: float, given: Mapping[Any, Any]) -> float:
    low, high = given[node.low], given[node.high]
    return low + (high - low) * quantile


def _mixture(node: Any, quantile: float, given: Mapping[Any, Any]) -> float:
    pieces = _mixture_pieces(node)
    start, end, low, high = next(piece for piece in pieces if quantile < piece[1])
    return low + (high - low) * (quantile - start) / (end - start)


def _whole_number(node: Any, quantile: float, given: Mapping[Any, Any]) -> int:
    low, high = math.ceil(given[node.low]), math.floor(given[node.high])
    if high < low:
        raise RejectionException(node.emptyMessage)
    return min(low + int(quantile * (high - low + 1)), high)


def _normal(node: Any, quantile: float, given: Mapping[Any, Any]) -> float:
    return given[node.mean] + given[node.stddev] * _sigmas(quantile)


def _truncated(node: Any, quantile: float, given: Mapping[Any, Any]) -> float:
    mean, stddev = given[node.mean], given[node.stddev]
    check_reach(mean, stddev, node.low, node.high)
    below, above = (_STANDARD.cdf((end - mean) / stddev) for end in (node.low, node.high))
    value = mean + stddev * _sigmas(below + quantile * (above - below))
    return min(max(value, node.low), node.high)


def _sigmas(quantile: float) -> float:
    # A point may have quantile 0, where a normal has no finite value.
    return _STANDARD.inv_cdf(min(max(quantile, 2.0**-54), 1 - 2.0**-53))

_INVERSES: dict[type, Callable[[Any, float, Mapping[Any, Any]], float]] = {
    Range: _range, Options: _mixture, DiscreteRange: _whole_number, Normal: _normal,
    TruncatedNormal: _truncated,
}
