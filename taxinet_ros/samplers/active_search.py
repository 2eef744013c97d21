"""Active search: find diverse failures with a Gaussian process model of the robustness."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taxinet_ros.samplers.gaussian_process import (
    Features,
    GaussianProcess,
    Predict,
    blas_threads,
    squared_distances,
)
from taxinet_ros.samplers.histogram import Floats
from taxinet_ros.samplers.sampler import Proposer
from taxinet_ros.samplers.space import Point, Space, prior_point, run_generator

WINDOW = 300
"""Most results the process is conditioned on; prediction cost grows with its square."""

FITTED = 150
"""Most results used to fit the length scales; fitting cost grows with its cube."""

REFIT = 1.1
"""Refit the length scales when the number of results has grown by this factor."""

CANDIDATES = 256
"""Candidates drawn from the whole space, in addition to those near known points."""

PARENTS = 16
"""Number of lowest results, and of random failures, near which candidates are added."""

ELITE = 8
"""Number of candidates to refine, and of points to try around each."""

STEPS = (0.15, 0.1, 0.03)
"""Standard deviation of a candidate's distance from its origin, round by round [quantiles]."""

MISSES = 50
"""Most recent runs without a result, and rejected points, to avoid."""

PATIENCE = 8
"""Rejected points of one run after which it is drawn from the prior."""

CEILING = 3.0
"""Robustness is clipped at this multiple of the median passing robustness."""


