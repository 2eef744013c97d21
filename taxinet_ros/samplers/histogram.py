"""Samplers that learn one independent histogram per dimension.

Cross-entropy with importance weights, cross-entropy by VerifAI's rule, and the multi-armed
bandit by upper confidence bounds, with the histograms, history and exact weights that they share.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from taxinet_ros.samplers.sampler import Probabilities
from taxinet_ros.samplers.space import IDLE, Dimension, Point, Space, run_generator

Floats = npt.NDArray[np.float64]


class Product:
    """Product of one histogram per dimension, uniform within each bin.

    Attributes:
        probabilities: per dimension, of each of its bins (categories or buckets).
    """

    def __init__(self, space: Space, probabilities: Iterable[Floats]) -> None:
        """Create the product from histograms in dimension order, each summing to 1.

        The histogram of a dimension that may be idle is conditional on its being active.
        """
        self._space = space
        self.probabilities = tuple(probabilities)
        self._edges = [np.array(dimension.edges) for dimension in space]
        self._priors = [np.array(dimension.prior) for dimension in space]
        self._cumulative = [_cumulative(each) for each in self.probabilities]

    def point(self, uniform: Iterable[float]) -> Point:
        """The point at these quantiles of this distribution; under the prior they are unchanged."""
        return self._space.point(
            np.interp(quantile, cumulative, edges)
            for quantile, cumulative, edges in zip(
                uniform, self._cumulative, self._edges, strict=True
            )
        )

    def density(self, bins: Iterable[int]) -> float:
        """Density ratio to the prior at a point in these bins; idle dimensions are ignored."""
        return math.prod(
            float(mine[number] / prior[number])
            for number, mine, prior in zip(bins, self.probabilities, self._priors, strict=True)
            if number != IDLE
        )


def prior_product(space: Space) -> Product:
    """The prior as a product of histograms."""
    return Product(space, (np.array(dimension.prior) for dimension in space))


def _cumulative(probabilities: Floats) -> Floats:
    total = np.cumsum(probabilities)
    return np.concatenate(([0.0], total / total[-1]))


LEAST = 10
"""Number of failures from which on only failures are learned from."""
ELITE = 0.1
"""Share of the worst runs to learn from until there are :data:`LEAST` failures."""
STRENGTH = 5.0
"""Weight of the prior in the learned histograms, in failures."""


class History:
    """Bins, weight and robustness of each run with a result."""

    def __init__(self, dimensions: int) -> None:
        self._size = 0
        self._bins = np.zeros((64, dimensions), np.intp)
        self._values = np.zeros((64, 2))

    def __len__(self) -> int:
        return self._size

    def add(self, bins: Sequence[int], weight: float, rho: float) -> None:
        """Append a run."""
        if self._size == len(self._bins):
            self._bins = np.concatenate((self._bins, np.zeros_like(self._bins)))
            self._values = np.concatenate((self._values, np.zeros_like(self._values)))
        self._bins[self._size] = bins
        self._values[self._size] = weight, rho
        self._size += 1

    def sums(self, dimension: int, bins: int, amounts: Floats) -> Floats:
        """Sum of the amounts in each of the ``bins`` bins of a dimension, without idle runs."""
        mine = self.bins[:, dimension]
        active = mine != IDLE
        return np.bincount(mine[active], amounts[active], bins).astype(np.float64)

    @property
    def bins(self) -> npt.NDArray[np.intp]:
        """Bin of each run (first axis) in each dimension (second), ``IDLE`` if it has none."""
        return self._bins[: self._size]

    @property
    def weights(self) -> Floats:
        """Weight of each run."""
        return self._values[: self._size, 0]

    @property
    def rhos(self) -> Floats:
        """Robustness of each run."""
        return self._values[: self._size, 1]


def worst(rhos: Floats) -> npt.NDArray[np.bool_]:
    """Which runs to search around.

    The failures, as soon as there are :data:`LEAST` of them. Before that, the worst runs, as in the
    cross-entropy method for rare events (Rubinstein and Kroese, The Cross-Entropy Method, 2004):
    the share :data:`ELITE`, but at least :data:`LEAST`.
    """
    failed = rhos <= 0
    if len(rhos) == 0 or np.count_nonzero(failed) >= LEAST:
        return failed
    rank = min(max(round(ELITE * len(rhos)), LEAST), len(rhos)) - 1
    level: Floats = np.partition(rhos, rank)[rank]
    return rhos <= level


def histograms(
    space: Space, history: History, among: npt.NDArray[np.bool_]
) -> list[Floats]:
    """Estimate of the probability of each bin given a run among these under the prior.

    Per dimension; for one that may be idle: given such a run in which it is active.
    """
    amounts = np.where(among, history.weights, 0.0)
    found = []
    for number, dimension in enumerate(space):
        prior = np.array(dimension.prior)
        mine = history.sums(number, len(prior), amounts)
        found.append((mine + STRENGTH * prior) / (mine.sum() + STRENGTH))
    return found


def failure_histograms(space: Space, history: History) -> Probabilities:
    """Estimate of the probability of each bin given a failure under the prior, by dimension."""
    return by_name(space, histograms(space, history, history.rhos <= 0))


class HistogramSampler(ABC):
    """Draws from ``floor * prior + (1 - floor) * product of histograms``.

    The prior's share bounds every weight by ``1 / floor`` (defensive importance sampling;
    Hesterberg, Technometrics 37, 1995).
    """

    def __init__(self, space: Space, seed: int, floor: float, *, blind: int = 0) -> None:
        """Create the sampler without any results.

        Args:
            space: the space to search.
            seed: seed of the campaign.
            floor: share of the runs drawn from the prior, 0..1.
            blind: number of initial runs that precede any learning, and so are drawn from the
                prior.
        """
        self._space = space
        self._seed = seed
        self._floor = floor
        self._blind = blind
        self._bins: list[tuple[int, ...]] = []
        self._weights: list[float] = []
        self._of_prior: list[bool] = []
        self._refused: set[int] = set()
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
        self._refused.add(len(self._bins) - 1)
        return self._drawn()

    def refuse(self, rho: float) -> None:
        """See :class:`.HearsRefusals`."""
        self._learn(len(self._bins) - 1, rho)

    def _drawn(self) -> Point:
        chance = run_generator(self._seed, len(self._bins) - 1, self._attempt)
        *uniform, mixing = chance.random(len(self._space) + 1)
        proposal = self._proposal()
        if not self._attempt:  # decided once, so that rejections favour neither part
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

    def weight(self, index: int) -> float | None:
        """Density of the prior over that of the proposal at the time of the request.

        None after a refused point: the requirements accept points of the two parts with different
        probabilities, so the parts' shares of the accepted points are unknown.
        """
        return None if index in self._refused else self._weights[index]

    def drawn(self, index: int) -> bool:
        """Whether the run belongs to the prior's share, or preceded any learning."""
        return self._of_prior[index]

    @abstractmethod
    def learned(self) -> Probabilities:
        """The learned histograms, without the prior's share."""

    @abstractmethod
    def _proposal(self) -> Product:
        """Distribution of the next point, apart from the prior's share."""

    @abstractmethod
    def _learn(self, index: int, rho: float) -> None:
        """Record a result."""


