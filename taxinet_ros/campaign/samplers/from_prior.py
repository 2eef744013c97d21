"""Samplers that follow the prior and learn nothing: plain draws, Halton's and Sobol's points."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from taxinet_ros.campaign.samplers.draws import prior_point
from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.samplers.space import Point, Space

if TYPE_CHECKING:
    from scipy.stats import qmc

BLOCK = 256
"""Points that are computed at once; a power of two, as Sobol's wants."""


class FromPrior:
    """What is the same for all of them: every weight is 1, and results change nothing."""

    def tell(self, index: int, rho: float | None) -> None:
        """Nothing is learned."""

    def weight(self, index: int) -> float:
        """1: the point is distributed as the prior says."""
        return 1.0

    def learned(self) -> Probabilities:
        """Nothing."""
        return {}


class Random(FromPrior):
    """Independent draws: run i's point depends on the seed and i only."""

    def drawn(self, index: int) -> bool:
        """True: every one."""
        return True

    def __init__(self, space: Space, seed: int) -> None:
        self._space = space
        self._seed = seed
        self._index, self._attempt = -1, 0

    def ask(self) -> Point:
        """The next point."""
        self._index, self._attempt = self._index + 1, 0
        return prior_point(self._space, self._seed, self._index)

    def again(self) -> Point:
        """Another draw for the same run."""
        self._attempt += 1
        return prior_point(self._space, self._seed, self._index, self._attempt)


class QuasiRandom(FromPrior):
    """Points that leave smaller gaps than independent ones, each by itself uniform.

    A refused point is replaced by a plain draw. The sequence's next point would depend on the one
    before it, and with a requirement that holds in some runs only, so would where runs end up.
    """

    def __init__(self, space: Space, seed: int, engine: qmc.QMCEngine) -> None:
        self._space = space
        self._seed = seed
        self._points = _points(space, engine)
        self._index, self._attempt = -1, 0

    def ask(self) -> Point:
        """The next point."""
        self._index, self._attempt = self._index + 1, 0
        return next(self._points)

    def again(self) -> Point:
        """A draw for the same run."""
        self._attempt += 1
        return prior_point(self._space, self._seed, self._index, self._attempt)


def halton(space: Space, seed: int) -> QuasiRandom:
    """Halton's sequence, its digits permuted at random (Owen, arXiv:1706.02808)."""
    from scipy.stats import qmc  # half a second that only these two are worth

    return QuasiRandom(space, seed, qmc.Halton(len(space), scramble=True, rng=seed))


def sobol(space: Space, seed: int) -> QuasiRandom:
    """Sobol's sequence, scrambled (Owen, Journal of Complexity 14, 1998).

    It is best balanced after a number of runs that is a power of two: take 1024 rather than 1000.
    """
    from scipy.stats import qmc

    return QuasiRandom(space, seed, qmc.Sobol(len(space), scramble=True, rng=seed))


def _points(space: Space, engine: qmc.QMCEngine) -> Iterator[Point]:
    while True:
        yield from map(space.point, engine.random(BLOCK))
