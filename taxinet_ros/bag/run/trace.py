"""Trace of a recorded run as columns over its control steps, and its camera frames."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.bag.cdr.alignment import stamp_of_cdr
from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagForeign
from taxinet_ros.bag.run.message_values import (
    clearance_in,
    clearance_of,
    command_of,
    error_of,
    hold_distance_of,
    stamp_of,
    track_of,
)
from taxinet_ros.bag.run.topics import (
    COMMAND,
    ESTIMATE,
    IMAGE,
    ODOMETRY,
    ROBUSTNESS,
    SCENARIO,
    TRUTH,
    is_topic,
)
from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.scenario_fields import TRAFFIC
from taxinet_ros.core.trace import CLEARANCE_COLUMN, HOLD_COLUMN, SIGMA_COLUMNS, STEP_UNITS
from taxinet_ros.core.traffic.traffic import NOBODY
from taxinet_ros.core.types import UNKNOWN_COVARIANCE
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.run.recording import Recording
    from taxinet_ros.core.control_step import Observation

Column = NDArray[np.generic]
Frame = NDArray[np.uint8]

_MOST = 2**63 - 1
_TRACED = (SCENARIO, TRUTH, ODOMETRY, ESTIMATE, COMMAND, ROBUSTNESS)


class CameraFrame(NamedTuple):
    """One camera frame.

    Attributes:
        seq: control step.
        stamp_ns: simulated time [ns].
        image: (200, 360, 3) uint8 RGB.
        recorded: True if it is from the bag, False if rendered.
    """

    seq: int
    stamp_ns: int
    image: Frame
    recorded: bool


def trace_columns(recording: Recording) -> dict[str, Column]:
    """See :attr:`.recording.Recording.columns`."""
    recording.check_damage()
    told: dict[str, list[Any]] = {name: [] for name in _TRACED}
    for name, _, message in recording.messages(_TRACED):
        told[name].append(message)
    try:
        stamps = {_step(message): stamp_of(message) for message in told[TRUTH]}
        poses = _poses(told[SCENARIO], told[ODOMETRY])
        cells = _cells(told)
    except (AttributeError, TypeError, ValueError, UsageError) as error:
        text = f'{recording.path}: topics of the trace: {error}'
        raise BagForeign(text, path=recording.path) from error
    if not stamps:
        what = f'no messages on {TRUTH}, so there is no trace'
        raise BagEmpty(f'{recording.path}: {what}', path=recording.path)
    steps = sorted(stamps)
    rows = [{**cells[k], **poses.get(stamps[k], {})} for k in steps]
    columns: dict[str, Column] = {
        'seq': np.array(steps, dtype=np.int64),
        't_ns': np.array([stamps[k] for k in steps], dtype=np.int64),
        'est_valid': np.array(['est_cte_m' in row for row in rows], dtype=np.bool_),
    }
    names = (name for found in (*poses.values(), *cells.values()) for name in found)
    for name in dict.fromkeys((*STEP_UNITS, *names)):
        columns[name] = np.array([row.get(name, np.nan) for row in rows], dtype=np.float64)
    return columns


def recorded_steps(recording: Recording) -> frozenset[int]:
    """See :attr:`.recording.Recording.recorded_steps`."""
    return frozenset(_steps_of(recording, IMAGE))


def camera_frames(
    recording: Recording, wanted: Callable[[int], bool],
    render: Callable[[Callable[[int], bool]], Iterator[Observation]] | None,
) -> Iterator[CameraFrame]:
    """See :meth:`.recording.Recording.frames`; ``render`` renders missing frames, or None."""
    there = recorded_steps(recording)
    if any(wanted(seq) for seq in there):
        for stamp_ns, image in _recorded_images(recording):
            if wanted(seq := stamp_ns // recording.period_ns):
                yield CameraFrame(seq, stamp_ns, image, recorded=True)
    if render and any(wanted(seq) and seq not in there for seq in _steps_of(recording, TRUTH)):
        for now in render(lambda seq: wanted(seq) and seq not in there):
            if now.image is not None:
                yield CameraFrame(now.seq, now.stamp_ns, now.image, recorded=False)


def _steps_of(recording: Recording, relative: str) -> Iterator[int]:
    """Control steps of the messages on a topic, from their header stamps."""
    for stored in recording.one.info.messages:
        if is_topic(stored.topic.name, relative):
            try:
                yield stamp_of_cdr(stored.cdr) // recording.period_ns
            except BagCorrupt as error:
                text = f'{recording.path}: topic {stored.topic.name}: {error}'
                raise BagCorrupt(text, path=recording.path) from error


def _recorded_images(recording: Recording) -> Iterator[tuple[int, Frame]]:
    """Yield stamp [ns] and pixels, (H, W, 3) uint8 RGB, of each recorded camera frame."""
    path, latest_ns = recording.path, -1
    for stored in recording.one.whole_messages(lambda name: is_topic(name, IMAGE)):
        where = f'{path}: image at {stored.stamp_ns} ns'
        try:
            message = decode(stored.topic, stored.cdr)
            stamp_ns, pixels = stamp_of(message), _pixels(message)
        except BagCorrupt as error:
            raise BagCorrupt(f'{where}: {error}', path=path) from error
        except (BagForeign, AttributeError, TypeError, ValueError) as error:
            raise BagForeign(f'{where}: {error}', path=path) from error
        if stamp_ns <= latest_ns:
            raise BagForeign(f'{where}: comes behind one of {latest_ns} ns', path=path)
        latest_ns = stamp_ns
        yield stamp_ns, pixels


def _step(message: Any) -> int:
    """Control step of a message of the truth."""
    if not 0 <= message.seq <= _MOST or stamp_of(message) > _MOST:
        raise ValueError(f'step {message.seq} at {stamp_of(message)} ns is beyond all numbers')
    return int(message.seq)


def _poses(scenarios: Sequence[Any], odometry: Sequence[Any]) -> dict[int, dict[str, float]]:
    """Cells of odometry by stamp [ns]."""
    scenario = scenarios[-1] if scenarios else None
    track = track_of(scenario) if scenario is not None else None
    traffic = getattr(scenario, TRAFFIC.attribute, '') not in ('', NOBODY)
    clearance = clearance_in(scenario) if traffic else None
    poses = {}
    for message in odometry:
        x_m, y_m = float(message.pose.pose.position.x), float(message.pose.pose.position.y)
        pose = poses[stamp_of(message)] = {
            'x_m': x_m, 'y_m': y_m,
            'distance_m': track.measure(x_m, y_m).distance_m if track else x_m,
            'speed_mps': float(message.twist.twist.linear.x),
        }
        if clearance is not None:
            pose[CLEARANCE_COLUMN] = clearance_of(clearance, message)
            if clearance.may_violate(['hold_distance']):
                pose[HOLD_COLUMN] = hold_distance_of(clearance, message)
    return poses


def _cells(told: Mapping[str, Sequence[Any]]) -> Mapping[int, Mapping[str, float]]:
    """Cells of the other messages by control step."""
    cells: defaultdict[int, dict[str, float]] = defaultdict(dict)
    for message in told[TRUTH]:
        truth = error_of(message)
        cells[message.seq].update(cte_m=truth.cte_m, he_rad=truth.he_rad)
    for message in told[ESTIMATE]:
        estimate = error_of(message)
        if estimate.usable:
            cells[message.seq].update(est_cte_m=estimate.cte_m, est_he_rad=estimate.he_rad)
            if estimate.covariance != UNKNOWN_COVARIANCE:
                for name, value in SIGMA_COLUMNS.items():
                    cells[message.seq][name] = value(estimate)
    for message in told[COMMAND]:
        command = command_of(message)
        cells[message.seq].update(
            steering_rad=command.steering_rad, speed_cmd_mps=command.speed_mps)
    for message in told[ROBUSTNESS]:
        cells[message.seq] |= RobustnessInterval.of_message(message).by_column(message.spec)
    return cells


def _pixels(message: Any) -> Frame:
    height, width, step = message.height, message.width, message.step
    if message.encoding not in ('rgb8', 'bgr8'):
        raise BagForeign(f'encoding {message.encoding!r} is neither rgb8 nor bgr8')
    if step < 3 * width or len(message.data) != height * step:
        raise BagCorrupt(f'{height} x {width}, step {step}, but {len(message.data)} bytes')
    rows = np.asarray(message.data, dtype=np.uint8).reshape(height, step)
    pixels = rows[:, :3 * width].reshape(height, width, 3)
    return pixels if message.encoding == 'rgb8' else pixels[:, :, ::-1]
