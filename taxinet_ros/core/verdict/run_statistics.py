"""Statistics of one run besides its robustness: deviation, settling time, estimation errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.place.runway import KMWH_HALF_WIDTH_M
from taxinet_ros.core.types import NS_PER_S

_SCALE = 2.0**-64
SIGMA_FIGURES = ('sigma_max', 'within_1_sigma', 'within_2_sigma')
"""What :class:`ErrorStatistics` say of claimed covariances."""
_AFTER_S, _LEAST_S = 1.0, 2.0


def deciding_steps(cte_m: NDArray[np.float64], t_s: NDArray[np.float64]) -> int:
    """Number of steps that decided whether an aircraft stays at its line.

    They end a second after it was last on the line, or nearest to it, and not within two seconds:
    what is seen from farther away is a consequence.

    Args:
        cte_m: true cross-track error at each step, while on the pavement.
        t_s: simulated times.
    """
    away = np.abs(cte_m)
    near = np.flatnonzero(away <= max(CENTRELINE_TOLERANCE_M, np.nanmin(away, initial=np.inf)))
    if not len(near):
        return len(away)
    last_s = max(t_s[near[-1]] + _AFTER_S, t_s[0] + _LEAST_S)
    return int(np.searchsorted(t_s[:len(away)], last_s, side='right'))


@dataclass(frozen=True, kw_only=True, slots=True)
class ErrorStatistics:
    """Estimate minus truth over the frames of a run that had a usable estimate.

    Attributes:
        mean: bias; NaN, like the others, if no estimate was usable.
        mean_abs: mean absolute error.
        max_abs: maximum absolute error.
        sigma_max: maximum standard deviation that an estimate claimed for this error; NaN, like the
            shares, if none did.
        within_1_sigma, within_2_sigma: share of those estimates whose error was at most 1, or 2, of
            their standard deviations: 0.68 and 0.95 if the claim is right and the error normal.
    """

    mean: float = math.nan
    mean_abs: float = math.nan
    max_abs: float = math.nan
    sigma_max: float = math.nan
    within_1_sigma: float = math.nan
    within_2_sigma: float = math.nan


@dataclass(frozen=True, kw_only=True, slots=True)
class RunStatistics:
    """Summary statistics of a run.

    Attributes:
        max_cross_track_m: maximum |cross-track error| [m].
        settle_time_s: first moment from which |cross-track error| stays within
            :data:`.mtl.specs.CENTRELINE_TOLERANCE_M` to the last sample [s]; NaN if it does not.
        cte_error: estimation error of the cross-track error [m].
        he_error: estimation error of the heading error [rad].
        unusable_estimates: number of frames without a usable estimate.
        half_width_m: half width of the runway [m].
    """

    max_cross_track_m: float = math.nan
    settle_time_s: float = math.nan
    cte_error: ErrorStatistics = ErrorStatistics()
    he_error: ErrorStatistics = ErrorStatistics()
    unusable_estimates: int = 0
    half_width_m: float = KMWH_HALF_WIDTH_M

    @property
    def left_runway(self) -> bool:
        """Whether the reference point was beyond the runway's edge at some sample."""
        return self.max_cross_track_m > self.half_width_m


