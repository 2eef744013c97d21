"""The search space of a program: which of its random choices a sampler may make."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from taxinet_ros.campaign.samplers.space import Dimension, Space, make_space


@dataclass(frozen=True, kw_only=True, slots=True)
class Place:
    """The call that makes a choice, in the program's text.

    Attributes:
        file: path of the text.
        line, end_line: first and last line, from 1.
        column, end_column: where in them it starts and ends, in characters from 0.
    """

    file: str
    line: int
    column: int
    end_line: int
    end_column: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Piece:
    """A stretch of quantiles over which a choice's value runs straight.

    Attributes:
        start, end: the quantiles.
        low, high: the values there.
    """

    start: float
    end: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Choice:
    """One random choice of a program.

    Attributes:
        dimension: the choice as a sampler sees it.
        feeds: keys of the scenario that depend on it; ``requirements`` among them where a scene's
            acceptance does.
        place: where the program makes it; None where that is not known.
        pieces: its inverse distribution function, if that is made of straight pieces, else empty.
        options: what a discrete choice selects among, if those are plain values, else empty.
    """

    dimension: Dimension
    feeds: frozenset[str] = frozenset()
    place: Place | None = None
    pieces: tuple[Piece, ...] = ()
    options: tuple[Any, ...] = ()

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """A choice as the Scenic child describes it."""
        place, ends = values['place'], ('start', 'end', 'low', 'high')
        dimension = {**values['dimension'], 'weights': tuple(values['dimension']['weights'])}
        names = ('file', 'line', 'column', 'end_line', 'end_column')
        return cls(
            dimension=Dimension(**dimension),
            feeds=frozenset(values['feeds']),
            place=Place(**dict(zip(names, place, strict=True))) if place else None,
            pieces=tuple(
                Piece(**dict(zip(ends, piece, strict=True))) for piece in values['pieces']
            ),
            options=tuple(values['options'] or ()),
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class SearchSpace:
    """The choices of a program that a sampler makes, and those that it does not.

    Attributes:
        choices: all that have quantiles, in the program's order.
        fixed: names of those among them that overrides leave without effect.
        unsearched: what else is drawn at random, as names with a word of why.
    """

    choices: tuple[Choice, ...]
    fixed: frozenset[str] = frozenset()
    unsearched: tuple[str, ...] = ()

    @classmethod
    def from_json(cls, answer: Mapping[str, Any], overridden: Collection[str] = ()) -> Self:
        """The space that the Scenic child describes, less what ``overridden`` keys make idle."""
        choices = tuple(Choice.from_json(values) for values in answer['choices'])
        fixed = frozenset(
            choice.dimension.name for choice in choices if choice.feeds <= set(overridden)
        )
        unsearched = (*answer['unsearched'], *(f'{name} (overridden)' for name in sorted(fixed)))
        return cls(choices=choices, fixed=fixed, unsearched=unsearched)

    @property
    def searched(self) -> tuple[Choice, ...]:
        """The choices that a sampler makes, one per coordinate of a point."""
        return tuple(
            choice for choice in self.choices if choice.dimension.name not in self.fixed
        )

    @property
    def dimensions(self) -> Space:
        """The space as samplers take it.

        Raises:
            UsageError: nothing is left to search.
        """
        return make_space(choice.dimension for choice in self.searched)

    def spread(self, point: Sequence[float]) -> list[float | None]:
        """A point with None put in for the choices that are not searched, for the Scenic child.

        Raises:
            ValueError: not one quantile in [0, 1) per dimension.
        """
        if len(point) != len(self.searched):
            raise ValueError(f'{len(point)} quantiles for {len(self.searched)} dimensions')
        if not all(0 <= quantile < 1 for quantile in point):
            raise ValueError(f'point {tuple(point)}: quantiles have to be within [0, 1)')
        rest = iter(point)
        return [
            None if choice.dimension.name in self.fixed else float(next(rest))
            for choice in self.choices
        ]
