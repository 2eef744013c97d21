"""A fixed share of plain draws beside whatever a sampler does: what a rate can rest on."""

from __future__ import annotations

import math
from typing import Protocol, runtime_checkable

from taxinet_ros.campaign.samplers.draws import generator
from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.samplers.space import Point, Space

_STREAM = 1
"""Keeps these random numbers apart from those that the sampler itself draws for a run."""


class Proposer(Protocol):
    """A sampler whose own points say nothing of a rate; its runs are numbered by themselves."""

    def ask(self) -> Point:
        """The point of its next run."""

    def again(self) -> Point:
        """Another point for the run that was asked for last; as a sampler does."""

    def tell(self, index: int, rho: float | None) -> None:
        """Take the result of a run that it has asked for, in order; as a sampler does."""

    def weight(self, index: int) -> float | None:
        """Density of the prior over that of its proposal; None where it is unknown."""

    def learned(self) -> Probabilities:
        """Where failures are; empty where it has no idea of it."""


@runtime_checkable
class Listener(Protocol):
    """A proposer that learns from points which it has not asked for, too."""

    def add(self, point: Point, rho: float) -> None:
        """Take in the result of a point that was not asked for."""


class WithDrawn:
    """Has some runs drawn from the program itself, and a sampler choose the others.

    Which ones is a matter of the index alone, evenly spread, and their points of seed and index. So
    the draws are independent of each other and of all results, whatever the sampler makes of them:
    a stratum of plain Monte Carlo.
    """

    def __init__(self, sampler: Proposer, space: Space, seed: int, share: float) -> None:
        """Wrap a sampler that has not been asked yet.

        Args:
            sampler: chooses the other runs.
            space: what is searched.
            seed: of the campaign.
            share: of the runs to draw, 0..1.
        """
        self._sampler = sampler
        self._space = space
        self._seed = seed
        self._share = share
        self._points: list[Point | None] = []
        self._own: list[int] = []
        self._chosen = 0
        self._attempt = 0

    def ask(self) -> Point:
        """The next point."""
        self._attempt = 0
        self._own.append(self._chosen)
        if self._drawn_until(len(self._points) + 1) > self._drawn_until(len(self._points)):
            self._points.append(self._draw(len(self._points)))
        else:
            self._points.append(None)
            self._chosen += 1
        return self._points[-1] or self._sampler.ask()

    def again(self) -> Point:
        """Another point for the same run, drawn again or chosen again."""
        if self._points[-1] is None:
            return self._sampler.again()
        self._attempt += 1
        point = self._points[-1] = self._draw(len(self._points) - 1)
        return point

    def _draw(self, index: int) -> Point:
        chance = generator(self._seed, index, self._attempt, stream=_STREAM)
        return self._space.point(chance.random(len(self._space)))

    def _drawn_until(self, runs: int) -> int:
        """How many of the first runs are drawn; a share such as 0.1 is no exact number."""
        return math.floor(self._share * runs + 1e-9)

    def tell(self, index: int, rho: float | None) -> None:
        """Pass a result on, under the sampler's own number."""
        point = self._points[index]
        if point is None:
            self._sampler.tell(self._own[index], rho)
        elif rho is not None and isinstance(self._sampler, Listener):
            self._sampler.add(point, rho)

    def weight(self, index: int) -> float | None:
        """As of the sampler where it chooses all runs; that of a mixture is unknown."""
        return None if self._share else self._sampler.weight(index)

    def drawn(self, index: int) -> bool:
        """Whether the run was drawn."""
        return self._points[index] is not None

    def learned(self) -> Probabilities:
        """What the sampler has learned."""
        return self._sampler.learned()
