"""Optimisers of Optuna behind our interface: TPE and CMA-ES, which minimise the robustness.

They optimise over quantiles, so categories keep the share that the prior gives them. The density of
what they propose is unknown, so no rate can be estimated from their runs. Optuna is imported when
it is needed.

To TPE a dimension that may be idle is a conditional parameter, known in the trials that have it.
CMA-ES knows no such thing and would draw it blindly ever after; it moves all of them all the time,
and the coordinates of idle ones are dropped.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.samplers.space import BELOW_ONE, IDLE, Point, Space

if TYPE_CHECKING:
    from optuna import Study, Trial
    from optuna.samplers import BaseSampler

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
