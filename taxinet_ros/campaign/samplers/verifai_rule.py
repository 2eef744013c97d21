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
    drifts in dimensions that do not matter: the closer ``alpha`` is to 1, the slower. The default
    is VerifAI's own, for the paper names no other. It remembers some ten failures, so that what one
    search comes to depends on chance: ask several, that differ in their seed. The rule has no plain
    draws; a ``floor`` gives it some.
    """

    def __init__(
        self, space: Space, seed: int, *, alpha: float = 0.9, floor: float = 0.0,
    ) -> None:
        """Know nothing yet.

        Args:
            space: what to search.
            seed: of the campaign.
            alpha: what one failure leaves of the histograms, above 0, below 1.
            floor: share of the runs drawn from the prior, 0..1.
        """
        super().__init__(space, seed, floor)
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
