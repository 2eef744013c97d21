"""Trace of a recorded run as columns over its control steps, and its camera frames."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.bag.cdr.alignment import stamp_of_cdr
from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagForeign
from taxinet_ros.bag.run.message_values import (
    clearance_in,
    clearance_of,
    error_of,
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
from taxinet_ros.core.clearance import Clearance
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.place.track import Track
from taxinet_ros.core.scenario_fields import TRAFFIC
from taxinet_ros.core.trace import CLEARANCE_COLUMN, STEP_UNITS
from taxinet_ros.core.traffic.traffic import NOBODY
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.run.recording import Recording
    from taxinet_ros.core.control_step import Observation

Column = NDArray[np.generic]
Frame = NDArray[np.uint8]

_MOST = 2**63 - 1


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
    table, path = _TraceColumns(), recording.path
    for name, _, message in recording.messages(_FILL):
        try:
            _FILL[name](table, stamp_of(message), message)
        except (AttributeError, TypeError, ValueError, UsageError) as error:
            raise BagForeign(f'{path}: topic {name}: {error}', path=path) from error
    if not table.stamps:
        raise BagEmpty(f'{path}: no messages on {TRUTH}, so there is no trace', path=path)
    return table.columns()


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
            if wanted(seq := stamp_ns // CONTROL_PERIOD_NS):
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
                yield stamp_of_cdr(stored.cdr) // CONTROL_PERIOD_NS
            except BagCorrupt as error:
                text = f'{recording.path}: topic {stored.topic.name}: {error}'
                raise BagCorrupt(text, path=recording.path) from error


def _recorded_images(recording: Recording) -> Iterator[tuple[int, Frame]]:
    """Yield stamp [ns] and pixels, (H, W, 3) uint8 RGB, of each recorded camera frame.

    Raises:
        BagCorrupt: size and data of an image do not match.
        BagForeign: an image is neither rgb8 nor bgr8, or there are several runs.
        BagError: the bag is damaged or unsupported.
    """
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


class _TraceColumns:
    """Collects cells by step and column."""

    def __init__(self) -> None:
        self.track: Track | None = None
        self.stamps: dict[int, int] = {}
        self.poses: dict[int, dict[str, float]] = {}
        self.odometry: dict[int, Any] = {}
        self.clearance: Clearance | None = None
        self.cells: defaultdict[int, dict[str, float]] = defaultdict(dict)
        self.names: dict[str, None] = {}

    def put(self, seq: int, **values: float) -> None:
        """Set cells of one step."""
        self.cells[seq].update({name: float(value) for name, value in values.items()})
        self.names.update(dict.fromkeys(values))

    def columns(self) -> dict[str, Column]:
        """Return the columns, with rows in the order of the steps."""
        steps = sorted(self.stamps)
        if self.track is not None:
            for pose in self.poses.values():
                pose['distance_m'] = self.track.measure(pose['x_m'], pose['y_m']).distance_m
        if self.clearance is not None:
            for stamp_ns, message in self.odometry.items():
                self.poses[stamp_ns][CLEARANCE_COLUMN] = clearance_of(self.clearance, message)
        rows = [{**self.cells[k], **self.poses.get(self.stamps[k], {})} for k in steps]
        columns: dict[str, Column] = {
            'seq': np.array(steps, dtype=np.int64),
            't_ns': np.array([self.stamps[k] for k in steps], dtype=np.int64),
            'est_valid': np.array(['est_cte_m' in row for row in rows], dtype=np.bool_),
        }
        others = (CLEARANCE_COLUMN,) if self.clearance else ()
        for name in dict.fromkeys((*STEP_UNITS, *others, *self.names)):
            columns[name] = np.array([row.get(name, np.nan) for row in rows], dtype=np.float64)
        return columns


def _scenario(table: _TraceColumns, stamp_ns: int, message: Any) -> None:
    table.track = track_of(message)
    if getattr(message, TRAFFIC.attribute, '') not in ('', NOBODY):
        table.clearance = clearance_in(message)


def _truth(table: _TraceColumns, stamp_ns: int, message: Any) -> None:
    if not 0 <= message.seq <= _MOST or stamp_ns > _MOST:
        raise ValueError(f'step {message.seq} at {stamp_ns} ns is beyond all numbers')
    table.stamps[int(message.seq)] = stamp_ns
    table.put(message.seq, cte_m=message.cross_track_error, he_rad=message.heading_error)


def _odometry(table: _TraceColumns, stamp_ns: int, message: Any) -> None:
    position = message.pose.pose.position
    table.poses[stamp_ns] = {
        'x_m': float(position.x), 'y_m': float(position.y), 'distance_m': float(position.x),
        'speed_mps': float(message.twist.twist.linear.x),
    }
    table.odometry[stamp_ns] = message


def _estimate(table: _TraceColumns, stamp_ns: int, message: Any) -> None:
    estimate = error_of(message)
    if estimate.usable:
        table.put(message.seq, est_cte_m=estimate.cte_m, est_he_rad=estimate.he_rad)


def _command(table: _TraceColumns, stamp_ns: int, message: Any) -> None:
    table.put(message.seq, steering_rad=message.steering_angle, speed_cmd_mps=message.speed)


def _robustness(table: _TraceColumns, stamp_ns: int, message: Any) -> None:
    table.put(message.seq, **{
        f'rho_lower.{message.spec}': message.rho_lower,
        f'rho_upper.{message.spec}': message.rho_upper,
    })


_FILL = {
    SCENARIO: _scenario, TRUTH: _truth, ODOMETRY: _odometry, ESTIMATE: _estimate, COMMAND: _command,
    ROBUSTNESS: _robustness,
}


def _pixels(message: Any) -> Frame:
    height, width, step = message.height, message.width, message.step
    if message.encoding not in ('rgb8', 'bgr8'):
        raise BagForeign(f'encoding {message.encoding!r} is neither rgb8 nor bgr8')
    if step < 3 * width or len(message.data) != height * step:
        raise BagCorrupt(f'{height} x {width}, step {step}, but {len(message.data)} bytes')
    rows = np.asarray(message.data, dtype=np.uint8).reshape(height, step)
    pixels = rows[:, :3 * width].reshape(height, width, 3)
    return pixels if message.encoding == 'rgb8' else pixels[:, :, ::-1]
