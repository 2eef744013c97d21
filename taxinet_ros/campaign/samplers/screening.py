"""A sampler that looks at many scenes cheaply and runs those that look like failures.

A *look* is a forecast of a run's robustness at a fraction of its cost: the closed loop with a
picture only once in a while (:mod:`taxinet_ros.core.sparse_pictures`). Learning from results of
several fidelities is multi-fidelity optimisation (Kennedy and O'Hagan, Predicting the output from
a complex computer code when fast approximations are available, Biometrika 87, 2000); here the
cheap one proposes, and the dear one decides.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

from taxinet_ros.campaign.samplers.active_search import PATIENCE, ActiveSearch
from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.samplers.space import Point, Space, alike, prior_point

NAME = 'screening'
"""Word of this sampler."""

Look = Callable[[Point], float | None]
"""Forecast of the robustness of a point's scene; None if there is none. A pure function."""

LOOK_COST = 0.25
"""Cost of a look in runs, as measured (docs/cheap_search.md); the choice of runs rests on it."""

LEAST_SHARE = 0.2
"""Share of the cost that goes to each way of choosing runs at least."""

FADING = 0.97
"""Weight that a way's costs and finds keep from one result to the next."""


class Way(StrEnum):
    """How a run was chosen."""

    LOOKS = 'looks'
    """Out of scenes that were looked at."""
    RESULTS = 'results'
    """By active search on results alone."""
    PRIOR = 'prior'
    """As the program draws: too many other points were rejected."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _Run:
    """A run that was chosen.

    Attributes:
        point: its point.
        way: how it was chosen.
        number: of the proposal in the active search that made it.
        value: its look, where it was looked at.
    """

    point: Point
    way: Way
    number: int = -1
    value: float = 0.0


@dataclass(kw_only=True, slots=True)
class _Account:
    """What a way of choosing has cost [runs], and how many new failures it has found; fading.

    The costs begin with that of the runs before the first find that is expected of it.
    """

    cost: float
    finds: float = 1.0

    @property
    def rate(self) -> float:
        """New failures for each run's cost."""
        return self.finds / self.cost


