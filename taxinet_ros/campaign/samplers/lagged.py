"""Makes a sampler's sequence independent of the number of workers and the order of their answers.

A run is asked for with the results of the runs up to ``LAG`` before it, neither fewer nor more.
So up to ``LAG`` runs can be under way at once, and one worker gets the same points as eight. A
campaign that was interrupted is taken up by asking again and telling what its ledger holds.
"""

from __future__ import annotations

import copy
import math

from taxinet_ros.campaign.samplers.sampler import Probabilities, Sampler
from taxinet_ros.campaign.samplers.space import Point

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
