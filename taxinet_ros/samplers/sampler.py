"""The sampler interface, its options, and the two wrappers that campaigns put around it.

:class:`Lagged` makes the sequence independent of the number of workers and the order of their
results: each run is requested with exactly the results of the runs up to a lag before it. So that
many runs can be in flight at once, and one worker gets the same points as eight. An
interrupted campaign resumes by repeating the requests and telling the recorded results.
:class:`WithDrawn` mixes in a fixed share of draws from the prior, from which rates are estimated.
"""

from __future__ import annotations

import copy
import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.space import Point, Space, run_generator

Probabilities = Mapping[str, tuple[float, ...]]
"""Probability of each category or bucket, by name of the dimension."""


class Exhausted(Exception):  # noqa: N818 (signals the end, not an error)
    """The sampler has no more points to propose."""


class Proposer(Protocol):
    """Proposes points, and may learn from their results; it numbers its own runs.

    A proposer's state is determined by its space, its seed and the calls made, so it is restored by
    repeating the calls; no state is saved. One that names this class as its base learns nothing and
    knows no density unless it says so.
    """

    def ask(self) -> Point:
        """The point of the next run: run 0 at the first call, then 1, 2 and so on.

        Raises:
            Exhausted: no points are left; the proposer is not called again.
        """
        ...

    def again(self) -> Point:
        """Another point for the last requested run.

        The program's requirements rejected the previous point. It is discarded, and no result has
        been told since the request. Accepted points then follow the proposal conditioned on the
        requirements.

        Raises:
            Exhausted: no points are left.
        """
        ...

    def tell(self, index: int, rho: float | None) -> None:
        """Record the result of a run, in index order.

        Args:
            index: number of a requested run.
            rho: its robustness, a failure if 0 or less; None without a result (infrastructure
                error, rejected, interrupted), from which nothing is learned.
        """
        return

    def weight(self, index: int) -> float | None:
        """Density of the prior over that of the proposal, at the last point of run ``index``.

        None if the density is unknown, as that of a mixture is once a point of this run was
        rejected. Weighted results of the runs whose first point was accepted have the mean under
        the prior conditioned on the requirements, times the probability of accepting a point of the
        prior; so their self-normalised sums (weighted sum over sum of weights) converge to it.
        """
        return None

    def learned(self) -> Probabilities:
        """Estimated failure histograms by the results so far; empty if there are none."""
        return {}


class Sampler(Proposer, Protocol):
    """A proposer that says which of its runs were drawn from the prior."""

    def drawn(self, index: int) -> bool:
        """Whether the point of run ``index`` was drawn from the prior.

        It is then independent of all other points, and the decision to draw it depends on seed and
        index alone, never on a result. Rates are estimated from these runs only
        (:mod:`taxinet_ros.trials.rates`).
        """
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class Option:
    """A numeric option of a sampler.

    Attributes:
        meaning: short description.
        default: value if none is given.
        low, high: allowed range, inclusive.
        whole: whether it must be an integer.
    """

    meaning: str
    default: float
    low: float
    high: float
    whole: bool = False

    def parse(self, where: str, given: str | float) -> float:
        """Parse a given value.

        Raises:
            UsageError: it is not an allowed number.
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


def split_options(texts: Iterable[str], what: str = 'sampler option') -> dict[str, str]:
    """Keys and values of ``key=value`` texts, such as those for ``make_sampler(…, **options)``.

    Args:
        texts: the texts.
        what: what they are, for an error.

    Raises:
        UsageError: a text has another form, or a key is given twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        key, equals, value = (part.strip() for part in text.partition('='))
        if not (key and equals and value):
            raise UsageError(f'{what} {text!r}: expected key=value')
        if key in found:
            raise UsageError(f'{what} {text}: {key} is given twice; leave one out')
        found[key] = value
    return found


def parse_options(
    sampler: str, known: Mapping[str, Option], given: Mapping[str, str | float]
) -> dict[str, float]:
    """All option values of a sampler, given and default.

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
"""Maximum number of runs in flight, unless a search asks for another."""
MOST_LAG = 10_000


@runtime_checkable
class Batched(Protocol):
    """A sampler that waits, at some runs, for the results of all before them."""

    def needed(self) -> int:
        """Number of results, counted from run 0, that the next run depends on at least."""


@runtime_checkable
class HearsRefusals(Protocol):
    """A sampler that can learn from points that the program's requirements refuse."""

    def refuse(self, rho: float) -> None:
        """Learn the last point of the last run as if it had this robustness; ``again`` follows."""


