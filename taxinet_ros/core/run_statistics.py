"""Figures of one run beside its robustness: how far off, when settled, how wrong the estimates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.runway import HALF_WIDTH_M
from taxinet_ros.core.types import NS_PER_S


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
    """A run in a few figures.

    Attributes:
        max_cross_track_m: greatest |cross-track error| [m].
        settle_time_s: first moment from which |cross-track error| stays within
            :data:`.mtl.specs.CENTRELINE_TOLERANCE_M` to the last sample [s]; NaN if it does not.
        cte_error: of the estimated cross-track error [m].
        he_error: of the estimated heading error [rad].
        unusable_estimates: frames without one.
    """

    max_cross_track_m: float = math.nan
    settle_time_s: float = math.nan
    cte_error: ErrorStatistics = ErrorStatistics()
    he_error: ErrorStatistics = ErrorStatistics()
    unusable_estimates: int = 0

    @property
    def left_runway(self) -> bool:
        """Whether the reference point was beyond the runway's edge at some sample."""
        return self.max_cross_track_m > HALF_WIDTH_M


class RunStatisticsCollector:
    """Takes the samples of one run in order; constant work and memory for each."""

    def __init__(self) -> None:
        """Begin a run."""
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
        )


class _ErrorSum:
    def __init__(self) -> None:
        self._count, self._sum, self._sum_abs, self._max_abs = 0, 0.0, 0.0, 0.0

    def add(self, error: float) -> None:
        self._count += 1
        self._sum += error
        self._sum_abs += abs(error)
        self._max_abs = max(self._max_abs, abs(error))

    @property
    def statistics(self) -> ErrorStatistics:
        if not self._count:
            return ErrorStatistics()
        return ErrorStatistics(
            mean=self._sum / self._count, mean_abs=self._sum_abs / self._count,
            max_abs=self._max_abs,
        )
