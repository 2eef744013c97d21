"""Cross-entropy as VerifAI has it: each failure pulls the histograms towards its own bins."""

from __future__ import annotations

import numpy as np

from taxinet_ros.campaign.samplers.histogram import HistogramSampler
from taxinet_ros.campaign.samplers.product import Product, prior_product
from taxinet_ros.campaign.samplers.space import IDLE, Space


class VerifaiRule(HistogramSampler):
    """After each failure ``p *= alpha; p[bin] += 1 - alpha`` in every dimension.

    This is the rule by which Fremont et al. (Formal Analysis and Redesign of a Neural Network-Based
    Aircraft Taxiing System with VerifAI, CAV 2020) learned their failure distribution; it starts
    from the prior, and a robustness of 0 is a failure. It ends on the likeliest failures alone, and
    drifts in dimensions that do not matter: the closer ``alpha`` is to 1, the slower. VerifAI's own
    default is 0.9, whose outcome depends on chance; 0.995 is steady over a thousand runs and gives
    histograms as uneven as the paper's. The weights are exact, and grow without bound.
    """

    def __init__(self, space: Space, seed: int, *, alpha: float = 0.995) -> None:
        """Know nothing yet.

        Args:
            space: what to search.
            seed: of the campaign.
            alpha: what one failure leaves of the histograms, above 0, below 1.
        """
        super().__init__(space, seed, floor=0.0)
        self._alpha = alpha
        self._current = prior_product(space)

    def _proposal(self) -> Product:
        return self._current

    def _learn(self, index: int, rho: float) -> None:
        if rho > 0:
            return
        histograms = [self._alpha * each for each in self._current.probabilities]
        for each, number in zip(histograms, self._bins[index], strict=True):
            if number != IDLE:
                each[number] += 1 - self._alpha
        # Where it was idle this leaves the histogram as it was.
        self._current = Product(self._space, (each / np.sum(each) for each in histograms))
