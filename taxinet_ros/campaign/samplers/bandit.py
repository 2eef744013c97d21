"""A multi-armed bandit: in every dimension its bins are arms, pulled by upper confidence bounds."""

from __future__ import annotations

import math

import numpy as np

from taxinet_ros.campaign.samplers.histogram import HistogramSampler, by_name
from taxinet_ros.campaign.samplers.history import History, failure_histograms, failures
from taxinet_ros.campaign.samplers.product import Floats, Product
from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.samplers.space import IDLE, Dimension, Point, Space


class Bandit(HistogramSampler):
    """UCB1 (Auer, Cesa-Bianchi and Fischer, Machine Learning 47, 2002), one per dimension.

    The reward is 1 for a failure and 0 otherwise. Pulls whose result is still to come count as
    pulls, so runs in flight together do not all try the same. Some runs are drawn from the prior,
    which keeps the density known: a point is drawn evenly from the chosen bins otherwise.
    """

    def __init__(
        self, space: Space, seed: int, *, floor: float = 0.1, explore: float = 0.3,
    ) -> None:
        """Know nothing yet.

        Args:
            space: what to search.
            seed: of the campaign.
            floor: share of the runs drawn from the prior, above 0, at most 1.
            explore: factor of the confidence bound ``sqrt(ln(pulls) / pulls of the arm)``, 0 or
                more; the root of 2 in the source, whose rewards are not as rare as failures.
        """
        super().__init__(space, seed, floor)
        self._explore = explore
        self._pulls = [np.zeros(len(dimension.prior)) for dimension in space]
        self._history = History(len(space))
        # Ties fall by chance, lest untried bins of all dimensions be tried along a diagonal.
        chance = np.random.default_rng(seed)
        self._orders = [chance.permutation(len(dimension.prior)) for dimension in space]

    def ask(self) -> Point:
        """The next point."""
        point = super().ask()
        self._count(1)
        return point

    def again(self) -> Point:
        """Another point for the same run; the refused one is no pull."""
        self._count(-1)
        point = super().again()
        self._count(1)
        return point

    def _count(self, amount: int) -> None:
        for pulls, number in zip(self._pulls, self._bins[-1], strict=True):
            if number != IDLE:
                pulls[number] += amount

    def learned(self) -> Probabilities:
        """Where failures are under the prior, estimated as the cross-entropy sampler does."""
        return by_name(self._space, failure_histograms(self._space, self._history))

    def _learn(self, index: int, rho: float) -> None:
        self._history.add(self._bins[index], self._weights[index], rho)

    def _proposal(self) -> Product:
        rewards = failures(self._history.rhos).astype(float)
        return Product(
            self._space,
            (self._arm(number, each, rewards) for number, each in enumerate(self._space)),
        )

    def _arm(self, number: int, dimension: Dimension, rewards: Floats) -> Floats:
        """All of the probability on the most promising bin that the prior knows of."""
        prior = np.array(dimension.prior)
        pulls = self._pulls[number]
        results = self._history.sums(number, len(prior), np.ones_like(rewards))
        mean = self._history.sums(number, len(prior), rewards) / np.maximum(results, 1)
        wide = np.sqrt(math.log(max(pulls.sum(), 1)) / np.maximum(pulls, 1))
        bound = np.where(pulls > 0, mean + self._explore * wide, np.inf)
        order = self._orders[number]
        best = order[np.argmax(np.where(prior > 0, bound, -np.inf)[order])]
        return (np.arange(len(prior)) == best).astype(float)
