"""Statistics of one run besides its robustness: deviation, settling time, estimation errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.place.runway import KMWH_HALF_WIDTH_M
from taxinet_ros.core.types import NS_PER_S

_SCALE = 2.0**-64


@dataclass(frozen=True, kw_only=True, slots=True)
class ErrorStatistics:
    """Estimate minus truth over the frames of a run that had a usable estimate.

    Attributes:
        mean: the bias; NaN, as the others, where no estimate was usable.
        mean_abs: mean absolute error.
        max_abs: greatest absolute error.
    """

    mean: float = math.nan
    mean_abs: float = math.nan
    max_abs: float = math.nan


@dataclass(frozen=True, kw_only=True, slots=True)
class RunStatistics:
    """Summary statistics of a run.

    Attributes:
        max_cross_track_m: greatest |cross-track error| [m].
        settle_time_s: first moment from which |cross-track error| stays within
            :data:`.mtl.specs.CENTRELINE_TOLERANCE_M` to the last sample [s]; NaN if it does not.
        cte_error: of the estimated cross-track error [m].
        he_error: of the estimated heading error [rad].
        unusable_estimates: frames without one.
        half_width_m: of the runway [m].
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
    """Takes the samples of one run in order; constant work and memory for each."""

    def __init__(self, half_width_m: float = KMWH_HALF_WIDTH_M) -> None:
        """Begin a run on a runway of this half width [m]."""
        self._half_width_m = half_width_m
        self._max_cross_track_m = 0.0
        self._settled_ns: int | None = None
        self._cte, self._he = _ErrorSum(), _ErrorSum()
        self._unusable = 0

    def push(self, stamp_ns: int, sample: Mapping[str, float]) -> None:
        """Take one sample of the signals of :data:`.mtl.specs.SIGNALS`."""
        deviation = abs(sample['cte'])
        self._max_cross_track_m = max(self._max_cross_track_m, deviation)
        if not deviation <= CENTRELINE_TOLERANCE_M:
            self._settled_ns = None
        elif self._settled_ns is None:
            self._settled_ns = stamp_ns
        cte_error = sample['cte_estimate'] - sample['cte']
        he_error = sample['he_estimate'] - sample['he']
        if math.isfinite(cte_error) and math.isfinite(he_error):
            self._cte.add(cte_error)
            self._he.add(he_error)
        else:
            self._unusable += 1

    @property
    def statistics(self) -> RunStatistics:
        """The figures so far."""
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
        # The same sums in a unit in which no sum of a run's errors overflows.
        self._small, self._small_abs = 0.0, 0.0

    def add(self, error: float) -> None:
        self._count += 1
        self._sum += error
        self._sum_abs += abs(error)
        self._small += error * _SCALE
        self._small_abs += abs(error) * _SCALE
        self._max_abs = max(self._max_abs, abs(error))

    @property
    def statistics(self) -> ErrorStatistics:
        if not self._count:
            return ErrorStatistics()
        mean, mean_abs = self._sum / self._count, self._sum_abs / self._count
        if not math.isfinite(mean_abs):
            # A mean is no greater than the greatest, by which rounding must not take it to inf.
            least = self._max_abs * _SCALE
            mean = max(-least, min(self._small / self._count, least)) / _SCALE
            mean_abs = min(self._small_abs / self._count, least) / _SCALE
        return ErrorStatistics(mean=mean, mean_abs=mean_abs, max_abs=self._max_abs)


class EstimateWatch:
    """How long, and how often, a run was without a usable estimate: two of its signals.

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

        The gap is the time since the last frame with a usable estimate; where there was none yet,
        as if there had been one just before the first frame.
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
