"""What every sampler can do, its options, and the two wrappers that campaigns put around it.

:class:`Lagged` makes its sequence independent of the number of workers and the order of their
answers: a run is asked for with the results of the runs up to ``LAG`` before it, neither fewer
nor more. So up to ``LAG`` runs can be under way at once, and one worker gets the same points as
eight. A campaign that was interrupted is taken up by asking again and telling what its ledger
holds. :class:`WithDrawn` mixes in a fixed share of plain draws, on which a rate can rest.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from taxinet_ros.campaign.samplers.space import Point, Space, run_generator
from taxinet_ros.errors import UsageError

Probabilities = Mapping[str, tuple[float, ...]]
"""Probability of each category or bucket, by name of the dimension."""


class Exhausted(Exception):  # noqa: N818 (an end, not a fault)
    """A sampler has proposed all the points that it has."""


class Sampler(Protocol):
    """Proposes points, and may learn from their results.

    A sampler's whole state follows from its space, its seed and the calls made, so it is restored
    by repeating them; there is no state to be saved.
    """

    def ask(self) -> Point:
        """The point of the next run: of run 0 at the first call, then of 1, 2 and so on.

        Raises:
            Exhausted: there is no other one; nothing is asked for any more.
        """

    def again(self) -> Point:
        """Another point for the run that was asked for last.

        The program's requirements refuse the former one. It counts for nothing, and nothing has
        been told since it was asked for. Accepted points are then distributed as the proposal is
        where the requirements hold.

        Raises:
            Exhausted: there is no other one.
        """

    def tell(self, index: int, rho: float | None) -> None:
        """Take the result of a run, in the order of the indices.

        Args:
            index: number of the run, which has been asked for.
            rho: its robustness, a failure where it is 0 or less; None where there is none (broken
                bench, rejected, interrupted), of which nothing is learned.
        """

    def weight(self, index: int) -> float | None:
        """Density of the prior over that of the proposal, at the last point of run ``index``.

        None where the density is unknown. Results multiplied by it have the mean of the prior, if
        no points were refused. Where some were, the mean of the weights is no longer 1, but the
        share of the requirements' space under the prior over that under the proposal, which nobody
        knows and which changes as a sampler learns; weighted sums over the sum of the weights
        (self-normalised) still tend to the mean of the prior where the requirements hold.
        """

    def drawn(self, index: int) -> bool:
        """Whether the point of run ``index`` was drawn from the program itself.

        That is: from the prior, independently of all other points, and whether it is drawn was
        settled by seed and index alone, never by a result. Rates rest on these runs and no others
        (:mod:`taxinet_ros.campaign.rates`).
        """

    def learned(self) -> Probabilities:
        """Where failures are, by what has been told; empty where the sampler has no idea of it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Option:
    """A number that a sampler takes.

    Attributes:
        meaning: in a few words.
        default: value where none is given.
        low, high: ends of what is allowed, both included.
        whole: whether it is a whole number.
    """

    meaning: str
    default: float
    low: float
    high: float
    whole: bool = False

    def parse(self, where: str, given: str | float) -> float:
        """The value that was given.

        Raises:
            UsageError: it is no such number.
        """
        try:
            value = float(given)
        except ValueError:
            raise UsageError(f'{where}={given}: {given!r} is no number') from None
        if not math.isfinite(value) or not self.low <= value <= self.high:
            raise UsageError(f'{where}={given}: needs to be within {self.low:g}..{self.high:g}')
        if self.whole and not value.is_integer():
            raise UsageError(f'{where}={given}: needs to be a whole number')
        return value


