"""Where the aircraft was: positions and headings of a recording, in the place's ``map``.

Latitude and longitude are converted on the WGS84 ellipsoid (:mod:`.core.place.runway_frame`), at
the height of the runway: 30 m of error in height shift a position by 15 mm at the end of 3 km.
Between samples, position and heading are interpolated linearly, never across a gap. On an arc of
30 m radius at 5 m/s, that errs by 0.1 m with one sample a second, and by 1 mm with ten.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pymap3d
from numpy.typing import NDArray

from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.runway_frame import GeodeticPose, runway_frame
from taxinet_ros.core.types import NS_PER_S, yaw_of
from taxinet_ros.errors import UsageError
from taxinet_ros.recordings.reader import (
    FIX,
    HEADINGS,
    TRANSFORMS,
    TRUTHS,
    Recording,
    stamp_of,
)

Floats = NDArray[np.float64]
RUNWAY = 'runway'
"""Frame of poses that are those of the runway: x along it, y to the left."""
TRACK = 'track'
"""Heading from the direction of motion."""
STANDING_MPS = 0.3
"""Below it the aircraft stands still, and its track has no direction."""

_WINDOW_S = 1.0
"""Half the time over which velocity and turn rate are fitted."""
_GAPS_S = (0.3, 2.0)
"""Shortest and longest gap between samples across which is interpolated; between: 2.2 periods."""
_LEAP_S = 1.0
_LEAST_HEADINGS = 20
_SCATTER_RAD = math.radians(12.0)
_AGREES_RAD = math.radians(8.0)
_QUARTER_RAD = math.radians(10.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class TruthSource:
    """What of a recording is the truth.

    Attributes:
        topic: NavSatFix, Odometry or PoseStamped; or ``TOPIC:PARENT:CHILD`` of transforms.
        heading: topic of Imu, Odometry or PoseStamped, or :data:`TRACK`; '' for the pose's own.
        frame: of poses: :data:`RUNWAY`, or ``LAT,LON`` of the origin of an east-north-up frame; ''
            is the runway's for our own bags, and unknown for others.
        compass: headings are clockwise from north, not counter-clockwise from east (REP-103).
        heading_offset_rad: added to the heading, clockwise [rad].
        antenna_m: what the position is of, in the body frame (x forward, y left) from the
            aircraft's reference point [m].
        by_log: stamps are the times of recording, not those of the headers.
    """

    topic: str
    heading: str = ''
    frame: str = ''
    compass: bool = False
    heading_offset_rad: float = 0.0
    antenna_m: tuple[float, float] = (0.0, 0.0)
    by_log: bool = False

    @property
    def topic_name(self) -> str:
        """The topic without frames."""
        return self.topic.partition(':')[0]

    @property
    def link(self) -> tuple[str, str]:
        """Parent and child of the transform."""
        parent, _, child = self.topic.partition(':')[2].partition(':')
        return parent or 'map', child or 'base_link'


class Poses(NamedTuple):
    """Poses at some times: position [m], yaw [rad], NaN where unknown, and motion."""

    x_m: Floats
    y_m: Floats
    yaw_rad: Floats
    speed_mps: Floats
    yaw_rate_radps: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """Poses of the aircraft's reference point in ``map``.

    Attributes:
        stamps_ns: (n,) ascending.
        poses: at these.
        left_out: number of samples that are not used, by reason.
        notes: likely mistakes, one line each.
        spread_m: standard deviation of a position that the source states itself; NaN if it states
            none.
    """

    stamps_ns: NDArray[np.int64]
    poses: Poses
    left_out: Counter[str] = field(default_factory=Counter)
    notes: tuple[str, ...] = ()
    spread_m: float = math.nan

    @property
    def period_s(self) -> float:
        """Usual time between samples; NaN for fewer than two."""
        if len(self.stamps_ns) < 2:
            return math.nan
        return float(np.median(np.diff(self.stamps_ns))) / NS_PER_S

    def at(self, stamps_ns: NDArray[np.int64]) -> Poses:
        """Poses at other times, NaN where there is no sample near enough on both sides."""
        if len(self.stamps_ns) < 2:
            return Poses(*(np.full(len(stamps_ns), np.nan) for _ in Poses._fields))
        first = self.stamps_ns[0]
        own, asked = ((one - first) / NS_PER_S for one in (self.stamps_ns, stamps_ns))
        after = np.clip(np.searchsorted(own, asked), 1, len(own) - 1)
        low, high = _GAPS_S
        limit = min(max(2.2 * self.period_s, low), high)
        exact = np.isin(stamps_ns, self.stamps_ns)
        near = exact | ((own[after] - own[after - 1] <= limit + 1e-9) & (asked >= own[0])
                        & (asked <= own[-1]))
        return Poses(*(np.where(near, np.interp(asked, own, column), np.nan)
                       for column in self.poses))


class _Samples:
    """Stamps and values of one source, as they come."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.stamps: list[int] = []
        self.logged: list[int] = []
        self.values: list[tuple[float, ...]] = []
        self.left_out: Counter[str] = Counter()
        self.leap = Leap(0, '')

    def add(self, stamp_ns: int, log_ns: int, values: tuple[float, ...]) -> None:
        if not all(map(math.isfinite, values)):
            self.left_out['not a finite number'] += 1
            return
        self.stamps.append(stamp_ns)
        self.logged.append(log_ns)
        self.values.append(values)

    def ascending(self) -> tuple[NDArray[np.int64], Floats]:
        """Stamps and values in the order of time, up to a leap; what goes back is left out."""
        self.leap = find_leap(self.name, self.stamps, self.logged)
        end = self.leap.number
        stamps, values = np.array(self.stamps[:end], np.int64), np.array(self.values[:end], float)
        if count := len(self.stamps) - end:
            self.left_out['after a leap of the clock'] += count
        kept = in_order(stamps)
        if count := int((~kept).sum()):
            self.left_out['out of order'] += count
        return stamps[kept], values[kept]


