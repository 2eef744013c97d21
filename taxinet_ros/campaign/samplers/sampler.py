"""What every sampler can do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from taxinet_ros.campaign.samplers.space import Point

Probabilities = Mapping[str, tuple[float, ...]]
"""Probability of each category or bucket, by name of the dimension."""


class Exhausted(Exception):  # noqa: N818 (an end, not a fault)
    """A sampler has proposed all the points that it has."""


class Sampler(Protocol):
    """Proposes points, and may learn from their results.

    A sampler's whole state follows from its space, its seed and the calls made, so it is restored
    by repeating them; there is no state to be saved.
    """

    def ask(self) -> Point:
        """The point of the next run: of run 0 at the first call, then of 1, 2 and so on.

        Raises:
            Exhausted: there is no other one; nothing is asked for any more.
        """

    def again(self) -> Point:
        """Another point for the run that was asked for last.

        The program's requirements refuse the former one. It counts for nothing, and nothing has
        been told since it was asked for. Accepted points are then distributed as the proposal is
        where the requirements hold.

        Raises:
            Exhausted: there is no other one.
        """

    def tell(self, index: int, rho: float | None) -> None:
        """Take the result of a run, in the order of the indices.

        Args:
            index: number of the run, which has been asked for.
            rho: its robustness, a failure where it is 0 or less; None where there is none (broken
                bench, rejected, interrupted), of which nothing is learned.
        """

    def weight(self, index: int) -> float | None:
        """Density of the prior over that of the proposal, at the last point of run ``index``.

        None where the density is unknown. Results multiplied by it have the mean of the prior, if
        no points were refused. Where some were, the mean of the weights is no longer 1, but the
        share of the requirements' space under the prior over that under the proposal, which nobody
        knows and which changes as a sampler learns; weighted sums over the sum of the weights
        (self-normalised) still tend to the mean of the prior where the requirements hold.
        """

    def drawn(self, index: int) -> bool:
        """Whether the point of run ``index`` was drawn from the program itself.

        That is: from the prior, independently of all other points, and whether it is drawn was
        settled by seed and index alone, never by a result. Rates rest on these runs and no others
        (:mod:`taxinet_ros.campaign.rates`).
        """

    def learned(self) -> Probabilities:
        """Where failures are, by what has been told; empty where the sampler has no idea of it."""
