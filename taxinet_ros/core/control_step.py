"""One control step of a run: what is observed, and what is monitored.

Whatever reads, writes or judges steps needs this, and none of the world, camera and aircraft that
make them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.mtl.specs import MOST_CLEARANCE_M, MOST_HOLD_DISTANCE_M
from taxinet_ros.core.place.track import OnTrack, Track
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.sensors import Measured
from taxinet_ros.core.traffic.traffic import Holds
from taxinet_ros.core.types import (
    AircraftState,
    TaxiCommand,
    TrackingError,
    run_length_ns,
    step_stamp_ns,
)
from taxinet_ros.errors import UsageError

CONTROL_PERIOD_NS = 100_000_000
"""Time between two control steps [ns] unless the scenario has another: the paper's 10 Hz."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Observation:
    """Observation at one control step.

    Attributes:
        seq: control step, from 0.
        stamp_ns: simulated time since the start of the run [ns].
        state: true state of the aircraft.
        image: camera frame, (height, width, 3) uint8 RGB of the scenario's camera, usually
            (200, 360, 3); None if not requested.
        track: that is followed; None for the runway's centreline.
        measured: what has arrived of the other sensors and the tower; None without them and hold
            lines.
        held: of the others on the ground that react to the aircraft, how far it has held them.
    """

    seq: int
    stamp_ns: int
    state: AircraftState
    image: NDArray[np.uint8] | None
    track: Track | None = None
    measured: Measured | None = None
    held: Holds = field(default_factory=dict)

    @property
    def without_second_camera(self) -> Observation:
        """The same without what its sensors' camera has seen."""
        if self.measured is None or not self.measured.camera:
            return self
        return replace(self, measured=replace(self.measured, camera=()))

    @property
    def on_track(self) -> OnTrack:
        """Where the aircraft is along and beside the track."""
        state = self.state
        if self.track is None:
            return OnTrack(state.x_m, state.y_m, state.yaw_rad)
        return self.track.measure(state.x_m, state.y_m, state.yaw_rad)

    @property
    def truth(self) -> TrackingError:
        """Ground-truth cross-track and heading error, relative to the track."""
        _, cte_m, he_rad = self.on_track
        return TrackingError(cte_m=cte_m, he_rad=he_rad)


def max_gap_ns(period_ns: int) -> int:
    """Maximum gap between samples [ns]; in lockstep a longer one means that a sample was lost."""
    return period_ns * 3 // 2


def last_step(scenario: Scenario) -> int:
    """Number of the last control step of a run; steps 0..N cover the duration, ends included.

    Raises:
        UsageError: the duration is not a multiple of the control period.
    """
    if not is_whole(scenario.duration_s, scenario.period_ns):
        raise UsageError(
            f'scenario: duration {scenario.duration_s:g} s is not a multiple of the '
            f'control period {scenario.period_ns / 1e9:g} s'
        )
    return scenario.duration_ns // scenario.period_ns


def is_whole(duration_s: float, period_ns: int) -> bool:
    """Whether a length of time [s] is a number of control periods."""
    length_ns = run_length_ns(duration_s, period_ns)
    return step_stamp_ns(length_ns // period_ns, period_ns) == length_ns


def rolling_on(speed_mps: float) -> TaxiCommand:
    """Command before the first answer: constant initial motion.

    Args:
        speed_mps: initial speed of the scenario [m/s].
    """
    return TaxiCommand(steering_rad=0.0, speed_mps=speed_mps)


def signals(
    *, cte_m: float, he_rad: float, x_m: float, speed_mps: float,
    estimate: TrackingError, command: TaxiCommand, clearance_m: float = MOST_CLEARANCE_M,
    hold_distance_m: float = MOST_HOLD_DISTANCE_M,
) -> dict[str, float]:
    """One sample of the monitored signals, in the units of :mod:`taxinet_ros.core.mtl.specs`.

    A missing estimate is NaN, so no formula about it can be satisfied; so is a standard deviation
    that the estimate does not claim.
    """
    return {
        'cte': cte_m,
        'he': he_rad,
        'x': x_m,
        'speed': speed_mps,
        'steering': command.steering_rad,
        'cte_estimate': estimate.cte_m if estimate.usable else math.nan,
        'he_estimate': estimate.he_rad if estimate.usable else math.nan,
        'cte_sigma': estimate.cte_sigma_m if estimate.usable else math.nan,
        'he_sigma': estimate.he_sigma_rad if estimate.usable else math.nan,
        'clearance': clearance_m,
        'collision': float(clearance_m <= 0) if clearance_m == clearance_m else math.nan,
        'hold_distance': hold_distance_m,
    }
