"""Optuna optimisers as samplers: TPE, CMA-ES and Bayesian optimisation.

They minimise the robustness over quantiles, so categories keep their prior share. Their proposal
density is unknown, so no rate can be estimated from their runs. Optuna is imported on first use.

TPE treats a dimension that may be idle as a conditional parameter, present in the trials that have
it. CMA-ES has no conditional parameters; it always varies all dimensions, and the coordinates of
idle ones are dropped. Bayesian optimisation places the next run where a Gaussian process expects
the most improvement.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from taxinet_ros.samplers.sampler import Proposer
from taxinet_ros.samplers.space import (
    BELOW_ONE,
    IDLE,
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


class StudySampler(Proposer):
    """An Optuna study with one trial per run."""

    def __init__(self, space: Space, sampler: BaseSampler, *, conditional: bool) -> None:
        """Start the study.

        Args:
            space: the space to search.
            sampler: a fresh, seeded Optuna sampler.
            conditional: whether it supports parameters that are not in every trial.
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
        """Another trial; the rejected one is reported as failed, unless it was as a result."""
        if self._trials[-1] >= 0:
            self.tell(len(self._trials) - 1, None)
        return self._suggested()

    def refuse(self, rho: float) -> None:
        """See :class:`.HearsRefusals`."""
        self.tell(len(self._trials) - 1, rho)
        self._trials[-1] = -1

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
        """Report a trial; one without a result is reported as failed."""
        from optuna.trial import TrialState

        with quiet():
            if rho is None:
                self._study.tell(self._trials[index], state=TrialState.FAIL)
            else:
                self._study.tell(self._trials[index], rho)

    def add(self, point: Point, rho: float) -> None:
        """Record the result of a point that the study did not propose; CMA-ES ignores it."""
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


def tpe(space: Space, seed: int, *, startup: int) -> StudySampler:
    """Tree-structured Parzen estimator (Bergstra et al., NeurIPS 2011), all dimensions together.

    Args:
        space: the space to search.
        seed: seed of the campaign.
        startup: number of results before it is used; draws from the prior until then.
    """
    from optuna.samplers import TPESampler

    with quiet():
        sampler = TPESampler(
            seed=seed % SEEDS, n_startup_trials=startup, multivariate=True, constant_liar=True,
            group=any(dimension.when for dimension in space),
        )
    return StudySampler(space, sampler, conditional=True)


def cmaes(space: Space, seed: int, *, population: int) -> StudySampler:
    """CMA-ES (Hansen, arXiv:1604.00772), starting at the median of the prior.

    It converges to a single minimum.

    Args:
        space: the space to search.
        seed: seed of the campaign.
        population: runs per generation; 0 for the default, 4 + 3 ln(dimensions).
    """
    from optuna.samplers import CmaEsSampler

    sampler = CmaEsSampler(
        seed=seed % SEEDS, popsize=population or None, warn_independent_sampling=False,
    )
    return StudySampler(space, sampler, conditional=False)


def _names(space: Space) -> list[str]:
    """Parameter names of the dimensions in a study; they sort in dimension order."""
    return [f'{number:04d}' for number in range(len(space))]


def new_study(sampler: BaseSampler) -> Study:
    """An empty in-memory study that minimises."""
    import optuna

    return optuna.create_study(sampler=sampler, study_name='samplers')


@contextmanager
def quiet() -> Iterator[None]:
    """Silence Optuna's log of every trial and its warnings about experimental features."""
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
"""Rejected points of one run after which it is drawn from the prior: the process does not learn
where the requirements fail, and might never leave such a region."""


class Bayes(Proposer):
    """Optuna's Gaussian process (Matérn 5/2, log expected improvement) on a window of the results.

    Fitting cost grows with the cube of the points, so only the best and the latest are used. The
    improvement is computed jointly with the runs in flight, which keeps the next run away from
    them. Each point depends only on the seed, its number and the results.

    Categories are categorical parameters of the process. Their prior shares affect only the initial
    draws from the prior. A dimension that is idle in a run is given a constant value, so it makes
    no difference among such runs; the value proposed for it is dropped.
    """

    def __init__(self, space: Space, seed: int, *, startup: int = 10, window: int = 100) -> None:
        """Create the sampler without any results.

        Args:
            space: the space to search.
            seed: seed of the campaign.
            startup: number of results before the process is used; draws from the prior until then.
            window: most results to fit, half of them the best and half the latest.
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
        """Another point for the same run, away from rejected ones; finally a prior draw."""
        self._refused.append(self._points[-1])
        return self._next()

    def refuse(self, rho: float) -> None:
        """See :class:`.HearsRefusals`; the run goes on under another number."""
        number, self._asked[-1] = self._asked[-1], len(self._points)
        self._pending.discard(number)
        self._results[number] = rho
        self._points.append(self._points[number])

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
        """Record a result."""
        number = self._asked[index]
        self._pending.remove(number)
        if rho is not None:
            self._results[number] = rho

    def add(self, point: Point, rho: float) -> None:
        """Record the result of a point that this sampler did not propose."""
        self._points.append(point)
        self._results[len(self._points) - 1] = rho

    def _improvement(self, index: int, attempt: int) -> Point:
        from optuna.samplers import GPSampler

        seed = int(run_generator(self._seed, index, attempt).integers(1 << 30))
        # On a busy machine BLAS threads slow down matrices of this size tenfold.
        with quiet(), threadpool_limits(limits=1):
            study = new_study(GPSampler(seed=seed, n_startup_trials=1))
            study.add_trials(self._trials())
            trial = study.ask(self._distributions)
        return self._point(trial.params)

    def _trials(self) -> list[FrozenTrial]:
        """Trials: results in the window, runs in flight, and this run's rejected points."""
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
            each.name: (int(np.argmax(each.prior)) if each.discrete else 0.5) if quantile is None
            else each.bin(quantile) if each.discrete else quantile
            for each, quantile in zip(self._space, point, strict=True)
        }

    def _point(self, params: Mapping[str, float | int]) -> Point:
        """The point of the parameters; a category maps to the middle of its interval."""
        found: list[float] = []
        for dimension in self._space:
            value = params[dimension.name]
            if dimension.discrete:
                value = sum(dimension.edges[int(value) : int(value) + 2]) / 2
            found.append(value)
        return self._space.point(found)


def _distributions(space: Space) -> dict[str, BaseDistribution]:
    """Optuna's search space: quantiles, and indices of the possible categories."""
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
        results: robustness by number of the run, in the order in which they became known.
        window: 2 or more.
    """
    best_of = window // 2
    known = list(results)
    older, latest = known[:best_of - window], known[best_of - window:]
    best = sorted(older, key=lambda index: (results[index], -index))[:best_of]
    return sorted(best) + latest


def finite(values: list[float]) -> list[float]:
    """The values, with infinite ones clipped to the range of the finite ones."""
    known = [value for value in values if math.isfinite(value)] or [0.0]
    return [min(max(value, min(known)), max(known)) for value in values]
