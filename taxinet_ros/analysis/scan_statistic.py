"""How much denser failures are within a region: its likelihood ratio, and a bound on chance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from taxinet_ros.analysis.group_rates import Floats, Mask
from taxinet_ros.analysis.scan_cells import Ints


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

    def log_likelihood(k: Ints, n: Ints) -> Floats:
        likelihood: Floats = x_log_x[k] + x_log_x[n - k] - x_log_x[n]
        return likelihood

    k, n = np.rint(failures).astype(np.int64), np.rint(inside).astype(np.int64)
    # Outside there are never more failures than runs where k is a count of these runs.
    beyond = np.minimum(all_failures - k, runs - n)
    ratio = log_likelihood(k, n) + log_likelihood(beyond, runs - n)
    ratio = ratio - log_likelihood(np.array(all_failures), np.array(runs))
    return np.where(k * runs > n * all_failures, ratio, 0.0)


def _x_log_x(most: int) -> Floats:
    numbers = np.arange(most + 1, dtype=np.float64)
    return numbers * np.log(np.maximum(numbers, 1))


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


def _divergence(part: float, whole: float) -> float:
    """Kullback and Leibler's, of two coins."""
    terms = ((part, whole), (1 - part, 1 - whole))
    return sum(one * math.log(one / other) for one, other in terms if one > 0)
