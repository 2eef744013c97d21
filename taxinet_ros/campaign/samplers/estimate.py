"""The failure rate under the program's own distribution, from runs that a sampler has chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from taxinet_ros.campaign.rates import CONFIDENCE, Rate, rate, share_bounds
from taxinet_ros.campaign.samplers.product import Floats


@dataclass(frozen=True, kw_only=True, slots=True)
class Estimate:
    """A failure rate under the prior.

    Attributes:
        rate: with its 95 % interval: weighted failures over the sum of all weights.
        unnormalised: weighted failures over the number of runs. The more exact one where failures
            are rare; not to be used where scenes were rejected, for it is unbiased only if every
            run that was asked for has a result, or lacks it for reasons of the bench.
        runs: with a result.
        failures: of these, as they were.
        effective: number of independent draws from the prior with which a mean would be as exact
            (Kish, Survey Sampling, 1965): (sum of weights)² / sum of squares.
    """

    rate: Rate
    unnormalised: Rate
    runs: int
    failures: int
    effective: float


def estimate_rate(rhos: Sequence[float], weights: Sequence[float | None]) -> Estimate | None:
    """Failure rate under the prior.

    Where all weights are equal it is the share of failures with its Clopper-Pearson interval.
    Elsewhere the variance is that of the ratio to first order (delta method), and the interval is
    the Clopper-Pearson one for as many independent runs as would have that variance (Korn and
    Graubard, Survey Methodology 24, 1998). It stays within 0..1, and is not empty where all runs
    or none failed.

    Args:
        rhos: robustness of each run that has one; 0 or less is a failure.
        weights: density of the prior over that of the proposal, of each of these runs.

    Returns:
        None where the weight of a run is unknown.

    Raises:
        ValueError: the lengths differ, or a weight is not above 0.
    """
    if len(rhos) != len(weights):
        raise ValueError(f'{len(rhos)} results and {len(weights)} weights')
    known = [weight for weight in weights if weight is not None]
    if len(known) < len(weights):
        return None
    weight = np.array(known)
    if not np.all((weight > 0) & np.isfinite(weight)):
        raise ValueError('a weight is not above 0')
    failed = np.array(rhos) <= 0
    failures = int(np.count_nonzero(failed))
    if len(weight) == 0 or np.all(weight == 1):
        plain = rate(failures, len(weight))
        return Estimate(
            rate=plain, unnormalised=plain, runs=len(weight), failures=failures,
            effective=float(len(weight)),
        )
    return Estimate(
        rate=_normalised(weight, failed), unnormalised=_unnormalised(weight, failed),
        runs=len(weight), failures=failures, effective=effective_runs(weight),
    )


def weighted_share(weight: Floats, counted: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Share of the runs that count, and how many independent runs would know it as well."""
    share = float(weight[counted].sum() / weight.sum())
    variance = float(np.sum((weight * (counted - share)) ** 2) / weight.sum() ** 2)
    return share, _worth(share, variance, effective_runs(weight))


def effective_runs(weight: Floats) -> float:
    """Independent runs that know a mean as well (Kish, Survey Sampling, 1965); 0 for none."""
    return float(weight.sum() ** 2 / np.sum(weight**2)) if len(weight) else 0.0


def _normalised(weight: Floats, failed: npt.NDArray[np.bool_]) -> Rate:
    return _interval(*weighted_share(weight, failed))


def _unnormalised(weight: Floats, failed: npt.NDArray[np.bool_]) -> Rate:
    terms = np.where(failed, weight, 0.0)
    share = min(float(terms.mean()), 1.0)
    runs = _worth(share, float(terms.var()) / len(terms), effective_runs(weight))
    return _interval(share, runs)


def _worth(share: float, variance: float, otherwise: float) -> float:
    """How many independent runs give a share this variance.

    Args:
        share: 0..1.
        variance: of the share; says nothing where the share is 0 or 1.
        otherwise: number of runs to take then.
    """
    return share * (1 - share) / variance if variance > 0 and 0 < share < 1 else otherwise


def _interval(share: float, runs: float) -> Rate:
    """A share and the interval that so many independent runs would give it."""
    low, high = share_bounds(share * runs, (1 - share) * runs, (1 - CONFIDENCE) / 2)
    return Rate(rate=share, low=low, high=high)
