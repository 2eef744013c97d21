"""How much denser failures are within a region, and how far chance and choosing can take that.

The statistic of a region is the log likelihood ratio of two failure rates, inside and outside,
against one (Kulldorff, Communications in Statistics: Theory and Methods 26, 1997). There are many
more small regions than large ones, so the greatest of all statistics would nearly always be that of
a small one; the score of a region is therefore compared with what regions of its size reach by
chance (Walther and Perry, Journal of the Royal Statistical Society B 84, 2022).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import betaln

from taxinet_ros.analysis.group_rates import Floats, Mask


def likelihood_ratio(
    failures: npt.NDArray[Any], inside: npt.NDArray[Any], all_failures: int, runs: int
) -> Floats:
    """Log likelihood ratio of two rates against one; 0 where the rate inside is not the higher.

    Args:
        failures: inside.
        inside: number of runs inside, to go with ``failures``.
        all_failures: inside and outside together.
        runs: inside and outside together.
    """
    x_log_x = _x_log_x(runs)
    k, n = np.rint(failures).astype(np.int32), np.rint(inside).astype(np.int32)
    # Outside there are never more failures than runs where k is a count of these runs.
    beyond = np.minimum(all_failures - k, runs - n)
    ratio: Floats = x_log_x[k] + x_log_x[n - k]
    ratio += x_log_x[beyond]
    ratio += x_log_x[runs - n - beyond]
    ratio -= x_log_x[n] + x_log_x[runs - n]
    ratio -= float(x_log_x[all_failures] + x_log_x[runs - all_failures] - x_log_x[runs])
    return np.where(k * float(runs) > n * float(all_failures), ratio, 0.0)


def _x_log_x(most: int) -> Floats:
    numbers = np.arange(most + 1, dtype=np.float64)
    return numbers * np.log(np.maximum(numbers, 1))


def size_penalty(inside: npt.NDArray[Any], runs: int) -> Floats:
    """What chance alone makes of the root of twice the ratio, for regions of a size."""
    smaller = np.minimum(inside, runs - inside)
    penalty: Floats = np.sqrt(2 * np.log(np.e * runs / np.maximum(smaller, 1.0)))
    return penalty


def hoeffding_bound(failed: Mask, inside: Mask) -> float:
    """A bound on how probable it is that shuffled outcomes put as many failures inside, or more.

    Args:
        failed: of each run.
        inside: which runs are inside, neither none nor all.
    """
    share = float(failed.mean())
    exponents = []
    for among, of in ((failed[inside], share), (~failed[~inside], 1 - share)):
        part = float(among.mean())
        exponents.append(len(among) * _divergence(part, of) if part > of else 0.0)
    return math.exp(-max(exponents))


def interval_of(failures: int, runs: int, deviance: float) -> tuple[float, float]:
    """Rates that the counts do not speak against by more than a log likelihood ratio.

    Args:
        failures: among the runs.
        runs: how many; with none every rate is possible.
        deviance: the log likelihood ratio of the observed rate to a rate at an end.
    """
    if not runs:
        return 0.0, 1.0
    share = failures / runs

    def end(of: float) -> float:
        near, far = share, of
        for _ in range(60):
            middle = (near + far) / 2
            if runs * _divergence(share, middle) <= deviance:
                near = middle
            else:
                far = middle
        return near

    return (end(0.0) if failures else 0.0), (end(1.0) if failures < runs else 1.0)


def _divergence(part: float, whole: float) -> float:
    """Kullback and Leibler's, of two coins."""
    terms = ((part, whole), (1 - part, 1 - whole))
    return sum(one * math.log(one / max(other, 1e-300)) for one, other in terms if one > 0)


def log_evidence(
    failures: npt.NDArray[Any], inside: npt.NDArray[Any], all_failures: int, runs: int
) -> Floats:
    """Log of an e-value against 'one rate', for each of some regions fixed before the runs.

    The likelihood of the outcomes under two unknown rates, each mixed over Jeffreys's prior, by the
    greatest one under a single rate. Given the past and the scene, the outcome of the next run is a
    toss of one coin if no scene fails more often than another, however the scene was chosen. So
    the ratio to the true coin is a martingale, the ratio here is not above it, and by Ville's
    inequality it exceeds 1 / alpha with probability alpha at most, whatever the sampler has learned
    from outcomes (universal inference: Wasserman, Ramdas and Balakrishnan, PNAS 117, 2020; Ramdas,
    Grünwald, Vovk and Shafer, Statistical Science 38, 2023). Means of e-values are e-values.
    """
    k, n = failures.astype(np.float64), inside.astype(np.float64)
    beyond, others = all_failures - k, runs - n

    def mixed(hits: Floats, tosses: Floats) -> Floats:
        value: Floats = betaln(hits + 0.5, tosses - hits + 0.5) - betaln(0.5, 0.5)
        return value

    x_log_x = _x_log_x(runs)
    one_rate = x_log_x[all_failures] + x_log_x[runs - all_failures] - x_log_x[runs]
    evidence: Floats = mixed(k, n) + mixed(beyond, others) - float(one_rate)
    return evidence
