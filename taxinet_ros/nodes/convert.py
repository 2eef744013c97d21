"""Messages to core values and back. Floats pass unchanged, so the graph matches the core's bits.

What is said in every control step is written ``into`` a message that its node keeps: generated
messages take as long to make as to send, for each makes its parts, and defaults for them, anew.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from taxinet_msgs import msg as taxinet

from taxinet_ros.bag.message_values import SCENARIO_FIELDS
from taxinet_ros.core import camera
from taxinet_ros.core.attitude import quaternion
from taxinet_ros.core.mtl import Reading, Spec
from taxinet_ros.core.outcome import RunRequest
from taxinet_ros.core.run_statistics import ErrorStatistics, RunStatistics
from taxinet_ros.core.types import NS_PER_S, AircraftState, TaxiCommand, TrackingError
from taxinet_ros.nodes.interface import BASE_FRAME, MAP_FRAME


def time_of(stamp_ns: int, into: Time | None = None) -> Time:
    """Nanoseconds since the start of the run as a ROS time."""
    time = into or Time()
    time.sec, time.nanosec = divmod(stamp_ns, NS_PER_S)
    return time


def stamp_of(stamp: Time) -> int:
    """A ROS time as nanoseconds since the start of the run."""
    return stamp.sec * NS_PER_S + stamp.nanosec


def header(stamp_ns: int, frame_id: str = MAP_FRAME) -> Header:
    """A header at simulated time ``stamp_ns``."""
    return Header(stamp=time_of(stamp_ns), frame_id=frame_id)


def set_header(message: Any, stamp_ns: int, frame_id: str = MAP_FRAME) -> None:
    """Stamp a message with simulated time ``stamp_ns``."""
    time_of(stamp_ns, message.header.stamp)
    message.header.frame_id = frame_id


def set_step(
    message: Any, run_id: str, seq: int, stamp_ns: int, frame_id: str = MAP_FRAME
) -> None:
    """Say which control step of which run a message belongs to."""
    set_header(message, stamp_ns, frame_id)
    message.run_id, message.seq = run_id, seq


def scenario_message(request: RunRequest) -> taxinet.Scenario:
    """The message that asks for a run."""
    values = {name: getattr(request.scenario, key) for key, name in SCENARIO_FIELDS.items()}
    return taxinet.Scenario(
        header=header(0),
        run_id=request.run_id,
        index=request.index,
        program=request.program,
        seed=request.seed,
        specs=list(request.specs),
        stop_on=request.stop_on,
        bounds=list(request.bounds),
        rates=list(request.rates),
        participants=list(request.participants),
        **values,
    )


def camera_info_message() -> CameraInfo:
    """Intrinsics of the wing camera; the caller stamps it."""
    matrix = camera.intrinsics()
    projection = np.hstack([matrix, np.zeros((3, 1))])
    return CameraInfo(
        height=camera.IMAGE_HEIGHT,
        width=camera.IMAGE_WIDTH,
        distortion_model='plumb_bob',
        d=[0.0] * 5,
        k=matrix.ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=projection.ravel().tolist(),
    )


def odometry_message(
    state: AircraftState, stamp_ns: int, into: Odometry | None = None
) -> Odometry:
    """The true state: pose in map, velocity in base_link."""
    message = into or Odometry()
    set_header(message, stamp_ns)
    message.child_frame_id = BASE_FRAME
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    position.x, position.y, position.z = state.x_m, state.y_m, state.z_m
    orientation.x, orientation.y, orientation.z, orientation.w = quaternion(
        state.roll_rad, state.pitch_rad, state.yaw_rad
    )
    message.twist.twist.linear.x = state.speed_mps
    message.twist.twist.angular.z = state.yaw_rate_radps
    return message


def error_message(
    error: TrackingError, run_id: str, seq: int, stamp_ns: int,
    into: taxinet.TrackingError | None = None,
) -> taxinet.TrackingError:
    """Truth or estimate as a message."""
    message = into or taxinet.TrackingError()
    set_step(message, run_id, seq, stamp_ns)
    message.cross_track_error, message.heading_error = error.cte_m, error.he_rad
    message.valid = error.valid
    return message


def command_message(
    command: TaxiCommand, run_id: str, seq: int, stamp_ns: int,
    into: taxinet.TaxiCommand | None = None,
) -> taxinet.TaxiCommand:
    """A command as a message."""
    message = into or taxinet.TaxiCommand()
    set_step(message, run_id, seq, stamp_ns, BASE_FRAME)
    message.steering_angle, message.speed = command.steering_rad, command.speed_mps
    return message


def robustness_message(
    spec: Spec, reading: Reading, run_id: str, seq: int, stamp_ns: int, frame_id: str = MAP_FRAME,
    into: taxinet.Robustness | None = None,
) -> taxinet.Robustness:
    """One formula's reading."""
    message = into or taxinet.Robustness()
    set_step(message, run_id, seq, stamp_ns, frame_id)
    message.spec, message.formula = spec.name, spec.text
    message.rho_lower, message.rho_upper = reading.lower, reading.upper
    message.verdict = int(reading.verdict)
    message.final, message.valid, message.trusted = reading.final, reading.valid, reading.trusted
    message.samples, message.rejected = reading.samples, reading.rejected
    return message


def statistics_fields(statistics: RunStatistics) -> dict[str, Any]:
    """The fields of a verdict that hold the run's figures; the inverse of :func:`statistics_of`."""
    cte, he = statistics.cte_error, statistics.he_error
    return {
        'left_runway': statistics.left_runway,
        'max_cross_track_error': statistics.max_cross_track_m,
        'settle_time': statistics.settle_time_s,
        'estimate_cte_error_mean': cte.mean,
        'estimate_cte_error_mean_abs': cte.mean_abs,
        'estimate_cte_error_max_abs': cte.max_abs,
        'estimate_he_error_mean': he.mean,
        'estimate_he_error_mean_abs': he.mean_abs,
        'estimate_he_error_max_abs': he.max_abs,
        'unusable_estimates': statistics.unusable_estimates,
    }


def statistics_of(verdict: taxinet.Verdict) -> RunStatistics:
    """The run's figures in a verdict."""
    return RunStatistics(
        max_cross_track_m=verdict.max_cross_track_error,
        settle_time_s=verdict.settle_time,
        cte_error=ErrorStatistics(
            mean=verdict.estimate_cte_error_mean, mean_abs=verdict.estimate_cte_error_mean_abs,
            max_abs=verdict.estimate_cte_error_max_abs,
        ),
        he_error=ErrorStatistics(
            mean=verdict.estimate_he_error_mean, mean_abs=verdict.estimate_he_error_mean_abs,
            max_abs=verdict.estimate_he_error_max_abs,
        ),
        unusable_estimates=verdict.unusable_estimates,
    )