def split_options(texts: Iterable[str]) -> dict[str, str]:
    """Keys and values of ``key=value`` texts, for ``make_sampler(…, **options)``.

    Raises:
        UsageError: a text is no such thing, or a key is given twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        key, equals, value = (part.strip() for part in text.partition('='))
        if not (key and equals and value):
            raise UsageError(f'sampler option {text!r}: expected key=value')
        if key in found:
            raise UsageError(f'sampler option {key} is given twice')
        found[key] = value
    return found


def parse_options(
    sampler: str, known: Mapping[str, Option], given: Mapping[str, str | float]
) -> dict[str, float]:
    """The value of every option of a sampler, the given ones and the defaults.

    Raises:
        UsageError: an unknown option (the known ones are listed), or a value that is not allowed.
    """
    for key in given:
        if key not in known:
            names = ', '.join(known) or 'none'
            raise UsageError(f'sampler {sampler}: unknown option {key}; known: {names}')
    return {
        key: option.parse(f'sampler {sampler}: {key}', given.get(key, option.default))
        for key, option in known.items()
    }


LAG = 8
"""Most runs under way at once."""


class Lagged:
    """A sampler for several workers: tickets out in order, results in as they come."""

    def __init__(self, sampler: Sampler, lag: int = LAG) -> None:
        """Wrap a sampler that has not been asked yet; it must not be used by anyone else."""
        self._sampler = sampler
        self._lag = lag
        self._asked = 0
        self._told = 0
        self._waiting: dict[int, float | None] = {}

    @property
    def ready(self) -> bool:
        """Whether the results that the next run depends on are in."""
        return all(index in self._waiting for index in range(self._told, self.due))

    def next(self) -> tuple[int, Point]:
        """The next run: its number, which is the ticket to :meth:`tell` with, and its point.

        Raises:
            RuntimeError: a result that it depends on is missing; ask :attr:`ready` before.
        """
        if not self.ready:
            missing = next(i for i in range(self._told, self.due) if i not in self._waiting)
            raise RuntimeError(f'run {self._asked} depends on the result of run {missing}')
        for index in range(self._told, self.due):
            self._sampler.tell(index, self._waiting.pop(index))
        self._told = max(self._told, self.due)
        point = self._sampler.ask()
        self._asked += 1
        return self._asked - 1, point

    def again(self) -> Point:
        """Another point for the run that :meth:`next` gave last, whose point was refused.

        Raises:
            RuntimeError: none was given, or it has its result.
        """
        index = self._asked - 1
        if index < self._told or index in self._waiting:
            raise RuntimeError(f'run {index} is not waiting for another point')
        return self._sampler.again()

    def tell(self, index: int, rho: float | None) -> None:
        """Take the result of a run, in any order.

        Args:
            index: the ticket.
            rho: robustness; None where there is none, of which nothing is learned.

        Raises:
            ValueError: no such ticket was given out, it has its result already, or rho is NaN.
        """
        self._check_asked(index)
        if index < self._told or index in self._waiting:
            raise ValueError(f'run {index} has its result already')
        if rho is not None and math.isnan(rho):
            raise ValueError(f'run {index}: NaN is no robustness; None is for a run without one')
        self._waiting[index] = rho

    def weight(self, index: int) -> float | None:
        """Density of the prior over the proposal's at a run's point; None where it is unknown.

        Raises:
            ValueError: the run was not asked for.
        """
        self._check_asked(index)
        return self._sampler.weight(index)

    def drawn(self, index: int) -> bool:
        """Whether a run's point was drawn from the program itself; as of the sampler.

        Raises:
            ValueError: the run was not asked for.
        """
        self._check_asked(index)
        return self._sampler.drawn(index)

    def learned(self) -> Probabilities:
        """Where failures are, by all results that are in; empty where the sampler has no idea."""
        if not self._waiting or not self._sampler.learned():
            return self._sampler.learned()
        ahead = copy.deepcopy(self._sampler)  # the sampler itself must not know of them yet
        for index, rho in sorted(self._waiting.items()):
            ahead.tell(index, rho)
        return ahead.learned()

    def _check_asked(self, index: int) -> None:
        if not 0 <= index < self._asked:
            raise ValueError(f'run {index} was not asked for: {self._asked} runs were, from 0 on')

    @property
    def due(self) -> int:
        """Number of results, counted from run 0, that the next run depends on."""
        return max(self._asked - self._lag + 1, 0)


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
        chance = run_generator(self._seed, index, self._attempt, stream=_STREAM)
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