class Lagged:
    """A sampler for several workers: issues tickets in order, takes results in any order."""

    def __init__(self, sampler: Sampler, lag: int = LAG) -> None:
        """Wrap an unused sampler; no other caller may use it."""
        self._sampler = sampler
        self._lag = lag
        self._asked = 0
        self._told = 0
        self._waiting: dict[int, float | None] = {}

    def ignore_results(self) -> None:
        """Issue every run without waiting for results; for a sampler that ignores them."""
        self._lag = sys.maxsize

    def set_lag(self, lag: int) -> None:
        """Choose each run by the results of all but the last ``lag - 1``; before the first run."""
        assert not self._asked
        self._lag = lag

    @property
    def sampler(self) -> Sampler:
        """The wrapped sampler."""
        return self._sampler

    def ended(self) -> Sampler:
        """The wrapped sampler, told all results that arrived; nothing is asked for after it."""
        for index in sorted(self._waiting):
            self._sampler.tell(index, self._waiting.pop(index))
        self._told = self._asked
        return self._sampler

    @property
    def ready(self) -> bool:
        """Whether the results that the next run depends on have arrived."""
        return all(index in self._waiting for index in range(self._told, self.due))

    def next(self) -> tuple[int, Point]:
        """The next run: its number, which is the ticket to :meth:`tell` with, and its point.

        Raises:
            RuntimeError: a result that it depends on is missing; check :attr:`ready` first.
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

    @property
    def hears_refusals(self) -> bool:
        """Whether the wrapped sampler learns from refused points, if they are told."""
        inner = self._sampler.sampler if isinstance(self._sampler, WithDrawn) else self._sampler
        return isinstance(inner, HearsRefusals)

    def again(self, feedback: float | None = None) -> Point:
        """Another point for the last run of :meth:`next`, whose point was rejected.

        Args:
            feedback: the robustness that a sampler is to learn for the rejected point; None to
                tell it nothing, as to one that learns from results alone.

        Raises:
            RuntimeError: no run was issued, or it has its result.
        """
        index = self._asked - 1
        if index < self._told or index in self._waiting:
            raise RuntimeError(f'run {index} is not waiting for another point')
        if feedback is not None and self.hears_refusals:
            assert isinstance(self._sampler, HearsRefusals)
            self._sampler.refuse(feedback)
        return self._sampler.again()

    def tell(self, index: int, rho: float | None) -> None:
        """Record the result of a run, in any order.

        Args:
            index: the ticket.
            rho: robustness; None without a result, from which nothing is learned.

        Raises:
            ValueError: no such ticket was issued, it has its result already, or rho is NaN.
        """
        self._check_asked(index)
        if index < self._told or index in self._waiting:
            raise ValueError(f'run {index} has its result already')
        if rho is not None and math.isnan(rho):
            raise ValueError(f'run {index}: NaN is no robustness; None is for a run without one')
        self._waiting[index] = rho

    def weight(self, index: int) -> float | None:
        """Density of the prior over the proposal's at a run's point; None if unknown.

        Raises:
            ValueError: the run was not requested.
        """
        self._check_asked(index)
        return self._sampler.weight(index)

    def drawn(self, index: int) -> bool:
        """Whether a run's point was drawn from the prior, by the wrapped sampler.

        Raises:
            ValueError: the run was not requested.
        """
        self._check_asked(index)
        return self._sampler.drawn(index)

    def learned(self) -> Probabilities:
        """Estimated failure histograms by all results so far; empty if the sampler has none."""
        if not self._waiting or not self._sampler.learned():
            return self._sampler.learned()
        ahead = copy.deepcopy(self._sampler)  # a copy: the sampler itself must not learn them yet
        for index, rho in sorted(self._waiting.items()):
            ahead.tell(index, rho)
        return ahead.learned()

    def _check_asked(self, index: int) -> None:
        if not 0 <= index < self._asked:
            raise ValueError(f'run {index} was not asked for: {self._asked} runs were, from 0 on')

    @property
    def due(self) -> int:
        """Number of results, counted from run 0, that the next run depends on."""
        batched = self._sampler.needed() if isinstance(self._sampler, Batched) else 0
        return max(self._asked - self._lag + 1, batched)


_STREAM = 1
"""Random stream that is independent of the sampler's own draws for a run."""


@runtime_checkable
class Listener(Protocol):
    """A proposer that also learns from points that it did not propose."""

    def add(self, point: Point, rho: float) -> None:
        """Record the result of a point that it did not propose."""


class WithDrawn:
    """Draws some runs from the prior, and lets a sampler choose the others.

    The index alone decides which runs are drawn, evenly spread; their points depend on seed and
    index. So the draws are independent of each other and of all results, whatever the sampler does
    with them: a stratum of plain Monte Carlo.
    """

    def __init__(self, sampler: Proposer, space: Space, seed: int, share: float) -> None:
        """Wrap an unused sampler.

        Args:
            sampler: chooses the other runs.
            space: the space to search.
            seed: seed of the campaign.
            share: share of the runs to draw from the prior, 0..1.
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
        """Another point for the same run, from the same source."""
        if self._points[-1] is None:
            return self._sampler.again()
        self._attempt += 1
        point = self._points[-1] = self._draw(len(self._points) - 1)
        return point

    @property
    def sampler(self) -> Proposer:
        """The sampler that chooses the other runs."""
        return self._sampler

    def refuse(self, rho: float) -> None:
        """Pass on that the last point was refused, also one that was drawn."""
        point = self._points[-1]
        if point is None and isinstance(self._sampler, HearsRefusals):
            self._sampler.refuse(rho)
        elif point is not None and isinstance(self._sampler, Listener):
            self._sampler.add(point, rho)

    def _draw(self, index: int) -> Point:
        chance = run_generator(self._seed, index, self._attempt, stream=_STREAM)
        return self._space.point(chance.random(len(self._space)))

    def _drawn_until(self, runs: int) -> int:
        """Number of drawn runs among the first ``runs``; a share such as 0.1 is inexact."""
        return math.floor(self._share * runs + 1e-9)

    def tell(self, index: int, rho: float | None) -> None:
        """Forward a result under the sampler's own run number."""
        point = self._points[index]
        if point is None:
            self._sampler.tell(self._own[index], rho)
        elif rho is not None and isinstance(self._sampler, Listener):
            self._sampler.add(point, rho)

    def weight(self, index: int) -> float | None:
        """The sampler's weight if it chooses all runs; that of a mixture is unknown."""
        return None if self._share else self._sampler.weight(index)

    def drawn(self, index: int) -> bool:
        """Whether the run was drawn from the prior."""
        return self._points[index] is not None

    def learned(self) -> Probabilities:
        """Histograms of the wrapped sampler."""
        return self._sampler.learned()
