"""The steering law: a cascade from cross-track error over heading error to the nose wheel.

The paper needs a controller that always satisfies its specification on the true state; the gains
published with its simulator code do not, on any of our aircraft. This cascade does: the further
the aircraft is from the centreline, the more steeply it turns towards it, up to a limit, and the
nose wheel follows the difference between that heading and the present one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.types import TaxiCommand, TrackingError

STOP = TaxiCommand(steering_rad=0.0, speed_mps=0.0)
"""The fail-safe: nose wheel straight, brakes on until standstill."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GainRange:
    """Valid range of one gain, both ends included, with its unit and meaning."""

    low: float
    high: float
    unit: str
    description: str


GAIN_RANGES: dict[str, GainRange] = {
    'cte_gain_rad_per_m': GainRange(
        low=0.0,
        high=1.0,
        unit='rad/m',
        description='heading towards the centreline per metre of cross-track error',
    ),
    'max_intercept_rad': GainRange(
        low=0.0,
        high=math.pi / 2,
        unit='rad',
        description='steepest heading at which the centreline is approached',
    ),
    'heading_gain': GainRange(
        low=0.0,
        high=10.0,
        unit='rad/rad',
        description='nose-wheel angle per angle between wanted and present heading',
    ),
    'max_steering_rad': GainRange(
        low=0.0,
        high=math.pi / 3,
        unit='rad',
        description='largest nose-wheel angle asked for, to either side',
    ),
    'speed_mps': GainRange(
        low=0.0,
        high=10.0,
        unit='m/s',
        description='taxi speed to hold',
    ),
}
"""Every field of :class:`SteeringGains` by name, in its order; ROS parameters derive from it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SteeringGains:
    """Tuning of :func:`steer`; meaning, unit and range of each field are in :data:`GAIN_RANGES`.

    Raises:
        UsageError: a value is not finite or outside its range.
    """

    cte_gain_rad_per_m: float = math.radians(4.0)
    max_intercept_rad: float = math.radians(35.0)
    heading_gain: float = 1.6
    max_steering_rad: float = math.radians(15.0)
    speed_mps: float = 5.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value, valid = getattr(self, field.name), GAIN_RANGES[field.name]
            # A NaN fails the comparison too.
            if not valid.low <= value <= valid.high:
                raise UsageError(
                    f'steering: {field.name} is {value:g}, '
                    f'outside {valid.low:g}..{valid.high:g} {valid.unit}'
                )


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


def steer(error: TrackingError, gains: SteeringGains) -> TaxiCommand:
    """Answer one estimate of where the aircraft is.

    The wanted heading error is ``-clip(cte_gain * CTE, max_intercept)``: from the left of the
    centreline the nose points right. The nose wheel is ``-heading_gain`` times what the heading
    error exceeds it by, clipped. The law has no memory.

    Args:
        error: cross-track and heading error, left positive.
        gains: tuning of the law.

    Returns:
        Nose-wheel angle [rad], left positive, and speed. An estimate that is not usable (declared
        invalid, NaN or infinite) gives :data:`STOP`: an aircraft that does not know where it is
        does not taxi.
    """
    if not error.usable:
        return STOP
    wanted_rad = -_clip(gains.cte_gain_rad_per_m * error.cte_m, gains.max_intercept_rad)
    steering_rad = -gains.heading_gain * (error.he_rad - wanted_rad)
    return TaxiCommand(
        steering_rad=_clip(steering_rad, gains.max_steering_rad), speed_mps=gains.speed_mps
    )