class ActiveSearch(Proposer):
    """Chooses the point most likely to be a failure unlike the known ones.

    Finding as many members of a rare class as possible is active search (Garnett et al., Bayesian
    Optimal Active Search and Surveying, ICML 2012); finding diverse ones is covering the set of
    failures at a resolution (Malkomes et al., Beyond the Pareto Efficient Frontier: Constraint
    Active Search for Multiobjective Experimental Design, ICML 2021). Here a point's score is the
    probability of a robustness of 0 or less, times the share of its neighbourhood that no known
    failure covers, times the share of neighbouring runs that have a result. While failures are
    improbable everywhere, the score equals the probability of improvement over a fixed target,
    which trades off low means against high uncertainty (Jones, Journal of Global Optimization 21,
    2001).

    Runs alternate between two measures of novelty. Every second run measures the distance to known
    failures in the process's length scales, to find new regions. The others weight all dimensions
    equally, to spread points within the regions.

    The process has a Matérn 3/2 kernel with one length scale per dimension, which identifies
    irrelevant dimensions. Categories are compared for equality only. An idle dimension is given a
    constant value, so it makes no difference among the runs that lack it (imputation; Hutter and
    Osborne, arXiv:1310.5738, compare it with other kernels). Runs in flight count as points with
    the expected result (Ginsbourger et al., Kriging is well-suited to parallelize optimization,
    2010).
    """

    def __init__(self, space: Space, seed: int, *, radius: float = 0.1) -> None:
        """Create the sampler without any results.

        Args:
            space: the space to search.
            seed: seed of the campaign.
            radius: distance from a failure within which other failures are not new [quantiles],
                above 0.
        """
        self._space = space
        self._seed = seed
        self._radius = radius
        self._features = Features(space)
        self._process = GaussianProcess(self._features)
        self._quantiles: list[Floats] = []
        self._asked: list[int] = []
        self._attempt = 0
        self._pending: list[int] = []
        self._misses: list[int] = []
        self._results: dict[int, float] = {}
        self._window: list[int] = []
        self._fit_at = 0.0

    def ask(self) -> Point:
        """The next point."""
        self._attempt = 0
        self._asked.append(len(self._quantiles))
        return self._next()

    def again(self) -> Point:
        """Another point for the same run, away from rejected ones; finally a prior draw."""
        self._attempt += 1
        if (number := self._pending.pop()) not in self._results:
            self._misses.append(number)
        self._asked[-1] = len(self._quantiles)
        return self._next()

    def refuse(self, rho: float) -> None:
        """See :class:`.HearsRefusals`."""
        self._learn(self._pending[-1], rho)

    def tell(self, index: int, rho: float | None) -> None:
        """Record a result."""
        number = self._asked[index]
        self._pending.remove(number)
        if rho is None:
            self._misses.append(number)
        else:
            self._learn(number, rho)

    def add(self, point: Point, rho: float) -> None:
        """Record the result of a point that this sampler did not propose."""
        self._learn(self._keep(point), rho)

    def _next(self) -> Point:
        run = len(self._asked) - 1
        if self._attempt > PATIENCE:
            point = prior_point(self._space, self._seed, run, self._attempt)
        else:
            chance = run_generator(self._seed, run, self._attempt)
            # On a busy machine BLAS threads slow down matrices of this size.
            with blas_threads().limit(limits=1):
                point = self._space.point(self._chosen(run, chance))
        self._pending.append(self._keep(point))
        return point

    def _keep(self, point: Point) -> int:
        """Store a point; return its number."""
        self._quantiles.append(np.array(point, np.float64))  # None becomes NaN
        self._features.append(self._quantiles[-1])
        return len(self._quantiles) - 1

    def _learn(self, number: int, rho: float) -> None:
        """Store a result; drop the older of the two most similar points in a full window."""
        self._results[number] = rho
        self._window.append(number)
        if len(self._window) > WINDOW:
            rows = self._features.rows(self._window)
            apart = squared_distances(rows, rows)
            np.fill_diagonal(apart, np.inf)
            del self._window[min(divmod(int(apart.argmin()), len(rows)))]

    def _chosen(self, run: int, chance: np.random.Generator) -> Floats:
        """Quantiles of the next point."""
        results = np.array([self._results[number] for number in self._window])
        # If all results are equal, only distance can guide the search.
        if len(self._quantiles) < 8 + 2 * len(self._space) or len(set(results)) < 2:
            return self._farthest(chance)
        scaled = _scaled(results)
        known = self._features.rows(self._window)
        if len(self._results) >= self._fit_at:
            some = np.sort(chance.permutation(len(scaled))[:FITTED])
            self._process.fit(known[some], scaled[some])
            self._fit_at = REFIT * len(self._results)
        others = self._features.rows([*self._pending, *self._misses[-MISSES:]])
        predict = self._process.conditioned(known, scaled, others)
        score = self._score(predict, others, spread=run % 2 == 1)
        return self._highest(score, chance)

    def _farthest(self, chance: np.random.Generator) -> Floats:
        """The draw that is farthest from all points (best candidate; Mitchell, SIGGRAPH 1991)."""
        draws = chance.random((64, len(self._space)))
        if not self._quantiles:
            return draws[0]
        known = self._features.rows(range(len(self._quantiles)))
        apart = squared_distances(self._features.of(draws), known)
        best: Floats = draws[apart.min(axis=1).argmax()]
        return best

    def _score(
        self, predict: Predict, others: Floats, *, spread: bool
    ) -> Callable[[Floats], Floats]:
        """Logarithm of a point's score, as a function of its quantiles."""
        from scipy.special import log_ndtr, ndtr

        failures = self._features.rows(
            [number for number, rho in self._results.items() if rho <= 0]
        )
        if len(others):
            failures = np.vstack((failures, others[predict(others)[0] <= 0]))
        scales = self._process.length_scales
        matters = np.ones(len(scales)) if spread else scales.min() / scales
        weights = self._features.per_column(matters) / self._radius
        free = [not dimension.discrete for dimension in self._space]
        judged = self._features.rows(self._window)
        missed = self._features.rows(self._misses[-MISSES:])

        def near(features: Floats, points: Floats) -> Floats:
            """Number of the points near each."""
            apart = squared_distances(features, points) / (2 * self._radius) ** 2
            beside: Floats = np.exp(-apart / 2).sum(axis=1)
            return beside

        def score(quantiles: Floats) -> Floats:
            features = self._features.of(quantiles)
            mean, deviation = predict(features)
            worth: Floats = log_ndtr(-mean / deviation)
            if len(failures):
                apart = squared_distances(features * weights, failures * weights)
                if spread:
                    apart = apart.min(axis=1, keepdims=True)
                worth += np.log(-np.expm1(-np.maximum(apart, 1e-12) / 2)).sum(axis=1)
            if len(missed):
                results = 1 + near(features, judged)
                worth += np.log(results / (results + near(features, missed)))
            if not spread:
                # The variance is highest at the edges, but half of their neighbourhood is outside.
                inside = quantiles[:, free]
                ends = (1 - inside) / self._radius, -inside / self._radius
                worth += np.log(ndtr(ends[0]) - ndtr(ends[1])).sum(axis=1)
            return worth

        return score

    def _highest(
        self, score: Callable[[Floats], Floats], chance: np.random.Generator
    ) -> Floats:
        """Quantiles of the candidate with the highest score, refined in rounds."""
        found = np.vstack((
            chance.random((CANDIDATES, len(self._space))),
            self._beside(self._parents(chance), STEPS[0], chance),
        ))
        scores = score(found)
        for step in STEPS[1:]:
            best = np.argsort(-scores, kind='stable')[:ELITE]
            near = self._beside(np.repeat(found[best], ELITE, axis=0), step, chance)
            found = np.vstack((found[best], near))
            scores = np.concatenate((scores[best], score(near)))
        highest: Floats = found[scores.argmax()]
        return highest

    def _parents(self, chance: np.random.Generator) -> Floats:
        """Known points near which failures may be; idle dimensions get a random value."""
        lowest = sorted(self._results, key=self._results.__getitem__)[:PARENTS]
        failures = [number for number, rho in self._results.items() if rho <= 0]
        picked = chance.permutation(len(failures))[:PARENTS]
        origins = np.array(lowest + [failures[each] for each in picked])
        some = chance.choice(origins, CANDIDATES // 2)
        parents = np.array([self._quantiles[number] for number in some])
        return np.where(np.isnan(parents), chance.random(parents.shape), parents)

    def _beside(self, origins: Floats, step: float, chance: np.random.Generator) -> Floats:
        """A point near each origin: some coordinates shifted, some categories redrawn."""
        discrete = np.array([dimension.discrete for dimension in self._space])
        moved = chance.random(origins.shape) < max(0.3, 1.5 / len(self._space))
        drawn = discrete & (chance.random(origins.shape) < 0.5)
        near = np.abs(origins + step * chance.standard_normal(origins.shape))
        near = np.where(discrete, origins, 1 - np.abs(1 - near))
        near = np.where(drawn, chance.random(origins.shape), near)
        found: Floats = np.where(moved, near, origins)
        return found


def _scaled(results: Floats) -> Floats:
    """Robustness over the median passing robustness; the severity of failures is ignored."""
    finite = np.abs(results[np.isfinite(results)])
    passing = finite[results[np.isfinite(results)] > 0]
    unit = float(np.median(passing if len(passing) else finite)) if len(finite) else 1.0
    return np.clip(results / (unit or 1.0), -1.0, CEILING)
