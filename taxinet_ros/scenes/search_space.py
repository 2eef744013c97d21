"""The search space of a program: the random choices that a sampler controls."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import Any, NamedTuple, Self

from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import typed
from taxinet_ros.samplers.space import Dimension, Point, Space, make_space


class Place(NamedTuple):
    """The call that makes a choice, in the program's text.

    Attributes:
        file: path of the text.
        line, end_line: first and last line, from 1.
        column, end_column: start and end within them, in characters from 0.
    """

    file: str
    line: int
    column: int
    end_line: int
    end_column: int


class Piece(NamedTuple):
    """An interval of quantiles over which a choice's value is linear.

    Attributes:
        start, end: the quantiles.
        low, high: the values there.
    """

    start: float
    end: float
    low: float
    high: float

    def length_within(self, start: float, end: float, low: float, high: float) -> float:
        """Length of the quantiles in [start, end] whose value is in [low, high]."""
        if self.high == self.low:
            first, last = (self.start, self.end) if low <= self.low <= high else (0.0, 0.0)
        else:
            ends = [
                self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)
                for value in (low, high)
            ]
            first, last = max(self.start, min(ends)), min(self.end, max(ends))
        return max(0.0, min(last, end) - max(first, start))


@dataclass(frozen=True, kw_only=True, slots=True)
class Law:
    """A distribution that is not linear in the quantile, or has no fixed ends.

    Attributes:
        kind: Scenic class: ``Normal``, ``TruncatedNormal``, ``Range`` or ``DiscreteRange``.
        mean, stddev: parameters of a normal; None if they are random themselves.
        low, high: its ends; None if they are random themselves or do not exist.
    """

    kind: str
    mean: float | None = None
    stddev: float | None = None
    low: float | None = None
    high: float | None = None

    def values(self, quantiles: Sequence[float]) -> list[float] | None:
        """Values of a normal distribution at quantiles 0 … 1; None if unknown."""
        if self.mean is None or self.stddev is None:
            return None
        mean, stddev = self.mean, self.stddev
        low = -math.inf if self.low is None else self.low
        high = math.inf if self.high is None else self.high
        ends = (low - mean) / stddev, (high - mean) / stddev
        return [mean + stddev * sigmas for sigmas in standard_values(quantiles, *ends)]


def standard_values(
    quantiles: Sequence[float], low: float = -math.inf, high: float = math.inf
) -> list[float]:
    """Values of the standard normal distribution between two ends."""
    unit = NormalDist()
    below, above = unit.cdf(low), unit.cdf(high)
    values = []
    for quantile in quantiles:
        share = below + quantile * (above - below)
        inner = unit.inv_cdf(share) if 0 < share < 1 else low if share <= 0 else high
        values.append(low if quantile <= 0 else high if quantile >= 1 else inner)
    return values


@dataclass(frozen=True, kw_only=True, slots=True)
class Choice:
    """One random choice of a program.

    Attributes:
        dimension: the sampler's dimension of the choice.
        feeds: scenario keys that depend on it, and ``requirements`` if a scene's acceptance does.
        place: its call in the program; None if unknown.
        pieces: its inverse distribution function if piecewise linear, else empty.
        options: the options of a discrete choice if they are plain values, else empty.
        law: its distribution if numeric and not piecewise linear.
    """

    dimension: Dimension
    feeds: frozenset[str] = frozenset()
    place: Place | None = None
    pieces: tuple[Piece, ...] = ()
    options: tuple[Any, ...] = ()
    law: Law | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values, for :func:`.plain_values.typed` if the options are plain."""
        return {**dataclasses.asdict(self), 'feeds': sorted(self.feeds)}

    def value(self, quantile: float) -> float | None:
        """The value at a quantile; None if unknown."""
        for piece in self.pieces:
            if piece.start <= quantile <= piece.end and piece.end > piece.start:
                share = (quantile - piece.start) / (piece.end - piece.start)
                return piece.low + share * (piece.high - piece.low)
        values = None if self.law is None else self.law.values([quantile])
        return values[0] if values else None

    def probability_within(
        self, low: float, high: float, probabilities: Sequence[float] = ()
    ) -> float:
        """Probability of a value in [low, high].

        Args:
            low: lower limit in the program's own units.
            high: upper limit.
            probabilities: probabilities of its bins; the program's own if empty. Within a bin the
                program's distribution applies.

        Raises:
            UsageError: the choice has no comparable values.
        """
        if not self.pieces:
            raise UsageError(f'{self.dimension.name}: has no values between which to ask')
        dimension, total = self.dimension, 0.0
        bins = zip(probabilities or dimension.prior, pairwise(dimension.edges), strict=True)
        for probability, (start, end) in bins:
            within = sum(piece.length_within(start, end, low, high) for piece in self.pieces)
            total += probability * within / (end - start)
        return total