def by_name(space: Space, probabilities: Iterable[Floats]) -> Probabilities:
    """Histograms in dimension order as plain numbers, keyed by dimension name."""
    return {
        dimension.name: tuple(float(each) for each in histogram)
        for dimension, histogram in zip(space, probabilities, strict=True)
    }


class CrossEntropy(HistogramSampler):
    """Histograms fitted to all failures so far, each with the weight it has under the prior.

    Minimises the cross entropy to the distribution of the failures under the prior (Rubinstein and
    Kroese, The Cross-Entropy Method, 2004); as long as failures are few, to that of the worst runs.
    :meth:`learned` estimates the probability of each bin given a failure, with hard requirements
    only roughly, as it then learns from runs with unknown weights too. Unlike
    :class:`~taxinet_ros.samplers.histogram.VerifaiRule`, it does not collapse to the
    likeliest bin. Before the first fit the points are those of the random sampler.
    """

    def __init__(
        self, space: Space, seed: int, *, floor: float = 0.3, every: int = 50,
    ) -> None:
        """Create the sampler without any results.

        Args:
            space: the space to search.
            seed: seed of the campaign.
            floor: share of the runs drawn from the prior, above 0, at most 1.
            every: number of results between two fits.
        """
        super().__init__(space, seed, floor, blind=every)
        self._every = every
        self._fitted = prior_product(space)
        self._history = History(len(space))

    def learned(self) -> Probabilities:
        """Failure histograms under the prior, by all failures so far."""
        return failure_histograms(self._space, self._history)

    def _proposal(self) -> Product:
        return self._fitted

    def _learn(self, index: int, rho: float) -> None:
        self._history.add(self._bins[index], self._weights[index], rho)
        if len(self._history) % self._every == 0:
            found = histograms(self._space, self._history, worst(self._history.rhos))
            self._fitted = Product(self._space, found)


