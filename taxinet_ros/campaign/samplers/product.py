"""Distributions with an independent histogram per dimension: what learning samplers propose."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from taxinet_ros.campaign.samplers.space import IDLE, Point, Space

Floats = npt.NDArray[np.float64]


class Product:
    """A histogram over the bins of each dimension, even within a bin.

    Attributes:
        probabilities: per dimension, of each of its bins (categories or buckets).
    """

    def __init__(self, space: Space, probabilities: Iterable[Floats]) -> None:
        """Take histograms in the order of the dimensions, each adding up to 1.

        That of a dimension that may be idle is conditional on its being active.
        """
        self._space = space
        self.probabilities = tuple(probabilities)
        self._edges = [np.array(dimension.edges) for dimension in space]
        self._priors = [np.array(dimension.prior) for dimension in space]
        self._cumulative = [_cumulative(each) for each in self.probabilities]

    def point(self, uniform: Iterable[float]) -> Point:
        """The point with these quantiles of this distribution: the prior's are left unchanged."""
        return self._space.point(
            np.interp(quantile, cumulative, edges)
            for quantile, cumulative, edges in zip(
                uniform, self._cumulative, self._edges, strict=True
            )
        )

    def density(self, bins: Iterable[int]) -> float:
        """Density over that of the prior, at a point in these bins; idle ones have no part."""
        return math.prod(
            float(mine[number] / prior[number])
            for number, mine, prior in zip(bins, self.probabilities, self._priors, strict=True)
            if number != IDLE
        )


def prior_product(space: Space) -> Product:
    """The prior as such a distribution."""
    return Product(space, (np.array(dimension.prior) for dimension in space))


def _cumulative(probabilities: Floats) -> Floats:
    total = np.cumsum(probabilities)
    return np.concatenate(([0.0], total / total[-1]))
