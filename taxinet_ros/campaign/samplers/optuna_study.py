"""Optimisers of Optuna behind our interface: TPE and CMA-ES, which minimise the robustness.

They optimise over quantiles, so categories keep the share that the prior gives them. The density of
what they propose is unknown, so no rate can be estimated from their runs. Optuna is imported when
it is needed.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from taxinet_ros.campaign.samplers.draws import as_point
from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.samplers.space import Point, Space

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution
    from optuna.samplers import BaseSampler

SEEDS = 1 << 32
"""Optuna's seeds are below this."""


class StudySampler:
    """One study of Optuna, a trial a run."""

    def __init__(self, space: Space, sampler: BaseSampler) -> None:
        """Start the study.

        Args:
            space: what to search.
            sampler: of Optuna, fresh and seeded.
        """
        self._distributions = _unit_distributions(space)
        with quiet():
            self._study = new_study(sampler)
        self._trials: list[int] = []

    def ask(self) -> Point:
        """The next point."""
        with quiet():
            trial = self._study.ask(self._distributions)
        self._trials.append(trial.number)
        return as_point(trial.params[name] for name in self._distributions)

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
        from optuna.trial import create_trial

        with quiet():
            self._study.add_trial(create_trial(
                value=rho, params=dict(zip(self._distributions, point, strict=True)),
                distributions=self._distributions,
            ))

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
        )
    return StudySampler(space, sampler)


def cmaes(space: Space, seed: int, *, population: int) -> StudySampler:
    """CMA-ES (Hansen, arXiv:1604.00772), which begins in the middle of the prior.

    It settles on one minimum and stays there.

    Args:
        space: what to search.
        seed: of the campaign.
        population: runs per generation; 0 for the usual, 4 + 3 ln(dimensions).
    """
    from optuna.samplers import CmaEsSampler

    return StudySampler(space, CmaEsSampler(
        seed=seed % SEEDS, popsize=population or None, warn_independent_sampling=False,
    ))


def _unit_distributions(space: Space) -> dict[str, BaseDistribution]:
    """The unit interval for each dimension, under names that sort as the dimensions do."""
    from optuna.distributions import FloatDistribution

    return {f'{number:04d}': FloatDistribution(0.0, 1.0) for number in range(len(space))}


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
