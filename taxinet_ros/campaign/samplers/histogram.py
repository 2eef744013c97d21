"""What the samplers that propose by histograms have in common: the asking, and exact weights."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable

from taxinet_ros.campaign.samplers.draws import generator
from taxinet_ros.campaign.samplers.product import Floats, Product
from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.samplers.space import Point, Space


class HistogramSampler(ABC):
    """Draws from ``floor * prior + (1 - floor) * product of histograms``.

    The prior's share bounds every weight by ``1 / floor`` (defensive importance sampling;
    Hesterberg, Technometrics 37, 1995).
    """

    def __init__(self, space: Space, seed: int, floor: float, *, blind: int = 0) -> None:
        """Know nothing yet.

        Args:
            space: what to search.
            seed: of the campaign.
            floor: share of the runs drawn from the prior, 0..1.
            blind: number of runs, from run 0 on, that come too early for anything to be learned,
                and so are all drawn from the prior.
        """
        self._space = space
        self._seed = seed
        self._floor = floor
        self._blind = blind
        self._bins: list[tuple[int, ...]] = []
        self._weights: list[float] = []
        self._of_prior: list[bool] = []
        self._attempt = 0

    def ask(self) -> Point:
        """The next point."""
        self._attempt = 0
        self._bins.append(())
        self._weights.append(0.0)
        return self._drawn()

    def again(self) -> Point:
        """Another draw for the same run, from the same part of the mixture."""
        self._attempt += 1
        return self._drawn()

    def _drawn(self) -> Point:
        chance = generator(self._seed, len(self._bins) - 1, self._attempt)
        *uniform, mixing = chance.random(len(self._space) + 1)
        proposal = self._proposal()
        if not self._attempt:  # settled once: refusals must not favour either
            blind = len(self._of_prior) < self._blind
            self._of_prior.append(blind or bool(mixing < self._floor))
        point = (self._space if self._of_prior[-1] else proposal).point(uniform)
        self._bins[-1] = self._space.bins(point)
        density = self._floor + (1 - self._floor) * proposal.density(self._bins[-1])
        self._weights[-1] = 1 / density
        return point

    def tell(self, index: int, rho: float | None) -> None:
        """Learn from a result."""
        if rho is not None:
            self._learn(index, rho)

    def weight(self, index: int) -> float:
        """Density of the prior over that of the proposal as it was when asked."""
        return self._weights[index]

    def drawn(self, index: int) -> bool:
        """Whether the run is of the prior's share, or came before anything was learned."""
        return self._of_prior[index]

    def learned(self) -> Probabilities:
        """The histograms, without the prior's share."""
        return by_name(self._space, self._proposal().probabilities)

    @abstractmethod
    def _proposal(self) -> Product:
        """What to draw the next point from, but for the prior's share."""

    @abstractmethod
    def _learn(self, index: int, rho: float) -> None:
        """Take a result in."""


def by_name(space: Space, probabilities: Iterable[Floats]) -> Probabilities:
    """Histograms in the order of the dimensions, as plain numbers by name."""
    return {
        dimension.name: tuple(float(each) for each in histogram)
        for dimension, histogram in zip(space, probabilities, strict=True)
    }