class Screening:
    """Chooses what to look at by active search, and what to run by the looks.

    Before a run, points that :class:`.ActiveSearch` proposes are looked at until one looks like a
    failure, at most a fixed number of them. That one is run, else the one with the lowest look of
    those not run. This active search learns every look as if it were a result, until a run
    replaces it, so it goes where looks are low and no failure is known.

    A point *looks like a failure* if its look is not above a threshold, at first 0. This is the
    highest look of a failure at or below which there are as many failures as passes, so looks may
    be biased.

    Looks need not be good, and a second active search hears the results of all runs and nothing
    else. Of the two, the one that has lately found more new failures for its cost chooses the next
    run; each gets at least a fifth of the cost, and until something is found, looks get three
    quarters. A failure is new if no other one is within the radius in all dimensions.
    """

    def __init__(
        self, space: Space, seed: int, look: Look | None, *, radius: float, most: int
    ) -> None:
        """Create the sampler without any results.

        Args:
            space: the space to search.
            seed: seed of the campaign.
            look: forecasts a run; None: there are no looks, and it is an active search.
            radius: see :class:`.ActiveSearch`.
            most: most looks before a run.
        """
        self._space, self._seed, self._look = space, seed, look
        self._radius, self._most = radius, most
        self._searches = {
            way: ActiveSearch(space, seed, radius=radius) for way in (Way.LOOKS, Way.RESULTS)
        }
        self._proposed = dict.fromkeys(self._searches, 0)
        self._accounts = {Way.LOOKS: _Account(cost=4.0), Way.RESULTS: _Account(cost=12.0)}
        self._spent = dict.fromkeys(self._searches, 0.0)
        self._unrun: dict[int, tuple[Point, float]] = {}
        self._runs: list[_Run] = []
        self._attempt = 0
        self._pairs: list[tuple[float, float]] = []
        self._failures: list[Point] = []
        self._threshold = 0.0
        self.looks = 0
        """Number of looks that had a value."""

    @property
    def chosen(self) -> Counter[Way]:
        """Number of runs chosen in each way."""
        return Counter(run.way for run in self._runs)

    def ask(self) -> Point:
        """The next point."""
        self._attempt = 0
        self._runs.append(self._next())
        return self._runs[-1].point

    def again(self) -> Point:
        """Another point for the same run; after :data:`PATIENCE` of them a prior draw."""
        self._attempt += 1
        last = self._runs[-1]
        if last.way is Way.RESULTS:
            self._runs[-1] = replace(last, point=self._searches[Way.RESULTS].again())
        else:
            found = None if self._attempt > PATIENCE else self._screened()
            self._runs[-1] = found or _Run(way=Way.PRIOR, point=prior_point(
                self._space, self._seed, len(self._runs) - 1, self._attempt
            ))
        return self._runs[-1].point

    def refuse(self, rho: float) -> None:
        """See :class:`.HearsRefusals`."""
        run = self._runs[-1]
        if run.way is Way.RESULTS:
            self._searches[Way.RESULTS].refuse(rho)
        else:
            self._searches[Way.RESULTS].add(run.point, rho)
        if run.way is Way.LOOKS:
            self._searches[Way.LOOKS].revise(run.number, rho)

    def tell(self, index: int, rho: float | None) -> None:
        """Record a result."""
        run = self._runs[index]
        if run.way is Way.RESULTS:
            self._searches[Way.RESULTS].tell(run.number, rho)
        if rho is None:
            return
        if run.way is not Way.RESULTS:
            self._searches[Way.RESULTS].add(run.point, rho)
        if run.way is Way.LOOKS:
            self._searches[Way.LOOKS].revise(run.number, rho)
            self._compare(run.value, rho)
        elif self._look is not None:
            self._searches[Way.LOOKS].add(run.point, rho)
        for account in self._accounts.values():
            account.cost *= FADING
            account.finds *= FADING
        if self._is_new_failure(run.point, rho) and run.way in self._accounts:
            self._accounts[run.way].finds += 1

    def add(self, point: Point, rho: float) -> None:
        """Record the result of a point that it did not propose."""
        self._is_new_failure(point, rho)
        self._searches[Way.RESULTS].add(point, rho)
        if self._look is not None:
            self._searches[Way.LOOKS].add(point, rho)

    def weight(self, index: int) -> None:
        """None: the density is unknown."""

    def learned(self) -> Probabilities:
        """Empty: nothing is learned per dimension."""
        return {}

    def _next(self) -> _Run:
        """The next run."""
        found = self._screened() if self._way() is Way.LOOKS else None
        if found is None:
            found = _Run(
                way=Way.RESULTS, number=self._proposed[Way.RESULTS],
                point=self._searches[Way.RESULTS].ask(),
            )
            self._proposed[Way.RESULTS] += 1
        self._charge(found.way, 1.0)
        return found

    def _charge(self, way: Way, cost: float) -> None:
        """Note what a way of choosing has cost [runs]."""
        self._accounts[way].cost += cost
        self._spent[way] += cost

    def _way(self) -> Way:
        """Who chooses the next run."""
        if self._look is None:
            return Way.RESULTS
        total = sum(self._spent.values())
        for way, spent in self._spent.items():
            if spent < LEAST_SHARE * total - 1.0:
                return way
        return max(self._accounts, key=lambda way: self._accounts[way].rate)

    def _screened(self) -> _Run | None:
        """The run that the looks choose; None if nothing looked at is left to run."""
        for _ in range(self._most):
            if any(value <= self._threshold for _, value in self._unrun.values()):
                break
            self._propose()
        if not self._unrun:
            return None
        best = min(self._unrun, key=lambda number: (self._unrun[number][1], number))
        point, value = self._unrun.pop(best)
        return _Run(point=point, way=Way.LOOKS, number=best, value=value)

    def _propose(self) -> None:
        """Look at one more point."""
        assert self._look is not None
        search, number = self._searches[Way.LOOKS], self._proposed[Way.LOOKS]
        self._proposed[Way.LOOKS] += 1
        point = search.ask()
        value = self._look(point)
        search.tell(number, None if value is None else value - self._threshold)
        if value is not None:
            self.looks += 1
            self._charge(Way.LOOKS, LOOK_COST)
            self._unrun[number] = point, value

    def _compare(self, value: float, rho: float) -> None:
        """Move the threshold by a look whose result is known now."""
        self._pairs.append((value, rho))
        threshold, balance = 0.0, 0
        for each, result in sorted(self._pairs):
            balance += 1 if result <= 0 else -1
            if result <= 0 <= balance:
                threshold = max(each, 0.0)
        if threshold != self._threshold:
            self._threshold = threshold
            for number, (_, other) in self._unrun.items():
                self._searches[Way.LOOKS].revise(number, other - threshold)

    def _is_new_failure(self, point: Point, rho: float) -> bool:
        """Note a failure; whether it is one that is unlike all before."""
        if rho > 0:
            return False
        new = not any(alike(self._space, point, other, self._radius) for other in self._failures)
        self._failures.append(point)
        return new
