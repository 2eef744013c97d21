"""Bayesian optimisation: the next run where a Gaussian process expects most improvement."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from taxinet_ros.campaign.samplers.draws import as_point, generator, prior_point
from taxinet_ros.campaign.samplers.optuna_study import new_study, quiet
from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.samplers.space import Point, Space

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial


class Bayes:
    """Optuna's Gaussian process (Matérn 5/2, log expected improvement) on a window of the results.

    A fit's cost grows with the cube of its points, so it sees the best and the latest of them only.
    Improvement is that of the next run together with those under way, which keeps it away from
    them. Each point follows from the seed, its number and the results alone.

    Categories are categories to the process. Which one it tries next has nothing to do with their
    shares under the prior; those rule the plain draws at the start.
    """

    def __init__(self, space: Space, seed: int, *, startup: int = 10, window: int = 100) -> None:
        """Know nothing yet.

        Args:
            space: what to search.
            seed: of the campaign.
            startup: results from which on the process is used; plain draws before.
            window: most results it is fitted to, half of them the best and half the latest.
        """
        self._seed = seed
        self._startup = startup
        self._window = window
        self._space = space
        self._distributions = _distributions(space)
        self._points: list[Point] = []
        self._asked: list[int] = []
        self._results: dict[int, float] = {}
        self._pending: set[int] = set()

    def ask(self) -> Point:
        """The next point."""
        index = len(self._points)
        self._asked.append(index)
        if len(self._results) < self._startup:
            point = prior_point(len(self._space), self._seed, index)
        else:
            point = self._improvement(index)
        self._points.append(point)
        self._pending.add(index)
        return point

    def tell(self, index: int, rho: float | None) -> None:
        """Take a result in."""
        number = self._asked[index]
        self._pending.remove(number)
        if rho is not None:
            self._results[number] = rho

    def add(self, point: Point, rho: float) -> None:
        """Take in the result of a point that was not asked for."""
        self._points.append(point)
        self._results[len(self._points) - 1] = rho

    def learned(self) -> Probabilities:
        """Nothing that could be shown."""
        return {}

    def _improvement(self, index: int) -> Point:
        from optuna.samplers import GPSampler

        seed = int(generator(self._seed, index).integers(1 << 30))
        # Matrices as small as these are slowed down tenfold by BLAS threads on a busy machine.
        with quiet(), threadpool_limits(limits=1):
            study = new_study(GPSampler(seed=seed, n_startup_trials=1))
            study.add_trials(self._trials())
            trial = study.ask(self._distributions)
        return self._point(trial.params)

    def _trials(self) -> list[FrozenTrial]:
        """The results in the window, and the runs under way."""
        from optuna.trial import TrialState, create_trial

        chosen = in_window(self._results, self._window)
        values = finite([self._results[index] for index in chosen])
        done = dict(zip(chosen, values, strict=True))
        return [
            create_trial(
                state=TrialState.COMPLETE if index in done else TrialState.RUNNING,
                value=done.get(index), params=self._params(self._points[index]),
                distributions=self._distributions,
            )
            for index in (*chosen, *sorted(self._pending))
        ]

    def _params(self, point: Point) -> dict[str, float | int]:
        return {
            each.name: each.bin(quantile) if each.discrete else quantile
            for each, quantile in zip(self._space, point, strict=True)
        }

    def _point(self, params: Mapping[str, float | int]) -> Point:
        """The point of the parameters, in the middle of a category's interval."""
        found = []
        for dimension in self._space:
            value = params[dimension.name]
            if dimension.discrete:
                value = sum(dimension.edges[int(value) : int(value) + 2]) / 2
            found.append(value)
        return as_point(found)


def _distributions(space: Space) -> dict[str, BaseDistribution]:
    """What Optuna is to search: quantiles, and numbers of possible categories."""
    from optuna.distributions import CategoricalDistribution, FloatDistribution

    return {
        each.name: CategoricalDistribution(
            [number for number, share in enumerate(each.prior) if share > 0]
        ) if each.discrete else FloatDistribution(0.0, 1.0)
        for each in space
    }


def in_window(results: Mapping[int, float], window: int) -> list[int]:
    """Numbers of the runs to fit, at most ``window`` of them: half the best, half the latest.

    Args:
        results: robustness by number of the run, in the order of the runs.
        window: 2 or more.
    """
    best_of = window // 2
    latest = list(results)[-(window - best_of):]
    older = [index for index in results if index < latest[0]]
    best = sorted(older, key=lambda index: (results[index], -index))[:best_of]
    return sorted(best) + latest


def finite(values: list[float]) -> list[float]:
    """The values, infinite ones at the ends of the others' range."""
    known = [value for value in values if math.isfinite(value)] or [0.0]
    return [min(max(value, min(known)), max(known)) for value in values]