class VerifaiRule(HistogramSampler):
    """After each failure ``p *= alpha; p[bin] += 1 - alpha`` in every dimension.

    This is the rule by which Fremont et al. (Formal Analysis and Redesign of a Neural Network-Based
    Aircraft Taxiing System with VerifAI, CAV 2020) learned their failure distribution; it starts
    from the prior, and a robustness of 0 is a failure. It converges to the likeliest failures
    alone, and drifts in irrelevant dimensions; both are slower the closer ``alpha`` is to 1. The
    default is VerifAI's; the paper gives no other. It remembers about ten failures, so the outcome
    of one search depends on chance: run several with different seeds. The rule draws nothing from
    the prior unless ``floor`` is set.
    """

    def __init__(
        self, space: Space, seed: int, *, alpha: float = 0.9, floor: float = 0.0,
    ) -> None:
        """Create the sampler without any results.

        Args:
            space: the space to search.
            seed: seed of the campaign.
            alpha: factor by which a failure shrinks the histograms, above 0, below 1.
            floor: share of the runs drawn from the prior, 0..1.
        """
        super().__init__(space, seed, floor)
        self._alpha = alpha
        self._current = prior_product(space)

    def learned(self) -> Probabilities:
        """The histograms of the rule."""
        return by_name(self._space, self._current.probabilities)

    def _proposal(self) -> Product:
        return self._current

    def _learn(self, index: int, rho: float) -> None:
        if rho > 0:
            return
        histograms = [self._alpha * each for each in self._current.probabilities]
        for each, number in zip(histograms, self._bins[index], strict=True):
            if number != IDLE:
                each[number] += 1 - self._alpha
        # An idle dimension's histogram is unchanged.
        self._current = Product(self._space, (each / np.sum(each) for each in histograms))


class Bandit(HistogramSampler):
    """UCB1 (Auer, Cesa-Bianchi and Fischer, Machine Learning 47, 2002), one per dimension.

    The reward is 1 for a failure and 0 otherwise. Pulls in flight count as pulls, so concurrent
    runs do not all try the same bins. Some runs are drawn from the prior, which keeps the density
    known; the others are drawn uniformly from the chosen bins.
    """

    def __init__(
        self, space: Space, seed: int, *, floor: float = 0.1, explore: float = 0.3,
    ) -> None:
        """Create the sampler without any results.

        Args:
            space: the space to search.
            seed: seed of the campaign.
            floor: share of the runs drawn from the prior, above 0, at most 1.
            explore: factor of the confidence bound ``sqrt(ln(pulls) / pulls of the arm)``, 0 or
                more; sqrt(2) in the source, where rewards are less rare than failures.
        """
        super().__init__(space, seed, floor)
        self._explore = explore
        self._pulls = [np.zeros(len(dimension.prior)) for dimension in space]
        self._history = History(len(space))
        # Random ties; otherwise untried bins of all dimensions would be tried diagonally.
        chance = np.random.default_rng(seed)
        self._orders = [chance.permutation(len(dimension.prior)) for dimension in space]

    def ask(self) -> Point:
        """The next point."""
        point = super().ask()
        self._count(1)
        return point

    def again(self) -> Point:
        """Another point for the same run; the rejected one does not count as a pull."""
        self._count(-1)
        point = super().again()
        self._count(1)
        return point

    def refuse(self, rho: float) -> None:
        """As the result of a pull, which counts as one."""
        super().refuse(rho)
        self._count(1)  # again() takes it off

    def _count(self, amount: int) -> None:
        for pulls, number in zip(self._pulls, self._bins[-1], strict=True):
            if number != IDLE:
                pulls[number] += amount

    def learned(self) -> Probabilities:
        """Failure histograms under the prior, estimated as by the cross-entropy sampler."""
        return failure_histograms(self._space, self._history)

    def _learn(self, index: int, rho: float) -> None:
        self._history.add(self._bins[index], self._weights[index], rho)

    def _proposal(self) -> Product:
        rewards = worst(self._history.rhos).astype(float)
        return Product(
            self._space,
            (self._arm(number, each, rewards) for number, each in enumerate(self._space)),
        )

    def _arm(self, number: int, dimension: Dimension, rewards: Floats) -> Floats:
        """All probability on the most promising bin with a prior probability above 0."""
        prior = np.array(dimension.prior)
        pulls = self._pulls[number]
        results = self._history.sums(number, len(prior), np.ones_like(rewards))
        mean = self._history.sums(number, len(prior), rewards) / np.maximum(results, 1)
        wide = np.sqrt(math.log(max(pulls.sum(), 1)) / np.maximum(pulls, 1))
        bound = np.where(pulls > 0, mean + self._explore * wide, np.inf)
        order = self._orders[number]
        best = order[np.argmax(np.where(prior > 0, bound, -np.inf)[order])]
        return (np.arange(len(prior)) == best).astype(float)