class RunStatisticsCollector:
    """Collects the samples of one run in order; constant time and memory per sample."""

    def __init__(self, half_width_m: float = KMWH_HALF_WIDTH_M) -> None:
        """``half_width_m``: half width of the runway [m]."""
        self._half_width_m = half_width_m
        self._max_cross_track_m = 0.0
        self._settled_ns: int | None = None
        self._cte, self._he = _ErrorSum(), _ErrorSum()
        self._unusable = 0

    def push(self, stamp_ns: int, sample: Mapping[str, float]) -> None:
        """Add one sample of the signals in :data:`.mtl.specs.SIGNALS`."""
        deviation = abs(sample['cte'])
        self._max_cross_track_m = max(self._max_cross_track_m, deviation)
        if not deviation <= CENTRELINE_TOLERANCE_M:
            self._settled_ns = None
        elif self._settled_ns is None:
            self._settled_ns = stamp_ns
        cte_error = sample['cte_estimate'] - sample['cte']
        he_error = sample['he_estimate'] - sample['he']
        if math.isfinite(cte_error) and math.isfinite(he_error):
            self._cte.add(cte_error, sample.get('cte_sigma', math.nan))
            self._he.add(he_error, sample.get('he_sigma', math.nan))
        else:
            self._unusable += 1

    @property
    def statistics(self) -> RunStatistics:
        """Statistics so far."""
        settled_ns = self._settled_ns
        return RunStatistics(
            max_cross_track_m=self._max_cross_track_m,
            settle_time_s=math.nan if settled_ns is None else settled_ns / NS_PER_S,
            cte_error=self._cte.statistics,
            he_error=self._he.statistics,
            unusable_estimates=self._unusable,
            half_width_m=self._half_width_m,
        )


class _ErrorSum:
    def __init__(self) -> None:
        self._count, self._sum, self._sum_abs, self._max_abs = 0, 0.0, 0.0, 0.0
        # The same sums, scaled so that they cannot overflow.
        self._small, self._small_abs = 0.0, 0.0
        self._claims, self._sigma_max, self._within = 0, 0.0, [0, 0]

    def add(self, error: float, sigma: float) -> None:
        self._count += 1
        self._sum += error
        self._sum_abs += abs(error)
        self._small += error * _SCALE
        self._small_abs += abs(error) * _SCALE
        self._max_abs = max(self._max_abs, abs(error))
        if sigma == sigma:
            self._claims += 1
            self._sigma_max = max(self._sigma_max, sigma)
            for row in range(2):
                self._within[row] += abs(error) <= (row + 1) * sigma

    @property
    def statistics(self) -> ErrorStatistics:
        if not self._count:
            return ErrorStatistics()
        mean, mean_abs = self._sum / self._count, self._sum_abs / self._count
        if not math.isfinite(mean_abs):
            # Limited to the maximum, so that rounding cannot make a mean infinite.
            least = self._max_abs * _SCALE
            mean = max(-least, min(self._small / self._count, least)) / _SCALE
            mean_abs = min(self._small_abs / self._count, least) / _SCALE
        errors = ErrorStatistics(mean=mean, mean_abs=mean_abs, max_abs=self._max_abs)
        if not self._claims:
            return errors
        first, second = (count / self._claims for count in self._within)
        return replace(
            errors, sigma_max=self._sigma_max, within_1_sigma=first, within_2_sigma=second
        )


class EstimateWatch:
    """Computes two signals of missing estimates: length of the gap, and share of the frames.

    Args:
        horizon_ns: last stamp of the run [ns].
        period_ns: time between its frames [ns].
    """

    NAMES = ('estimate_gap', 'unusable_share')

    __slots__ = ('_frames', '_last_ns', '_period_ns', '_unusable')

    def __init__(self, horizon_ns: int, period_ns: int) -> None:
        self._frames = horizon_ns // period_ns + 1
        self._period_ns = period_ns
        self._last_ns: int | None = None
        self._unusable = 0

    def signals(self, stamp_ns: int, sample: Mapping[str, float]) -> dict[str, float]:
        """``estimate_gap`` [s] and ``unusable_share`` [1] at the next sample.

        The gap is the time since the last frame with a usable estimate; if there was none yet,
        since one period before the first frame.
        """
        if math.isfinite(sample['cte_estimate']) and math.isfinite(sample['he_estimate']):
            self._last_ns = stamp_ns
        else:
            self._unusable += 1
        if self._last_ns is None:
            self._last_ns = stamp_ns - self._period_ns
        return {
            'estimate_gap': (stamp_ns - self._last_ns) / NS_PER_S,
            'unusable_share': self._unusable / self._frames,
        }
