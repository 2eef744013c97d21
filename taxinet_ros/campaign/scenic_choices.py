"""The random choices of a compiled Scenic scenario as a search space, and scenes at its points.

Each choice takes the value at a quantile of its own prior, by the inverse distribution function.
Only the Scenic child may import this module.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import NormalDist
from typing import Any

from scenic.core.distributions import (
    DiscreteRange,
    Normal,
    Options,
    Range,
    RejectionException,
    TruncatedNormal,
    needsSampling,
    supportInterval,
)
from scenic.core.regions import PointInRegionDistribution

from taxinet_ros.campaign.samplers.space import Branch, Dimension
from taxinet_ros.campaign.scenic_regions import ends, point_at
from taxinet_ros.campaign.scenic_walk import Found, find_choices, is_fixed_range, random_keys
from taxinet_ros.campaign.search_words import buckets_of, pieces_of, place_of

MAX_CATEGORIES = 100
"""More whole numbers than this are a continuous dimension."""

_STANDARD = NormalDist()
_SHOWN_SIGMAS = 4.0
"""A normal's shown range, either side of its mean; it has no ends."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Choice:
    """A choice found, and the dimension that it is."""

    found: Found
    dimension: Dimension

    def describe(self) -> dict[str, Any]:
        """What the parent needs to know, for JSON."""
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
    """The choices of one scenario that a sampler may make, and the names of the others."""

    def __init__(self, scenario: Any) -> None:
        """If any choice is marked for search, the unmarked ones stay with the prior."""
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
        """The search space, for JSON."""
        return {
            'choices': [choice.describe() for choice in self._choices],
            'unsearched': self._unsearched, 'drawn': self._drawn, 'soft': self._soft,
        }

    @contextlib.contextmanager
    def placed(self, point: Sequence[float | None]) -> Iterator[None]:
        """While this lasts, each choice with a quantile in ``point`` takes the value there.

        The others draw as ever. What Scenic compiled is left as it was found.
        """
        placed: dict[int, tuple[Choice, list[float]]] = {}
        for choice, quantile in zip(self._choices, point, strict=True):
            if quantile is not None:
                # The quantiles of a point in a region come one after the other.
                placed.setdefault(id(choice.found.node), (choice, []))[1].append(quantile)
        for choice, quantiles in placed.values():
            choice.found.node.sampleGiven = partial(_value, choice, quantiles)
        try:
            yield
        finally:
            for choice, _ in placed.values():
                del choice.found.node.sampleGiven


def _conditional(searched: Sequence[Found], found: Sequence[Found]) -> list[Choice]:
    """The choices as dimensions, each after those that decide whether it is made.

    Where a choice that nobody searches decides it, the dimension counts as active throughout what
    may be: its quantile then does nothing in some of the scenes.
    """
    by_node = {id(choice.node): choice for choice in found}
    selectors = {id(choice.node): choice.name for choice in searched if choice.options is not None}
    order = {choice.name: number for number, choice in enumerate(searched)}

    def branches(choice: Found) -> dict[str, set[int]]:
        """Deciding categories by name of the dimension; empty for always."""
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
    buckets = buckets_of(node) or Dimension(name='').buckets
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
    """The least (-1) or greatest (1) that a constant or random value can be; NaN if not known."""
    end = supportInterval(value)[0 if side < 0 else 1]
    return math.nan if end is None else float(end)


def _pieces(node: Any) -> list[list[float]]:
    """Where the value runs straight with the quantile: quantiles from, to; values from, to.

    Empty for whatever is not made of such pieces, or depends on other choices.
    """
    if type(node) is Options:
        return _mixture_pieces(node)
    if is_fixed_range(node):
        return pieces_of(node) or [[0.0, 1.0, float(node.low), float(node.high)]]
    return []


def _mixture_pieces(node: Any) -> list[list[float]]:
    """Those of Options of ranges, from left to right, so that values grow with the quantile."""
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
    """What a discrete choice selects among, if those are all plain values."""
    if not choice.dimension.discrete:
        return None
    options = choice.found.options
    if options is None:
        first = math.ceil(choice.found.node.low)
        return list(range(first, first + len(choice.dimension.weights)))
    plain = all(isinstance(option, (bool, int, float, str)) for option in options)
    return list(options) if plain else None


def _value(choice: Choice, quantiles: Sequence[float], given: Mapping[Any, Any]) -> Any:
    """What stands in for ``sampleGiven``: the value at a quantile, ``given`` what it rests on."""
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
    below, above = (_STANDARD.cdf((end - mean) / stddev) for end in (node.low, node.high))
    value = mean + stddev * _sigmas(below + quantile * (above - below))
    return min(max(value, node.low), node.high)


def _sigmas(quantile: float) -> float:
    # Quantile 0 is a possible coordinate of a point; a normal has no value there.
    return _STANDARD.inv_cdf(min(max(quantile, 2.0**-54), 1 - 2.0**-53))


_INVERSES: dict[type, Callable[[Any, float, Mapping[Any, Any]], float]] = {
    Range: _range, Options: _mixture, DiscreteRange: _whole_number, Normal: _normal,
    TruncatedNormal: _truncated,
}
