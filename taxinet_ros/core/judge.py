"""The judge of a run: every formula's online monitor, and whether the aircraft left the runway.

Judges ground truth only; the monitor node and the in-process loop both use it, so they agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from taxinet_ros.core.mtl import Monitor, Reading, Spec
from taxinet_ros.core.runway import HALF_WIDTH_M


@dataclass(frozen=True, kw_only=True, slots=True)
class Judgement:
    """What the judge says of a run.

    Attributes:
        readings: newest reading of each formula, in the order of the specs.
        complete: the horizon was reached and every sample was usable.
        satisfied: complete, and every formula has robustness > 0.
        left_runway: the reference point was beyond the runway's edge at some sample.
        max_cross_track_m: greatest |cross-track error| seen [m].
    """

    readings: tuple[Reading, ...]
    complete: bool
    satisfied: bool
    left_runway: bool
    max_cross_track_m: float


class Judge:
    """Judges one run, sample by sample."""

    def __init__(self, specs: Sequence[Spec], horizon_ns: int, max_gap_ns: int) -> None:
        """``horizon_ns``: last stamp of the run; a gap longer than ``max_gap_ns`` voids it."""
        self._monitors = [Monitor(spec, horizon_ns, max_gap_ns=max_gap_ns) for spec in specs]
        self._readings: tuple[Reading, ...] = ()
        self._max_cross_track_m = 0.0

    def push(self, stamp_ns: int, sample: Mapping[str, float]) -> tuple[Reading, ...]:
        """Take the ground truth at ``stamp_ns``; answer one reading per formula."""
        self._readings = tuple(monitor.push(stamp_ns, sample) for monitor in self._monitors)
        self._max_cross_track_m = max(self._max_cross_track_m, abs(sample['cte']))
        return self._readings

    @property
    def judgement(self) -> Judgement:
        """The verdict so far; only a complete one may become PASS or FAIL."""
        complete = bool(self._readings) and all(r.final and r.valid for r in self._readings)
        return Judgement(
            readings=self._readings,
            complete=complete,
            satisfied=complete and all(reading.lower > 0 for reading in self._readings),
            left_runway=self._max_cross_track_m > HALF_WIDTH_M,
            max_cross_track_m=self._max_cross_track_m,
        )
