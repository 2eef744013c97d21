"""Value types of the closed loop; defines all units, axes and signs.

Frames (REP-103, REP-105). ``map`` is the runway frame: origin on the centreline at the threshold
of runway 04, x along the centreline in the direction of take-off, y to the left, z up. Angles are
counter-clockwise positive seen from above, so a nose that points left of the runway has a positive
yaw. The runway's heading is zero yaw by construction, hence:

* cross-track error (CTE) = y of the aircraft's reference point, left positive, in metres;
* heading error (HE) = yaw - runway heading = yaw, nose left positive, in radians.

These are the signs of the published X-Plane TaxiNet data. A steering angle is left positive too: a
positive angle turns the nose to the left. Pitch and roll follow REP-103 as well (x forward, y left,
z up): positive pitch is nose **down**, positive roll is right wing down.

Messages carry the attitude as a unit quaternion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from taxinet_ros.arguments import check_fields, told
from taxinet_ros.errors import UsageError

NS_PER_S = 1_000_000_000
FOOT_M = 0.3048
"""The international foot, exactly."""
_FLOATS = {float}
"""Type of nearly all numbers below. It is checked first because the values are created in every
control step, and checking each field by its annotation takes ten times as long."""
Covariance = tuple[float, float, float, float]
"""Row-major 2 x 2 covariance of (cross-track error [m], heading error [rad])."""
UNKNOWN_COVARIANCE: Covariance = (0.0, 0.0, 0.0, 0.0)
_ROUNDING = 1e-9
"""Relative asymmetry, or negative eigenvalue, that is rounding in the filter that computed it."""


def rate_of(period_ns: int) -> int:
    """Rate [Hz] of a period, which is 10⁹ / rate rounded down [ns]."""
    return NS_PER_S // period_ns


def step_stamp_ns(seq: int, period_ns: int) -> int:
    """Simulated time of a control step [ns], exact at whole seconds.

    A period that is not whole, as of 30 Hz, is rounded down: every third stamp is then 1 ns later
    than three of it, so that ``stamp_ns // period_ns`` is the step, and no run ends early.

    Args:
        seq: control step.
        period_ns: control period, 10⁹ / rate rounded down [ns].
    """
    return seq * period_ns + seq * (NS_PER_S % period_ns) // rate_of(period_ns)


def steps_in(time_ns: int, period_ns: int) -> int:
    """Number of control periods [ns] in a time, rounded up: the first step that is not before."""
    return -(-time_ns * rate_of(period_ns) // NS_PER_S)


def reached_ns(time_s: float) -> int:
    """First stamp at which a simulated time has come, a nanosecond early [ns].

    Stamps are rounded down: that of 2/30 s is 66,666,666, but the time to the nearest nanosecond
    is one more, and would come a step late.

    Args:
        time_s: the time, or a length of time [s].
    """
    return max(round(time_s * NS_PER_S) - 1, 0)


def run_length_ns(duration_s: float, period_ns: int) -> int:
    """Length of a run [ns]: the stamp of its last step where that was rounded down, as of 2/3 s.

    Args:
        duration_s: length of the run [s].
        period_ns: control period [ns].
    """
    length_ns = round(duration_s * NS_PER_S)
    last_ns = step_stamp_ns(steps_in(length_ns - 1, period_ns), period_ns)
    return last_ns if last_ns == length_ns - 1 else length_ns


def time_words(time_s: float, width: int = 0) -> str:
    """A simulated time [s] in tenths, or with the decimals that it takes: ``3.0 s``, ``0.125 s``.

    Args:
        time_s: the time of a control step [s].
        width: least width of the number.
    """
    decimals = next(count for count in (1, 2, 3) if count == 3 or not round(
        time_s - round(time_s, count), 6))
    return f'{time_s:{width}.{decimals}f} s'


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackingError:
    """Pose error relative to the centreline: ground truth, or a perception's estimate.

    Attributes:
        cte_m: cross-track error [m], left positive.
        he_rad: heading error [rad], nose left positive.
        valid: False if there is no estimate; the numbers are then meaningless.
        covariance: what an estimate claims about its own errors, four numbers or 2 x 2; a variance
            of 0 is unknown. The truth claims none.
    """

    cte_m: float
    he_rad: float
    valid: bool = True
    covariance: Covariance = UNKNOWN_COVARIANCE

    def __post_init__(self) -> None:
        if {type(self.cte_m), type(self.he_rad)} != _FLOATS or type(self.valid) is not bool:
            check_fields(self)
        if self.covariance is not UNKNOWN_COVARIANCE:
            object.__setattr__(self, 'covariance', _covariance_of(self.covariance))

    @property
    def cte_sigma_m(self) -> float:
        """Standard deviation claimed for the cross-track error [m]; NaN if unknown."""
        return _sigma(self.covariance[0])

    @property
    def he_sigma_rad(self) -> float:
        """Standard deviation claimed for the heading error [rad]; NaN if unknown."""
        return _sigma(self.covariance[3])

    @property
    def covariance_flaw(self) -> str:
        """Why the covariance of a usable estimate cannot be one; '' if it can."""
        cte, one, other, he = self.covariance
        if self.covariance == UNKNOWN_COVARIANCE or not self.usable:
            return ''
        product, why = cte * he, ''
        if not all(map(math.isfinite, self.covariance)):
            why = 'not finite'
        elif cte < 0 or he < 0:
            why = 'a variance is negative'
        elif abs(one - other) > _ROUNDING * math.sqrt(product):
            why = 'not symmetric'
        elif one * other > product * (1 + _ROUNDING):
            why = 'an eigenvalue is negative'
        return why and f'covariance [{", ".join(f"{x:g}" for x in self.covariance)}]: {why}'

    @property
    def usable(self) -> bool:
        """Whether both numbers are finite and declared valid."""
        return self.valid and math.isfinite(self.cte_m) and math.isfinite(self.he_rad)


def _covariance_of(value: Any) -> Covariance:
    """Four numbers, row-major, from a covariance as a user or a message gives it."""
    try:
        flat = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        flat = np.empty(0)
    if flat.shape not in ((4,), (2, 2)):
        raise UsageError(
            f'TrackingError: covariance: got {told(value)}; expected 2 x 2 or 4 numbers'
        )
    first, second, third, fourth = flat.ravel().tolist()
    return first, second, third, fourth


def _sigma(variance: float) -> float:
    return math.sqrt(variance) if 0 < variance < math.inf else math.nan


NO_ESTIMATE = TrackingError(cte_m=0.0, he_rad=0.0, valid=False)
"""Result of a perception that has no estimate."""


@dataclass(frozen=True, kw_only=True, slots=True)
class AircraftState:
    """Pose and motion of the aircraft's reference point (its centre of gravity) in ``map``.

    Attributes:
        x_m, y_m: position along and across the runway [m], y left positive.
        z_m: height of the reference point above the ground [m].
        roll_rad, pitch_rad, yaw_rad: REP-103 attitude [rad] (pitch positive nose down).
        speed_mps: ground speed along the body x axis [m/s].
        yaw_rate_radps: rate of yaw [rad/s], counter-clockwise positive.
    """

    x_m: float
    y_m: float
    z_m: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    speed_mps: float
    yaw_rate_radps: float

    def __post_init__(self) -> None:
        if {
            type(self.x_m), type(self.y_m), type(self.z_m), type(self.roll_rad),
            type(self.pitch_rad), type(self.yaw_rad), type(self.speed_mps),
            type(self.yaw_rate_radps),
        } != _FLOATS:
            check_fields(self)

    @property
    def tracking_error(self) -> TrackingError:
        """Ground-truth errors relative to the runway's centreline.

        Those relative to another track: :class:`taxinet_ros.core.control_step.Observation`.
        """
        return TrackingError(cte_m=self.y_m, he_rad=self.yaw_rad)


@dataclass(frozen=True, kw_only=True, slots=True)
class TaxiCommand:
    """Command of the controller to the aircraft for one control period.

    Attributes:
        steering_rad: nose-wheel angle [rad], positive turns left.
        speed_mps: taxi speed to hold [m/s], >= 0; 0 brakes to a stop.
    """

    steering_rad: float
    speed_mps: float

    def __post_init__(self) -> None:
        if {type(self.steering_rad), type(self.speed_mps)} != _FLOATS:
            check_fields(self)


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) from angles about x, y, z [rad], applied in the order z, y, x."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def yaw_of(x: float, y: float, z: float, w: float) -> float:
    """Yaw [rad] of a unit quaternion, as :func:`quaternion` has it."""
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def quaternion_product(
    outer: tuple[float, float, float, float], inner: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    """Hamilton product of two unit quaternions (x, y, z, w).

    Gives the attitude of a frame with attitude ``inner`` inside a frame with attitude ``outer``.
    """
    ax, ay, az, aw = outer
    bx, by, bz, bw = inner
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