def in_order(stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mask of the stamps that are later than all before them."""
    if not len(stamps_ns):
        return np.zeros(0, np.bool_)
    return np.concatenate([[True], stamps_ns[1:] > np.maximum.accumulate(stamps_ns)[:-1]])


class Leap(NamedTuple):
    """A leap of the clock of stamps against that of the recorder.

    Attributes:
        number: first message after it; of no leap the number of messages.
        note: one line, or ''.
    """

    number: int
    note: str


def find_leap(name: str, stamps: Sequence[int], logged: Sequence[int]) -> Leap:
    """The first leap; messages lost or a pause of the recorder are none."""
    steps, recorded = (np.diff(np.array(one, np.int64)) / NS_PER_S for one in (stamps, logged))
    if not len(steps):
        return Leap(len(stamps), '')
    leapt = (np.abs(steps - recorded) > _LEAP_S) & (np.abs(steps - np.median(steps)) > _LEAP_S)
    if not leapt.any():
        return Leap(len(stamps), '')
    at = int(leapt.argmax())
    return Leap(at + 1, (
        f'{name}: its clock leaps by {steps[at] - recorded[at]:+.1f} s at message {at + 1}, and '
        'what comes after it is not used: a clock that was set, or several recordings in one; use '
        'the times of recording (stamps log)'))


class TruthReader:
    """Collects the samples of one bag, and makes the truth of them."""

    def __init__(self, source: TruthSource, recording: Recording, runway: Runway) -> None:
        """Check the topics.

        Raises:
            UsageError: a topic is missing or of another type, or the frame of poses is unknown.
        """
        self.source, self._runway = source, runway
        self._kind = recording.types[recording.topic(source.topic, TRUTHS, 'truth')]
        heading = '' if source.heading == TRACK else source.heading
        if heading:
            recording.topic(heading, HEADINGS, 'heading')
        self._heading_topic = heading
        self.topics = {source.topic_name, *filter(None, (heading,))}
        if self._kind == TRANSFORMS:
            self.topics |= set(recording.of_type((TRANSFORMS,)))
        self._positions, self._headings = _Samples(source.topic_name), _Samples(heading)
        self._links: defaultdict[tuple[str, str], list[tuple[float, ...]]] = defaultdict(list)
        self._spreads: list[float] = []

    def add(self, topic: str, log_ns: int, message: Any) -> None:
        """Take a message of one of :attr:`topics`."""
        if self._kind == TRANSFORMS and hasattr(message, 'transforms'):
            for one in message.transforms:
                stamp_ns = log_ns if self.source.by_log else stamp_of(one)
                moved, turned = one.transform.translation, one.transform.rotation
                self._links[one.header.frame_id.lstrip('/'), one.child_frame_id.lstrip('/')].append(
                    (stamp_ns, log_ns, moved.x, moved.y, _yaw(turned)))
            return
        stamp_ns = log_ns if self.source.by_log else stamp_of(message)
        if topic == self.source.topic_name:
            self._add_position(stamp_ns, log_ns, message)
        if topic == self._heading_topic:
            turned = message.orientation if hasattr(message, 'orientation') else _pose(
                message).orientation
            self._headings.add(stamp_ns, log_ns, (_yaw(turned),))

    def _add_position(self, stamp_ns: int, log_ns: int, message: Any) -> None:
        values: tuple[float, ...]
        if self._kind == FIX:
            if message.status.status < 0 or not (message.latitude or message.longitude):
                self._positions.left_out['no fix'] += 1
                return
            values = message.latitude, message.longitude
            if message.position_covariance_type:
                self._note_spread(message.position_covariance[[0, 4]])
        else:
            pose = _pose(message)
            values = pose.position.x, pose.position.y, _yaw(pose.orientation)
            if hasattr(message.pose, 'covariance'):
                self._note_spread(message.pose.covariance[[0, 7]])
        self._positions.add(stamp_ns, log_ns, values)

    def _note_spread(self, variances: Floats) -> None:
        if (variances > 0).all() and np.isfinite(variances).all():
            self._spreads.append(math.sqrt(float(variances.mean())))

    def finish(self) -> Truth:
        """The truth of all that came.

        Raises:
            UsageError: there is none.
        """
        if self._kind == TRANSFORMS:
            self._join_links()
        positions = self._positions
        stamps, values = positions.ascending()
        if len(stamps) < 2:
            why = ', '.join(f'{count} {name}' for name, count in positions.left_out.items())
            raise UsageError(
                f'truth {self.source.topic}: {len(stamps)} usable samples'
                f'{f" ({why})" if why else ""}; name another topic (taxinet score --topics BAG)')
        heading = self._heading_at(stamps, values)
        if self._kind == FIX:
            x, y, yaw = _of_geodetic(self._runway, values[:, 0], values[:, 1], heading)
        else:
            x, y, yaw = self._of_poses(values, heading)
        raw = _motion(stamps, x, y, yaw)
        notes = [one.leap.note for one in (positions, self._headings) if one.leap.note]
        notes += self._convention_notes(raw, yaw)
        if self.source.heading == TRACK or (self._kind == FIX and not self._heading_topic):
            yaw = np.where(raw.speed_mps >= 2 * STANDING_MPS, raw.yaw_rad, np.nan)
        if any(self.source.antenna_m):
            ahead, left = self.source.antenna_m
            x = x - (np.cos(yaw) * ahead - np.sin(yaw) * left)
            y = y - (np.sin(yaw) * ahead + np.cos(yaw) * left)
        motion = _motion(stamps, x, y, yaw)
        return Truth(
            stamps_ns=stamps, left_out=positions.left_out + self._headings.left_out,
            notes=tuple(notes), spread_m=float(np.median(self._spreads or [math.nan])),
            poses=motion._replace(x_m=x, y_m=y, yaw_rad=unwrapped(yaw)),
        )

    def _join_links(self) -> None:
        """Poses of the child in the parent, at the times of the transform that changes most."""
        parent, child = self.source.link
        above = {below: (over, below) for over, below in self._links}
        chain, at = [], child
        while at != parent and at in above and above[at] not in chain:
            chain.append(above[at])
            at = above[at][0]
        if at != parent:
            known = ', '.join(f'{over}:{below}' for over, below in self._links) or 'none'
            raise UsageError(
                f'truth {self.source.topic}: no transforms lead from {parent} to {child}; '
                f'recorded are {known}')
        stamped = max((sorted(self._links[link]) for link in chain), key=len, default=[])
        times = np.array([row[0] for row in stamped], np.float64)
        x = y = yaw = np.zeros(len(times))
        for link in chain:
            own = np.array(sorted(self._links[link]), np.float64)
            dx, dy, turn = (
                np.interp(times, own[:, 0], one)
                for one in (own[:, 2], own[:, 3], np.unwrap(own[:, 4])))
            cos, sin = np.cos(turn), np.sin(turn)
            x, y, yaw = dx + cos * x - sin * y, dy + sin * x + cos * y, yaw + turn
        for (stamp_ns, log_ns, *_), *pose in zip(stamped, x, y, yaw, strict=True):
            self._positions.add(int(stamp_ns), int(log_ns), tuple(map(float, pose)))

    def _heading_at(self, stamps: NDArray[np.int64], values: Floats) -> Floats:
        """True heading [rad], clockwise from north, at the positions; NaN where unknown.

        Of poses in the runway's frame it is left NaN: there is no north in it.
        """
        if self._heading_topic:
            own, turned = self._headings.ascending()
            if len(own) < 2:
                raise UsageError(
                    f'heading {self._heading_topic}: {len(own)} usable samples; name another '
                    'topic, or track')
            zeros = np.zeros(len(own))
            series = Truth(stamps_ns=own, poses=Poses(
                zeros, zeros, np.unwrap(turned[:, 0]), zeros, zeros))
            yaw = series.at(stamps).yaw_rad
        elif self._kind == FIX:
            return np.full(len(stamps), np.nan)
        else:
            yaw = values[:, 2]
        heading: Floats = yaw if self.source.compass else math.pi / 2 - yaw
        return heading + self.source.heading_offset_rad

    def _of_poses(self, values: Floats, heading: Floats) -> tuple[Floats, Floats, Floats]:
        x, y, yaw = values.T
        if self.source.frame == RUNWAY:
            if self._heading_topic:
                yaw = self._runway.bearing_rad - heading
            return x, y, yaw - (0.0 if self._heading_topic else self.source.heading_offset_rad)
        origin = origin_of(self.source.frame)
        latitude, longitude, _ = pymap3d.enu2geodetic(
            x, y, 0.0, *origin, self._runway.elevation_m, deg=True)
        return _of_geodetic(self._runway, latitude, longitude, heading)

    def _convention_notes(self, moved: Poses, yaw: Floats) -> list[str]:
        """A line if the heading is not along the motion, but would be in another convention."""
        # Turning and slow, the two differ for good reasons.
        straight = (moved.speed_mps > 4 * STANDING_MPS) & np.isfinite(yaw)
        straight &= np.abs(moved.yaw_rate_radps) < math.radians(3)
        if self.source.heading == TRACK or straight.sum() < _LEAST_HEADINGS:
            return []
        off, scatter = mean_angle(yaw[straight] - moved.yaw_rad[straight])
        name = self._heading_topic or self.source.topic_name
        if scatter < _SCATTER_RAD and abs(off) <= _AGREES_RAD:
            return []
        # Read in the other convention: yaw a of enu is heading 90 deg - a, that of compass a.
        other = 2 * self._runway.bearing_rad - math.pi / 2 - yaw
        other_off, other_scatter = mean_angle(other[straight] - moved.yaw_rad[straight])
        found = f'{name}: the heading is {math.degrees(off):+.0f} deg off the direction of motion'
        north = self._heading_topic or self.source.frame != RUNWAY
        # Of a path that turns, the wrong convention turns the other way.
        if north and other_scatter < _SCATTER_RAD and abs(other_off) <= _AGREES_RAD and (
                other_scatter < 1.5 * scatter):
            now = 'enu' if self.source.compass else 'compass'
            return [f'{found}: it is of the other convention; read it with heading_is {now}']
        if scatter < _SCATTER_RAD and abs(abs(off) - math.pi) <= _QUARTER_RAD:
            return [f'{found}: taxied backwards, or the sensor is mounted so; '
                    'heading_offset 180 turns it round']
        if scatter < _SCATTER_RAD and abs(abs(off) - math.pi / 2) <= _QUARTER_RAD:
            return [f'{found}: its zero is another axis (north for east); '
                    f'heading_offset {math.degrees(off):.0f} turns it back']
        if scatter < _SCATTER_RAD:
            return [f'{found}: magnetic instead of true north, or a sensor mounted askew? '
                    f'heading_offset {math.degrees(off):.1f} makes up for it']
        return [f'{name}: the heading has nothing to do with the direction of motion (scatter '
                f'{math.degrees(scatter):.0f} deg): another convention, or another sensor; '
                'heading track uses the motion']


def mean_angle(angles: Floats) -> tuple[float, float]:
    """Circular mean of angles, and their circular standard deviation [rad]."""
    mean = np.exp(1j * angles).mean()
    return float(np.angle(mean)), math.sqrt(-2 * math.log(max(abs(mean), 1e-9)))


def origin_of(frame: str) -> tuple[float, float]:
    """Latitude and longitude [deg] of ``LAT,LON``.

    Raises:
        UsageError: it is not that.
    """
    try:
        latitude, longitude = map(float, frame.split(','))
    except ValueError:
        latitude = math.nan
    if not (abs(latitude) <= 90 and abs(longitude) <= 180):
        raise UsageError(
            f'frame {frame!r:.60}: expected runway, or LAT,LON [deg] of the origin of an '
            'east-north-up frame')
    return latitude, longitude


def _pose(message: Any) -> Any:
    """The pose of an Odometry or PoseStamped."""
    return message.pose.pose if hasattr(message.pose, 'pose') else message.pose


def _yaw(turned: Any) -> float:
    """Yaw of a quaternion [rad]; NaN for zeros, which are no rotation."""
    x, y, z, w = turned.x, turned.y, turned.z, turned.w
    norm = x * x + y * y + z * z + w * w
    if not norm > 0.5:
        return math.nan
    return yaw_of(x, y, z, w)


def _of_geodetic(
    runway: Runway, latitude: Iterable[float], longitude: Iterable[float], heading: Floats
) -> tuple[Floats, Floats, Floats]:
    frame = runway_frame(runway)
    poses = [
        frame.to_map(GeodeticPose(
            latitude_rad=math.radians(lat), longitude_rad=math.radians(lon),
            altitude_m=runway.elevation_m, heading_rad=turned,
        )) for lat, lon, turned in zip(latitude, longitude, heading.tolist(), strict=True)
    ]
    rows = np.array([(pose.x_m, pose.y_m, pose.yaw_rad) for pose in poses])
    return rows[:, 0], rows[:, 1], rows[:, 2]


def unwrapped(yaw: Floats) -> Floats:
    """Angles without leaps of a whole turn, so that they can be interpolated."""
    known = np.isfinite(yaw)
    found = yaw.copy()
    found[known] = np.unwrap(yaw[known])
    return found


def _motion(stamps_ns: NDArray[np.int64], x: Floats, y: Floats, yaw: Floats) -> Poses:
    """Direction of motion, speed and turn rate, by straight lines through a window of time."""
    t = (stamps_ns - stamps_ns[0]) / NS_PER_S
    # At least one sample on each side, however slow the source is.
    window_s = max(_WINDOW_S, 1.01 * float(np.median(np.diff(t))))
    values = pd.DataFrame(
        {'t': t, 'x': x - x[0], 'y': y - y[0], 'yaw': unwrapped(yaw)},
        index=pd.to_datetime(stamps_ns))
    near = values.rolling(pd.Timedelta(seconds=2 * window_s), center=True, closed='both')
    slopes = near.cov(values['t']).div(near['t'].var(), axis=0)
    dx, dy, turn = (slopes[name].to_numpy() for name in ('x', 'y', 'yaw'))
    turn = np.where(np.isfinite(yaw), turn, np.nan)
    return Poses(x, y, np.arctan2(dy, dx), np.hypot(dx, dy), turn)
