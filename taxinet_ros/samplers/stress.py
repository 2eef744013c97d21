"""The sampler ``stress``: adaptive stress testing, towards the likeliest disturbances that fail.

The objective is that of adaptive stress testing (Lee et al., Journal of Artificial Intelligence
Research 69, 2020; Koren, Corso and Kochenderfer, arXiv:2004.04293): each step of a path that fails
is rewarded by the logarithm of its disturbance's likelihood, and a path that does not fail is worse
than any that does, by how far it was from failing; here that is its robustness.

Disturbances are normal choices of the program, so in their standard deviations the likelihood
falls with the distance from the origin alone, and the likeliest failure is the nearest: the design
point of structural reliability (Hasofer and Lind, Journal of the Engineering Mechanics Division
100, 1974). It is searched as there (Rackwitz and Fiessler, Computers and Structures 9, 1978): go to
the point of the linearised limit that is nearest to the origin. The slopes are those of a weighted
regression on the nearest results, as a simulation has no gradient.

Tree search over the steps, the usual method, is no part of it: at equal numbers of simulated steps
it found far less likely failures (benchmarks/RESULTS.md, written by ``benchmarks/stress.py``).
"""

from __future__ import annotations

import math

import numpy as np

from taxinet_ros.samplers.gaussian_process import blas_threads
from taxinet_ros.samplers.histogram import Floats
from taxinet_ros.samplers.sampler import Probabilities
from taxinet_ros.samplers.space import Point, Space, run_generator

NEAR = 0.5
"""Standard deviation of a step that explores, at most [standard deviations]."""
LONGEST = 1.5
"""Longest step towards the design point [standard deviations]."""
RIDGE = 1e-3
"""Weight of slopes of 0 in a regression, as a share of that of all results."""
GAIN = 2e-3
"""Relative improvement of a robustness or squared distance below which a start stands still."""


def deviations(point: Point) -> Floats:
    """A point in standard deviations of its choices from their means, if these are normal ones.

    Its logarithm of the likelihood, less that of the means, is minus half of the sum of squares.

    Args:
        point: the quantiles; that of an idle dimension counts as the mean's.

    Returns:
        Shape (dimensions,), each within ±9.
    """
    from scipy.special import ndtri

    quantiles = np.array([0.5 if quantile is None else quantile for quantile in point])
    return np.clip(ndtri(quantiles), -9.0, 9.0)


class Stress:
    """Sequential linearisation from one start after another.

    The first run is that of the means, and the first start. Another one, a draw of the program,
    follows where the best result since a start has stood still for a while: the rest of the runs
    looks for other regions. Half of the runs step towards the design point, half explore.
    """

    def __init__(self, space: Space, seed: int) -> None:
        """Create the sampler without any results.

        Args:
            space: the space to search.
            seed: seed of the campaign.
        """
        self._space = space
        self._seed = seed
        self._size = len(space)
        self._asked: list[Floats] = []
        self._points: list[Floats] = []
        self._rhos: list[float] = []
        self._runs: list[int] = []
        self._start = 0
        self._best = (math.inf, math.inf)
        self._gained = 0
        self._attempt = 0

    def ask(self) -> Point:
        """The next point."""
        self._attempt = 0
        self._asked.append(np.zeros(self._size))
        return self._next()

    def again(self) -> Point:
        """Another point for the same run."""
        self._attempt += 1
        return self._next()

    def tell(self, index: int, rho: float | None) -> None:
        """Record a result."""
        if rho is not None:
            self._learn(index, self._asked[index], rho)

    def add(self, point: Point, rho: float) -> None:
        """Record the result of a point that it did not propose."""
        self._learn(len(self._asked), deviations(point), rho)

    def weight(self, index: int) -> None:
        """None: the density is unknown."""

    def learned(self) -> Probabilities:
        """Empty: nothing is learned per dimension."""
        return {}

    def _learn(self, run: int, at: Floats, rho: float) -> None:
        self._runs.append(run)
        self._points.append(at)
        self._rhos.append(rho)

    def _next(self) -> Point:
        from scipy.special import ndtr

        run = len(self._asked) - 1
        chance = run_generator(self._seed, run, self._attempt)
        if run or self._attempt:
            # On a busy machine BLAS threads slow down matrices of this size.
            with blas_threads().limit(limits=1):
                self._asked[-1] = self._chosen(chance)
        point = self._space.point(ndtr(self._asked[-1]))
        self._asked[-1] = deviations(point)  # without what has no influence
        return point

    def _chosen(self, chance: np.random.Generator) -> Floats:
        """Deviations of the next point."""
        noise = chance.standard_normal(self._size)
        since = [number for number, run in enumerate(self._runs) if run >= self._start]
        if not since:
            return noise
        best = min(since, key=self._worth)
        worth = self._worth(best)
        if worth[0] < self._best[0] or worth[1] < self._best[1] - GAIN * abs(self._best[1]):
            self._best, self._gained = worth, len(self._rhos)
        elif len(self._rhos) - self._gained > 2 * self._size + 24:
            # Results of runs in flight belong to the start before.
            self._start, self._best = len(self._asked) - 1, (math.inf, math.inf)
            return noise
        at, slopes = self._points[best], self._slopes(best)
        steep = float(slopes @ slopes)
        if steep:  # to the point nearest to the origin that fails by the linear model
            step = slopes * ((slopes @ at - self._rhos[best]) / steep) - at
        elif self._rhos[best] <= 0:
            step = -at
        else:  # at first, or where nothing leads anywhere
            return at + NEAR * noise if len(self._rhos) <= self._size else noise
        length = math.sqrt(step @ step)
        step, length = step * min(1.0, LONGEST / (length or 1.0)), min(length, LONGEST)
        fine = length / math.sqrt(self._size)
        if chance.random() < 0.5:
            return at + min(max(fine, 0.02), NEAR) * noise
        return at + chance.uniform(0.3, 1.1) * step + 0.1 * fine * noise

    def _worth(self, number: int) -> tuple[float, float]:
        """The less the better: failures first, the likeliest before; then by robustness."""
        rho, at = self._rhos[number], self._points[number]
        return (0.0, float(at @ at)) if rho <= 0 else (1.0, rho)

    def _slopes(self, best: int) -> Floats:
        """Slopes of the robustness at a point, by regression on the results near it; or zeros."""
        at, rho = self._points[best], self._rhos[best]
        away = np.array(self._points) - at
        apart = np.square(away).sum(axis=1)
        finite = np.flatnonzero(np.isfinite(self._rhos) & (apart > 0))
        near = finite[np.argsort(apart[finite], kind='stable')][:2 * self._size + 8]
        if len(near) < 2 or not math.isfinite(rho):
            return np.zeros(self._size)
        wide = float(np.median(apart[near]))
        weights = np.exp(-apart[near] / (2 * wide))
        unit = math.sqrt(wide / self._size)
        known = away[near] / unit
        weighted = (known * weights[:, None]).T
        ridge = RIDGE * weights.sum() * np.eye(self._size)
        risen = np.array(self._rhos)[near] - rho
        slopes: Floats = np.linalg.solve(weighted @ known + ridge, weighted @ risen) / unit
        return slopes
