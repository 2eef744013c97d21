"""The results that a sampler has learned from, as arrays that grow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from taxinet_ros.campaign.samplers.product import Floats
from taxinet_ros.campaign.samplers.space import IDLE, Space

LEAST = 10
"""Failures from which on only failures are learned from."""

ELITE = 0.1
"""Share of the worst runs that are learned from as long as there are fewer."""

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
        """Keep one more."""
        if self._size == len(self._bins):
            self._bins = np.concatenate((self._bins, np.zeros_like(self._bins)))
            self._values = np.concatenate((self._values, np.zeros_like(self._values)))
        self._bins[self._size] = bins
        self._values[self._size] = weight, rho
        self._size += 1

    def sums(self, dimension: int, bins: int, amounts: Floats) -> Floats:
        """Total of the amounts in each of the ``bins`` bins of a dimension; not of idle runs."""
        mine = self.bins[:, dimension]
        active = mine != IDLE
        return np.bincount(mine[active], amounts[active], bins).astype(np.float64)

    @property
    def bins(self) -> npt.NDArray[np.intp]:
        """Bin of each run (first axis) in each dimension (second), ``IDLE`` where it has none."""
        return self._bins[: self._size]

    @property
    def weights(self) -> Floats:
        """Weight of each run."""
        return self._values[: self._size, 0]

    @property
    def rhos(self) -> Floats:
        """Robustness of each run."""
        return self._values[: self._size, 1]


def failures(rhos: Floats) -> npt.NDArray[np.bool_]:
    """Which runs count as failures to be learned from.

    Those with a robustness of 0 or less, as soon as there are :data:`LEAST` of them. Before that
    the worst runs are taken, as the cross-entropy method does on its way to a rare event
    (Rubinstein and Kroese, The Cross-Entropy Method, 2004): the :data:`ELITE`, at least as many.
    """
    failed = rhos <= 0
    if len(rhos) == 0 or np.count_nonzero(failed) >= LEAST:
        return failed
    rank = min(max(round(ELITE * len(rhos)), LEAST), len(rhos)) - 1
    level: Floats = np.partition(rhos, rank)[rank]
    return rhos <= level


def failure_histograms(space: Space, history: History) -> list[Floats]:
    """Estimate of the probability of each bin given a failure under the prior, per dimension.

    Of a dimension that may be idle: given a failure in which it is active.
    """
    amounts = np.where(failures(history.rhos), history.weights, 0.0)
    found = []
    for number, dimension in enumerate(space):
        prior = np.array(dimension.prior)
        mine = history.sums(number, len(prior), amounts)
        found.append((mine + STRENGTH * prior) / (mine.sum() + STRENGTH))
    return found
