"""Optimisers of Optuna behind our interface: TPE, CMA-ES, and Bayesian optimisation.

They minimise the robustness over quantiles, so categories keep the share that the prior gives
them. The density of what they propose is unknown, so no rate can be estimated from their runs.
Optuna is imported when it is needed.

To TPE a dimension that may be idle is a conditional parameter, known in the trials that have
it. CMA-ES knows no such thing and would draw it blindly ever after; it moves all of them all
the time, and the coordinates of idle ones are dropped. Bayesian optimisation takes the next run
where a Gaussian process expects most improvement.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.samplers.space import (
    BELOW_ONE,
    IDLE,
    Dimension,
    Point,
    Space,
    prior_point,
    run_generator,
)

if TYPE_CHECKING:
    from optuna import Study, Trial
    from optuna.distributions import BaseDistribution
    from optuna.samplers import BaseSampler
    from optuna.trial import FrozenTrial


SEEDS = 1 << 32
"""Optuna's seeds are below this."""


class StudySampler:
    """One study of Optuna, a trial a run."""

    def __init__(self, space: Space, sampler: BaseSampler, *, conditional: bool) -> None:
        """Start the study.

        Args:
            space: what to search.
            sampler: of Optuna, fresh and seeded.
            conditional: whether it knows parameters that are not in every trial.
        """
        self._space = space
        self._conditional = conditional
        self._trials: list[int] = []
        with quiet():
            self._study = new_study(sampler)

    def ask(self) -> Point:
        """The next point."""
        self._trials.append(-1)
        return self._suggested()

    def again(self) -> Point:
        """Another trial; the refused one has failed."""
        self.tell(len(self._trials) - 1, None)
        return self._suggested()

    def _suggested(self) -> Point:
        with quiet():
            trial = self._begun()
            self._trials[-1] = trial.number
            if not self._conditional:
                return self._space.point(trial.params.values())
            quantiles: list[float] = []
            bins: list[int] = []
            for name, dimension in zip(_names(self._space), self._space, strict=True):
                active = self._space.active(len(bins), bins)
                quantile = min(trial.suggest_float(name, 0.0, 1.0), BELOW_ONE) if active else 0.0
                quantiles.append(quantile)
                bins.append(dimension.bin(quantile) if active else IDLE)
            return self._space.point(quantiles)

    def _begun(self) -> Trial:
        from optuna.distributions import FloatDistribution

        if self._conditional:
            return self._study.ask()
        unit = FloatDistribution(0.0, 1.0)
        return self._study.ask(dict.fromkeys(_names(self._space), unit))

    def tell(self, index: int, rho: float | None) -> None:
        """Report a trial; one without a result has failed."""
        from optuna.trial import TrialState

        with quiet():
            if rho is None:
                self._study.tell(self._trials[index], state=TrialState.FAIL)
            else:
                self._study.tell(self._trials[index], rho)

    def add(self, point: Point, rho: float) -> None:
        """Take in the result of a point that was not asked for. CMA-ES makes nothing of it."""
        from optuna.distributions import FloatDistribution
        from optuna.trial import create_trial

        if not self._conditional:
            return
        known = {
            name: quantile for name, quantile in zip(_names(self._space), point, strict=True)
            if quantile is not None
        }
        unit = FloatDistribution(0.0, 1.0)
        with quiet():
            self._study.add_trial(create_trial(
                value=rho, params=known, distributions=dict.fromkeys(known, unit),
            ))

    def weight(self, index: int) -> None:
        """Unknown."""

    def learned(self) -> Probabilities:
        """Nothing that could be shown."""
        return {}


def tpe(space: Space, seed: int, *, startup: int) -> StudySampler:
    """Tree-structured Parzen estimator (Bergstra et al., NeurIPS 2011), all dimensions together.

    Args:
        space: what to search.
        seed: of the campaign.
        startup: results from which on it is used; plain draws before.
    """
    from optuna.samplers import TPESampler

    with quiet():
        sampler = TPESampler(
            seed=seed % SEEDS, n_startup_trials=startup, multivariate=True, constant_liar=True,
            group=any(dimension.when for dimension in space),
        )
    return StudySampler(space, sampler, conditional=True)


