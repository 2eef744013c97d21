"""What every sampler can do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from taxinet_ros.campaign.samplers.space import Point

Probabilities = Mapping[str, tuple[float, ...]]
"""Probability of each category or bucket, by name of the dimension."""


class Sampler(Protocol):
    """Proposes points, and may learn from their results.

    A sampler's whole state follows from its space, its seed and the calls made, so it is restored
    by repeating them; there is no state to be saved.
    """

    def ask(self) -> Point:
        """The point of the next run: of run 0 at the first call, then of 1, 2 and so on."""

    def tell(self, index: int, rho: float | None) -> None:
        """Take the result of a run, in the order of the indices.

        Args:
            index: number of the run, which has been asked for.
            rho: its robustness, a failure where it is 0 or less; None where there is none (broken
                bench, rejected, interrupted), of which nothing is learned.
        """

    def weight(self, index: int) -> float | None:
        """Density of the prior over that of the proposal, at the point asked for run ``index``.

        Results multiplied by it have the mean of the prior. None where the density is unknown.
        """

    def drawn(self, index: int) -> bool:
        """Whether the point of run ``index`` was drawn from the program itself.

        That is: from the prior, independently of all other points, and whether it is drawn was
        settled by seed and index alone, never by a result. Rates rest on these runs and no others
        (:mod:`taxinet_ros.campaign.rates`).
        """

    def learned(self) -> Probabilities:
        """Where failures are, by what has been told; empty where the sampler has no idea of it."""
