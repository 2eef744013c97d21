"""The cross-entropy method with importance weights: learns where all the failures are."""

from __future__ import annotations

from taxinet_ros.campaign.samplers.histogram import HistogramSampler
from taxinet_ros.campaign.samplers.history import History, failure_histograms
from taxinet_ros.campaign.samplers.product import Product, prior_product
from taxinet_ros.campaign.samplers.space import Space


class CrossEntropy(HistogramSampler):
    """Histograms fitted to all failures so far, each with the weight it has under the prior.

    Minimises the cross entropy to the distribution of the failures under the prior (Rubinstein and
    Kroese, The Cross-Entropy Method, 2004), so :meth:`learned` estimates the probability of each
    bin given a failure, and does not collapse to the likeliest bin as
    :class:`~taxinet_ros.campaign.samplers.verifai_rule.VerifaiRule` does. Before the first fit the
    points are those of the random sampler.
    """

    def __init__(
        self, space: Space, seed: int, *, floor: float = 0.3, every: int = 50,
    ) -> None:
        """Know nothing yet.

        Args:
            space: what to search.
            seed: of the campaign.
            floor: share of the runs drawn from the prior, above 0, at most 1.
            every: number of results between two fits.
        """
        super().__init__(space, seed, floor, blind=every)
        self._every = every
        self._fitted = prior_product(space)
        self._history = History(len(space))

    def _proposal(self) -> Product:
        return self._fitted

    def _learn(self, index: int, rho: float) -> None:
        self._history.add(self._bins[index], self._weights[index], rho)
        if len(self._history) % self._every == 0:
            self._fitted = Product(
                self._space, failure_histograms(self._space, self._history)
            )
