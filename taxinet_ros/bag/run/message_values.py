"""Conversion between messages of a run (from a bag or the ROS graph) and core values.

Floats are not changed, so judging or repeating a run uses the recorded bits.
"""

from __future__ import annotations

import json
import math
from typing import Any

from taxinet_ros.core.clearance import Clearance
from taxinet_ros.core.control_step import rolling_on, signals
from taxinet_ros.core.mtl import Assumptions, Reading, Spec, parse_assumptions
from taxinet_ros.core.pacing.free_run import FreeRunAccount
from taxinet_ros.core.place.catalogue import find_track
from taxinet_ros.core.place.track import Track
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    CONTROL_RATE,
    GNSS_FIELDS,
    MESSAGE_FIELDS,
    PLACE,
    SENSORS,
    SPEED,
    TRACK,
    ScenarioField,
)
from taxinet_ros.core.types import NS_PER_S, UNKNOWN_COVARIANCE, TaxiCommand, TrackingError
from taxinet_ros.core.verdict.judge import Judgement
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.core.verdict.run_statistics import SIGMA_FIGURES

_NO_ESTIMATE = TrackingError(cte_m=math.nan, he_rad=math.nan, valid=False)
_OF_SENSORS = [field.key for field in (SENSORS, *GNSS_FIELDS)]
_NO_COMMAND = TaxiCommand(steering_rad=math.nan, speed_mps=math.nan)


def scenario_of(message: Any) -> Scenario:
    """Convert a scenario message, with validation.

    Raises:
        UsageError: a value is out of range.
        AttributeError: not a scenario message.
    """
    return Scenario(**{field.attribute: _value(message, field) for field in MESSAGE_FIELDS})


def _value(message: Any, field: ScenarioField) -> Any:
    if field.absent is not None:
        return getattr(message, field.attribute, field.absent)
    return getattr(message, field.attribute)


def assumptions_of(message: Any) -> Assumptions:
    """Assumptions in a scenario message.

    Raises:
        UsageError: invalid syntax.
    """
    return parse_assumptions(message.bounds, message.rates)


def stamp_of(message: Any) -> int:
    """Header stamp of a message [ns].

    Raises:
        AttributeError, TypeError, ValueError: the message has none.
    """
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def account_of(message: Any) -> FreeRunAccount:
    """The account of a free run in a timing message."""
    return FreeRunAccount(
        applied=list(map(int, message.applied)), frame_s=list(map(float, message.frame_time)),
        estimate_s=list(map(float, message.estimate_time)),
        command_s=list(map(float, message.command_time)),
        estimate_seq=list(map(int, message.estimate_seq)),
        command_seq=list(map(int, message.command_seq)),
        overruns=message.overruns, stale=message.stale,
    )


def error_of(message: Any) -> TrackingError:
    """Convert a tracking error message; one recorded before there were covariances claims none."""
    return TrackingError(
        cte_m=float(message.cross_track_error), he_rad=float(message.heading_error),
        valid=bool(message.valid),
        covariance=getattr(message, 'covariance', UNKNOWN_COVARIANCE),
    )


def command_of(message: Any) -> TaxiCommand:
    """Convert a command message; a :class:`TaxiCommand` is returned unchanged."""
    if isinstance(message, TaxiCommand):
        return message
    return TaxiCommand(
        steering_rad=float(message.steering_angle), speed_mps=float(message.speed)
    )


class HeldCommand:
    """Zero-order hold of commands in a free run, where frames may have none; as in the monitor."""

    def __init__(self, scenario: Any, *, free: bool) -> None:
        """Start a run.

        Args:
            scenario: scenario message of the run.
            free: whether it is a free run or in lockstep.
        """
        self._free = free
        self._held: Any = rolling_on(float(_value(scenario, SPEED)))

    def at(self, command: Any) -> Any:
        """Command in effect at a frame; call for each frame in order.

        Args:
            command: the command message for this frame, or None.

        Returns:
            A message or :class:`TaxiCommand`, or None.
        """
        if not self._free:
            return command
        self._held = command or self._held
        return self._held


def clearance_in(scenario: Any) -> Clearance:
    """Distances to others on the ground of a scenario message.

    Raises:
        UsageError, AttributeError: as :func:`scenario_of`.
    """
    return Clearance(scenario_of(scenario))


def clearance_of(clearance: Clearance | None, odometry: Any) -> float:
    """The distance to others on the ground at an odometry message [m].

    NaN where either is None.
    """
    if clearance is None or odometry is None:
        return math.nan
    place, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
    attitude = (float(turn.x), float(turn.y), float(turn.z), float(turn.w))
    return clearance.at(stamp_of(odometry), float(place.x), float(place.y), attitude)