@dataclass(frozen=True, kw_only=True, slots=True)
class SearchSpace:
    """The choices of a program that a sampler controls, and those that it does not.

    Attributes:
        choices: all choices with quantiles, in program order.
        fixed: names of the choices that overrides make ineffective.
        unsearched: names of other random values, each with the reason.
        drawn: scenario keys that vary between scenes.
        soft: whether any requirement must hold only in a share of the scenes.
    """

    choices: tuple[Choice, ...]
    fixed: frozenset[str] = frozenset()
    unsearched: tuple[str, ...] = ()
    drawn: frozenset[str] = frozenset()
    soft: bool = False

    @classmethod
    def from_json(cls, answer: Mapping[str, Any], overridden: Collection[str] = ()) -> Self:
        """The space described by the Scenic child, without choices that ``overridden`` keys fix."""
        choices = [typed(Choice, {**one, 'options': one['options'] or ()})
                   for one in answer['choices']]
        fixed = frozenset(
            choice.dimension.name for choice in choices if choice.feeds <= set(overridden)
        )
        unsearched = (*answer['unsearched'], *(f'{name} (overridden)' for name in sorted(fixed)))
        return cls(
            choices=tuple(_without_branches(choice, fixed) for choice in choices), fixed=fixed,
            unsearched=unsearched, drawn=frozenset(answer['drawn']) - set(overridden),
            soft=answer['soft'],
        )

    @property
    def searched(self) -> tuple[Choice, ...]:
        """The choices that a sampler controls, one per coordinate of a point."""
        return tuple(
            choice for choice in self.choices if choice.dimension.name not in self.fixed
        )

    @property
    def dimensions(self) -> Space:
        """The sampler's space; empty if no random value can be searched.

        Raises:
            UsageError: the program draws nothing.
        """
        dimensions = [choice.dimension for choice in self.searched]
        return Space(dimensions) if self.drawn else make_space(dimensions)

    def spread(self, point: Point) -> list[float | None]:
        """The point for the Scenic child, with None for the choices that are not searched.

        Raises:
            ValueError: it lacks a quantile in [0, 1) for an active dimension.
        """
        self.dimensions.check(point)
        rest = iter(point)
        return [
            None if choice.dimension.name in self.fixed else next(rest)
            for choice in self.choices
        ]

    def named(self, point: Point) -> dict[str, float]:
        """The coordinates of a point by the names of its dimensions, idle ones left out."""
        return {
            choice.dimension.name: quantile
            for choice, quantile in zip(self.searched, point, strict=True) if quantile is not None
        }


def _without_branches(choice: Choice, fixed: Collection[str]) -> Choice:
    """The choice without branches of choices that overrides make ineffective.

    Its effect through such a branch is lost too, so without another branch it is fixed itself.
    """
    dimension = choice.dimension
    when = tuple(branch for branch in dimension.when if branch.parent not in fixed)
    return dataclasses.replace(choice, dimension=dataclasses.replace(dimension, when=when))
