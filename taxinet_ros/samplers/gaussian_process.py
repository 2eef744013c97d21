"""A Gaussian process over the points of a search space: a model of the robustness."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import numpy.typing as npt
from threadpoolctl import ThreadpoolController

from taxinet_ros.samplers.histogram import Floats
from taxinet_ros.samplers.space import Space

Predict = Callable[[Floats], tuple[Floats, Floats]]
"""Mean and standard deviation of the scaled robustness at the features of some points."""


class Features:
    """Points as feature rows: one column per quantile, and one per category."""

    def __init__(self, space: Space) -> None:
        self._space = space
        self._numbers = {dimension.name: number for number, dimension in enumerate(space)}
        self.owners = np.repeat(
            np.arange(len(space)), [len(each.weights) or 1 for each in space]
        )
        self._rows = np.zeros((64, len(self.owners)))
        self._size = 0

    def append(self, quantiles: Floats) -> None:
        """Store the features of one more point."""
        if self._size == len(self._rows):
            self._rows = np.vstack((self._rows, np.zeros_like(self._rows)))
        self._rows[self._size] = self.of(quantiles[None])[0]
        self._size += 1

    def rows(self, numbers: Sequence[int]) -> Floats:
        """Features of stored points."""
        return self._rows[np.array(numbers, np.intp)]

    def per_column(self, values: Floats) -> Floats:
        """Repeat each dimension's value for each of its columns."""
        return values[self.owners]

    def of(self, quantiles: Floats) -> Floats:
        """Features of points; the quantile of an idle dimension, or NaN, has no effect.

        The squared distance between two categories is 1, as between the two ends of a dimension.
        """
        columns: list[Floats] = []
        bins: list[npt.NDArray[np.intp]] = []
        for dimension, given in zip(self._space, quantiles.T, strict=True):
            active = np.full(len(given), not dimension.when)
            for parent, categories in dimension.when:
                active |= np.isin(bins[self._numbers[parent]], categories)
            within = np.where(active, given, 0.5)
            bins.append(np.full(len(given), -1))
            if dimension.discrete:
                bins[-1][active] = np.searchsorted(dimension.edges, within[active], 'right') - 1
                taken = bins[-1][:, None] == np.arange(len(dimension.weights))
                columns.append(taken / math.sqrt(2))
            else:
                columns.append(within[:, None])
        return np.hstack(columns)


class GaussianProcess:
    """A Gaussian process with a constant mean and a Matérn 3/2 kernel.

    Mean and variance are maximum-likelihood estimates. The logarithms of the length scales and of
    the noise's share of the variance are maximum a posteriori estimates; the prior favours length
    scales that grow with the number of dimensions (Hvarfner et al., Vanilla Bayesian Optimization
    Performs Great in High Dimensions, ICML 2024).
    """

    def __init__(self, features: Features) -> None:
        self._features = features
        dimensions = int(features.owners[-1]) + 1
        self._usual = np.log([*[0.5 * math.sqrt(dimensions)] * dimensions, 1e-3])
        self._spread = np.array([*[1.0] * dimensions, 2.0])
        self._bounds = np.log([*[(0.03, 30.0)] * dimensions, (1e-6, 1.0)])
        self._logs = self._usual

    @property
    def length_scales(self) -> Floats:
        """Length scale of each dimension [quantiles]."""
        return np.exp(self._logs[:-1])

    def fit(self, known: Floats, results: Floats) -> None:
        """Fit the length scales and the noise to results at the given features."""
        from scipy.linalg import cho_factor, cho_solve
        from scipy.optimize import minimize

        runs, dimensions = len(results), len(self._usual) - 1
        squares = np.zeros((dimensions, runs, runs))
        for owner, column in zip(self._features.owners, known.T, strict=True):
            squares[owner] += np.square(column[:, None] - column)
        flat = squares.reshape(dimensions, -1)
        unit = np.eye(runs)

        def loss(logs: Floats) -> tuple[float, Floats]:
            """Negative log posterior and its gradient."""
            inverse, noise = np.exp(-2 * logs[:-1]), math.exp(logs[-1])
            away = np.sqrt(3 * (inverse @ flat)).reshape(runs, runs)
            falling = np.exp(-away)
            factor = cho_factor((1 + away) * falling + noise * unit, lower=True)
            precision = cho_solve(factor, unit)
            weights, variance = _explained(precision, results)
            off = (logs - self._usual) / self._spread
            value = runs / 2 * math.log(variance) + np.log(np.diag(factor[0])).sum() + off @ off / 2
            change = np.outer(weights, weights) / variance - precision
            slopes = 3 * inverse * (flat @ (change * falling).ravel())
            gradient = -np.append(slopes, noise * np.trace(change)) / 2
            return float(value), gradient + off / self._spread

        self._logs = minimize(
            loss, self._logs, jac=True, method='L-BFGS-B', bounds=self._bounds,
            options={'maxiter': 20},
        ).x

    def conditioned(self, known: Floats, results: Floats, others: Floats) -> Predict:
        """Predictor conditioned on results, and on other points with their expected result."""
        from scipy.linalg import cho_solve, solve_triangular

        runs, points = len(results), np.vstack((known, others))
        noise = math.exp(self._logs[-1])
        root = np.linalg.cholesky(self._kernel(points, points) + noise * np.eye(len(points)))
        precision = cho_solve((root[:runs, :runs], True), np.eye(runs))
        weights, variance = _explained(precision, results)
        mean = _mean(precision, results)

        def predict(features: Floats) -> tuple[Floats, Floats]:
            kernel = self._kernel(features, points)
            gain = solve_triangular(root, kernel.T, lower=True, check_finite=False)
            left = np.maximum(1 - np.square(gain).sum(axis=0), 1e-9)
            return mean + kernel[:, :runs] @ weights, np.sqrt(variance * left)

        return predict

    def _kernel(self, ones: Floats, others: Floats) -> Floats:
        scales = self._features.per_column(self.length_scales)
        away = np.sqrt(3 * squared_distances(ones / scales, others / scales))
        correlation: Floats = (1 + away) * np.exp(-away)
        return correlation


@cache
def blas_threads() -> ThreadpoolController:
    """Controller of the BLAS threads of NumPy and SciPy; cached: the look-up takes 1 ms."""
    import scipy.linalg  # noqa: F401 (has a library of its own)

    return ThreadpoolController()


def _mean(precision: Floats, results: Floats) -> float:
    """Maximum-likelihood estimate of the constant mean."""
    return float(precision.sum(axis=0) @ results / precision.sum())


def _explained(precision: Floats, results: Floats) -> tuple[Floats, float]:
    """Weight of each result in a prediction, and the maximum-likelihood variance."""
    off = results - _mean(precision, results)
    weights: Floats = precision @ off
    return weights, max(float(weights @ off) / len(results), 1e-12)


def squared_distances(ones: Floats, others: Floats) -> Floats:
    """Squared distance between each row of one array and each row of the other."""
    squares = np.square(ones).sum(axis=1)[:, None] + np.square(others).sum(axis=1)
    apart: Floats = np.maximum(squares - 2 * ones @ others.T, 0.0)
    return apart