def hold_distance_of(clearance: Clearance | None, odometry: Any) -> float:
    """The way to a hold line at an odometry message [m]; NaN where either is None."""
    if clearance is None or odometry is None:
        return math.nan
    place = odometry.pose.pose.position
    return clearance.to_hold_line(stamp_of(odometry), float(place.x), float(place.y))


def track_of(message: Any) -> Track | None:
    """The track of a scenario message; None for the runway's centreline.

    Raises:
        UsageError: its place has no such track.
    """
    word = _value(message, TRACK) or TRACK.absent
    return None if word == TRACK.absent else find_track(_value(message, PLACE), word)


def sample_of(
    truth: Any, odometry: Any, estimate: Any, command: Any, track: Track | None,
    clearance: Clearance | None,
) -> dict[str, float]:
    """Monitored signals of one control step, in the units of :mod:`taxinet_ros.core.mtl.specs`.

    Signals of missing messages are NaN.

    Args:
        truth: ground-truth tracking error.
        odometry: odometry, or None.
        estimate: estimate, or None.
        command: command, or None.
        track: that its run follows; None for the runway's centreline.
        clearance: of the run, see :func:`clearance_in`.
    """
    x_m = math.nan
    if odometry is not None:
        at = odometry.pose.pose.position
        x_m = track.measure(at.x, at.y).distance_m if track else float(at.x)
    return signals(
        cte_m=float(truth.cross_track_error),
        he_rad=float(truth.heading_error),
        x_m=x_m,
        speed_mps=float(odometry.twist.twist.linear.x) if odometry is not None else math.nan,
        estimate=error_of(estimate) if estimate is not None else _NO_ESTIMATE,
        command=command_of(command) if command is not None else _NO_COMMAND,
        clearance_m=clearance_of(clearance, odometry),
        hold_distance_m=hold_distance_of(clearance, odometry),
    )


def scenario_json(message: Any) -> bytes:
    """Attachment ``scenario.json`` of a run's bag: the request in user-facing units."""
    scene = scenario_of(message)
    left_out = _OF_SENSORS if scene.sensors == SENSORS.absent else []
    if scene.control_rate_hz == CONTROL_RATE.absent:
        left_out = [*left_out, CONTROL_RATE.key]
    values = {
        # That of a run without sensors, at the usual rate, is as it was before there were others.
        **{key: value for key, value in scene.to_human().items() if key not in left_out},
        'run_id': message.run_id,
        'index': message.index,
        'program': message.program,
        'seed': message.seed,
        'specs': list(message.specs),
        'stop_on': message.stop_on,
        'bounds': list(message.bounds),
        'rates': list(message.rates),
        'participants': list(message.participants),
    }
    return json.dumps(values, indent=2).encode() + b'\n'


def scenario_values(request: RunRequest) -> dict[str, Any]:
    """Fields of the scenario message of a run request, without header."""
    return {
        'run_id': request.run_id,
        'index': request.index,
        'program': request.program,
        'seed': request.seed,
        'specs': list(request.judging.specs),
        'stop_on': request.judging.stop_on,
        'bounds': list(request.judging.bounds),
        'rates': list(request.judging.rates),
        'participants': list(request.participants),
        **request.scenario.recorded(),
    }


def reading_values(spec: Spec, reading: Reading, run_id: str, seq: int) -> dict[str, Any]:
    """Fields of a robustness message, without header."""
    return {
        'run_id': run_id,
        'seq': seq,
        'spec': spec.name,
        'formula': spec.text,
        **reading.interval.by_end(),
        'verdict': int(reading.verdict),
        'final': reading.final,
        'valid': reading.valid,
        'trusted': reading.trusted,
        'samples': reading.samples,
        'rejected': reading.rejected,
    }


def verdict_values(judgement: Judgement, run_id: str) -> dict[str, Any]:
    """Fields of a verdict message, without header and readings."""
    figures = judgement.statistics
    cte, he = figures.cte_error, figures.he_error
    return {
        'run_id': run_id,
        'complete': judgement.complete,
        'stopped_early': judgement.stopped_early,
        'satisfied': judgement.satisfied,
        'left_runway': figures.left_runway,
        'max_cross_track_error': figures.max_cross_track_m,
        'settle_time': figures.settle_time_s,
        'estimate_cte_error_mean': cte.mean,
        'estimate_cte_error_mean_abs': cte.mean_abs,
        'estimate_cte_error_max_abs': cte.max_abs,
        'estimate_he_error_mean': he.mean,
        'estimate_he_error_mean_abs': he.mean_abs,
        'estimate_he_error_max_abs': he.max_abs,
        'unusable_estimates': figures.unusable_estimates,
        **{
            f'{name}_{figure}': getattr(errors, figure)
            for name, errors in (('cte', cte), ('he', he)) for figure in SIGMA_FIGURES
        },
    }
