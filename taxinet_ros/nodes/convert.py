"""Messages to core values and back. Floats pass unchanged, so the graph matches the core's bits.

What is said in every control step is not here but in :mod:`taxinet_ros.nodes.step_cdr`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from taxinet_msgs import msg as taxinet

from taxinet_ros.bag.message_values import SCENARIO_FIELDS
from taxinet_ros.core import camera
from taxinet_ros.core.mtl import Reading, Spec
from taxinet_ros.core.outcome import RunRequest
from taxinet_ros.core.run_statistics import ErrorStatistics, RunStatistics
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.nodes.interface import CAMERA_FRAME, MAP_FRAME


def time_of(stamp_ns: int) -> Time:
    """Nanoseconds since the start of the run as a ROS time."""
    return Time(sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S)


def stamp_of(stamp: Time) -> int:
    """A ROS time as nanoseconds since the start of the run."""
    return stamp.sec * NS_PER_S + stamp.nanosec


def header(stamp_ns: int, frame_id: str = MAP_FRAME) -> Header:
    """A header at simulated time ``stamp_ns``."""
    return Header(stamp=time_of(stamp_ns), frame_id=frame_id)


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
    """Intrinsics of the wing camera at the start of a run."""
    matrix = camera.intrinsics()
    projection = np.hstack([matrix, np.zeros((3, 1))])
    return CameraInfo(
        header=header(0, CAMERA_FRAME),
        height=camera.IMAGE_HEIGHT,
        width=camera.IMAGE_WIDTH,
        distortion_model='plumb_bob',
        d=[0.0] * 5,
        k=matrix.ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=projection.ravel().tolist(),
    )


def robustness_message(
    spec: Spec, reading: Reading, run_id: str, seq: int, stamp_ns: int, frame_id: str = MAP_FRAME
) -> taxinet.Robustness:
    """One formula's reading."""
    return taxinet.Robustness(
        header=header(stamp_ns, frame_id),
        run_id=run_id,
        seq=seq,
        spec=spec.name,
        formula=spec.text,
        rho_lower=reading.lower,
        rho_upper=reading.upper,
        verdict=int(reading.verdict),
        final=reading.final,
        valid=reading.valid,
        trusted=reading.trusted,
        samples=reading.samples,
        rejected=reading.rejected,
    )


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