def cmaes(space: Space, seed: int, *, population: int) -> StudySampler:
    """CMA-ES (Hansen, arXiv:1604.00772), which begins in the middle of the prior.

    It settles on one minimum and stays there.

    Args:
        space: what to search.
        seed: of the campaign.
        population: runs per generation; 0 for the usual, 4 + 3 ln(dimensions).
    """
    from optuna.samplers import CmaEsSampler

    sampler = CmaEsSampler(
        seed=seed % SEEDS, popsize=population or None, warn_independent_sampling=False,
    )
    return StudySampler(space, sampler, conditional=False)


def _names(space: Space) -> list[str]:
    """Of the dimensions in a study; they sort as the dimensions do."""
    return [f'{number:04d}' for number in range(len(space))]


def new_study(sampler: BaseSampler) -> Study:
    """An empty study in memory that minimises."""
    import optuna

    return optuna.create_study(sampler=sampler, study_name='samplers')


@contextmanager
def quiet() -> Iterator[None]:
    """Optuna without its log of every trial, and without its remarks on what is experimental."""
    import optuna

    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            yield
    finally:
        optuna.logging.set_verbosity(before)


PATIENCE = 8
"""After so many refused points of one run it is drawn from the prior: the process is not told where
the requirements do not hold, and might never leave."""


class Bayes:
    """Optuna's Gaussian process (Matérn 5/2, log expected improvement) on a window of the results.

    A fit's cost grows with the cube of its points, so it sees the best and the latest of them only.
    Improvement is that of the next run together with those under way, which keeps it away from
    them. Each point follows from the seed, its number and the results alone.

    Categories are categories to the process. Which one it tries next has nothing to do with their
    shares under the prior; those rule the plain draws at the start. A dimension that is idle in a
    run is put at one and the same value there, so it makes no difference among such runs; what the
    process proposes for it is dropped.
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
        self._refused: list[Point] = []

    def ask(self) -> Point:
        """The next point."""
        self._asked.append(len(self._points))
        self._points.append(())
        self._refused = []
        return self._next()

    def again(self) -> Point:
        """Another point for the same run, away from the refused ones; after some, a plain draw."""
        self._refused.append(self._points[-1])
        return self._next()

    def _next(self) -> Point:
        index, attempt = len(self._points) - 1, len(self._refused)
        self._pending.discard(index)
        if len(self._results) < self._startup or attempt > PATIENCE:
            self._points[-1] = prior_point(self._space, self._seed, index, attempt)
        else:
            self._points[-1] = self._improvement(index, attempt)
        self._pending.add(index)
        return self._points[-1]

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

    def weight(self, index: int) -> None:
        """Unknown."""

    def learned(self) -> Probabilities:
        """Nothing that could be shown."""
        return {}

    def _improvement(self, index: int, attempt: int) -> Point:
        from optuna.samplers import GPSampler

        seed = int(run_generator(self._seed, index, attempt).integers(1 << 30))
        # Matrices as small as these are slowed down tenfold by BLAS threads on a busy machine.
        with quiet(), threadpool_limits(limits=1):
            study = new_study(GPSampler(seed=seed, n_startup_trials=1))
            study.add_trials(self._trials())
            trial = study.ask(self._distributions)
        return self._point(trial.params)

    def _trials(self) -> list[FrozenTrial]:
        """The results in the window, the runs under way, and the points refused for this one."""
        from optuna.trial import TrialState, create_trial

        chosen = in_window(self._results, self._window)
        values = finite([self._results[index] for index in chosen])
        known: list[tuple[Point, float | None]] = [
            *((self._points[index], value) for index, value in zip(chosen, values, strict=True)),
            *((self._points[index], None) for index in sorted(self._pending)),
            *((point, None) for point in self._refused),
        ]
        return [
            create_trial(
                state=TrialState.RUNNING if value is None else TrialState.COMPLETE, value=value,
                params=self._params(point), distributions=self._distributions,
            )
            for point, value in known
        ]

    def _params(self, point: Point) -> dict[str, float | int]:
        return {
            each.name: self._constant(each) if quantile is None
            else each.bin(quantile) if each.discrete else quantile
            for each, quantile in zip(self._space, point, strict=True)
        }

    @staticmethod
    def _constant(dimension: Dimension) -> float | int:
        """Where a dimension is put while it is idle."""
        return int(np.argmax(dimension.prior)) if dimension.discrete else 0.5

    def _point(self, params: Mapping[str, float | int]) -> Point:
        """The point of the parameters, in the middle of a category's interval."""
        found: list[float] = []
        for dimension in self._space:
            value = params[dimension.name]
            if dimension.discrete:
                value = sum(dimension.edges[int(value) : int(value) + 2]) / 2
            found.append(value)
        return self._space.point(found)


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
