"""Sensors beside the camera: which there are, from YAML files and scenarios, and what they measure.

All but the second camera are at the aircraft's reference point, ``base_link``. What a sensor
delivers depends on simulated time and the true state alone (:mod:`taxinet_ros.core.sensing`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.documents import Catalogue, NamedDocument, canonical
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.runway_frame import GeodeticPose, runway_frame
from taxinet_ros.core.place.track import Track
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.rig.catalogue import CAMERAS
from taxinet_ros.core.types import NS_PER_S, reached_ns, step_stamp_ns, steps_in, yaw_of
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section, expected, read_yaml

NO_SENSORS = 'none'
"""Name of the document without any."""
RATES_HZ = (1, 2, 5, 6, 8, 10, 12, 15, 20, 24, 30, 40, 50, 60, 80, 100)
"""Rates of sensors; a second camera has only those that divide the control rate."""
LONGEST_S = 600.0
MOST_NOISE_M, MOST_BIAS_M = 50.0, 50.0
_COMMON = ('rate_hz', 'delay_s', 'loss_percent', 'dropouts')
_MOST_DROPOUTS = 32


@dataclass(frozen=True, kw_only=True, slots=True)
class Sensor:
    """When a sensor measures, and what of it is lost.

    Attributes:
        name: its key in a file.
        rate_hz: one of :data:`RATES_HZ`, from the start of the run on.
        delay_s: time from a measurement to its message [s].
        loss_fraction: share of the messages that are lost, each by chance.
        dropouts: start and length [s] of the times whose measurements are lost.
    """

    name: str
    rate_hz: int
    delay_s: float = 0.0
    loss_fraction: float = 0.0
    dropouts: tuple[tuple[float, float], ...] = ()

    @property
    def period_ns(self) -> int:
        """Time between two measurements [ns], rounded down; see :func:`.types.step_stamp_ns`."""
        return NS_PER_S // self.rate_hz

    def stamp_ns(self, number: int) -> int:
        """When a measurement is made, counted from 0 [ns]."""
        return step_stamp_ns(number, self.period_ns)

    def between(self, begin_ns: int, end_ns: int) -> range:
        """Numbers of the measurements after ``begin_ns``, up to and including ``end_ns``."""
        return range(*(max(steps_in(one + 1, self.period_ns), 0) for one in (begin_ns, end_ns)))

    def silent(self, stamp_ns: int) -> bool:
        """Whether a time is in a drop-out, the start included and the end not."""
        return any(
            reached_ns(start_s) <= stamp_ns < reached_ns(start_s + length_s)
            for start_s, length_s in self.dropouts
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class Gnss(Sensor):
    """A satellite receiver: latitude, longitude and height.

    Attributes:
        noise_m: standard deviation in each direction [m].
        correlation_s: time over which the noise keeps its value; 0: white [s].
        bias_m: constant offset to the left of the runway's direction [m].
    """

    name: str = 'gnss'
    noise_m: float = 0.0
    correlation_s: float = 0.0
    bias_m: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Imu(Sensor):
    """An inertial unit with attitude: rates, specific force, and orientation.

    Attributes:
        yaw_rate_noise_radps, yaw_rate_bias_radps: of each rate, and of that of yaw [rad/s].
        acceleration_noise_mps2, acceleration_bias_mps2: of each axis, and ahead [m/s²].
        heading_noise_rad, heading_bias_rad: of the orientation's yaw [rad], left positive.
    """

    name: str = 'imu'
    yaw_rate_noise_radps: float = 0.0
    yaw_rate_bias_radps: float = 0.0
    acceleration_noise_mps2: float = 0.0
    acceleration_bias_mps2: float = 0.0
    heading_noise_rad: float = 0.0
    heading_bias_rad: float = 0.0

    @property
    def sigmas(self) -> tuple[float, float, float]:
        """Standard deviations as in :class:`Inertial`."""
        return self.heading_noise_rad, self.yaw_rate_noise_radps, self.acceleration_noise_mps2


@dataclass(frozen=True, kw_only=True, slots=True)
class WheelSpeed(Sensor):
    """Speed along the body's x axis.

    Attributes:
        noise_mps: standard deviation [m/s].
        bias_percent: too fast by this share of the speed [%].
    """

    name: str = 'wheel'
    noise_mps: float = 0.0
    bias_percent: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class SecondCamera(Sensor):
    """A second camera, without the faults of lens and sensor, which are the first one's.

    Attributes:
        mount: its mounting and lens.
    """

    name: str = 'camera'
    mount: CameraModel


@dataclass(frozen=True, kw_only=True)
class Sensors(NamedDocument):
    """The sensors of a scenario beside its camera; None: not there."""

    gnss: Gnss | None = None
    imu: Imu | None = None
    wheel: WheelSpeed | None = None
    camera: SecondCamera | None = None

    @property
    def present(self) -> tuple[Sensor, ...]:
        """Those that are there."""
        every = self.gnss, self.imu, self.wheel, self.camera
        return tuple(one for one in every if one is not None)

    @property
    def names(self) -> tuple[str, ...]:
        """Keys of those that are there."""
        return tuple(one.name for one in self.present)

    def refuse_camera(self, who: str) -> None:
        """Refuse a second camera: only our own renderer in our own world takes its pictures.

        Raises:
            UsageError: there is one.
        """
        if self.camera is not None:
            raise UsageError(
                f'sensors: camera: {who} does not take the pictures of a second camera; leave it '
                'out'
            )

    def with_gnss(
        self, *, noise_m: float, bias_m: float, start_s: float, length_s: float
    ) -> Sensors:
        """The same with other noise and bias of the GNSS where not 0, and another drop-out."""
        if self.gnss is None:
            return self
        gnss = replace(
            self.gnss, noise_m=noise_m or self.gnss.noise_m, bias_m=bias_m or self.gnss.bias_m,
            dropouts=(*self.gnss.dropouts, *([(start_s, length_s)] if length_s else [])),
        )
        return replace(self, gnss=gnss)


@dataclass(frozen=True, kw_only=True, slots=True)
class Fix:
    """One measurement of the GNSS.

    Attributes:
        stamp_ns: when it was measured [ns].
        latitude_deg, longitude_deg, altitude_m: WGS84 [deg, deg, m above the ellipsoid].
        sigma_m: standard deviation in each direction; 0: unknown [m].
        runway, track: that :attr:`position_m` and :attr:`cte_m` refer to.
    """

    stamp_ns: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    sigma_m: float
    runway: Runway
    track: Track

    @property
    def position_m(self) -> tuple[float, float]:
        """Position in ``map``: x and y [m]."""
        at = runway_frame(self.runway).to_map(GeodeticPose(
            latitude_rad=math.radians(self.latitude_deg),
            longitude_rad=math.radians(self.longitude_deg), altitude_m=self.altitude_m,
            heading_rad=0.0,
        ))
        return at.x_m, at.y_m

    @property
    def cte_m(self) -> float:
        """Cross-track error on the track that is followed [m]."""
        return self.track.measure(*self.position_m).cte_m


@dataclass(frozen=True, kw_only=True, slots=True)
class Inertial:
    """One measurement of the IMU, as in ``sensor_msgs/Imu`` (REP-145), in ``base_link``.

    Attributes:
        stamp_ns: when it was measured [ns].
        rates_radps: about x, y and z [rad/s].
        acceleration_mps2: specific force along x, y and z, +9.81 upwards at rest [m/s²].
        orientation: quaternion (x, y, z, w) of ``base_link`` in an east-north-up frame.
        sigmas: standard deviations of yaw [rad], rates [rad/s] and acceleration [m/s²]; 0: unknown.
    """

    stamp_ns: int
    rates_radps: tuple[float, float, float]
    acceleration_mps2: tuple[float, float, float]
    orientation: tuple[float, float, float, float]
    sigmas: tuple[float, float, float]

    @property
    def yaw_rate_radps(self) -> float:
        """Rate of yaw, counter-clockwise [rad/s]."""
        return self.rates_radps[2]

    @property
    def yaw_rad(self) -> float:
        """Counter-clockwise from east [rad]."""
        return yaw_of(*self.orientation)


@dataclass(frozen=True, kw_only=True, slots=True)
class Speed:
    """One measurement of the wheels' speed.

    Attributes:
        stamp_ns: when it was measured [ns].
        speed_mps: along the body's x axis [m/s].
        sigma_mps: its standard deviation; 0: unknown [m/s].
    """

    stamp_ns: int
    speed_mps: float
    sigma_mps: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Picture:
    """One picture of the second camera, taken when it is looked at: a run without is no slower.

    Attributes:
        stamp_ns: when it was exposed [ns].
        take: gives its pixels, the same every time.
    """

    stamp_ns: int
    take: Callable[[], NDArray[np.uint8]]

    @property
    def image(self) -> NDArray[np.uint8]:
        """Pixels, (height, width, 3) uint8 RGB of its mount, read-only."""
        image = self.take()
        image.flags.writeable = False
        return image


@dataclass(frozen=True, kw_only=True, slots=True)
class Measured:
    """What has arrived since the frame before, oldest first; nothing in a drop-out.

    Attributes:
        hold_lines_m: distances along the track of the hold lines that are not cleared now,
            ascending [m]; no measurement, but what the tower says.
    """

    gnss: tuple[Fix, ...] = ()
    imu: tuple[Inertial, ...] = ()
    wheel: tuple[Speed, ...] = ()
    camera: tuple[Picture, ...] = ()
    hold_lines_m: tuple[float, ...] = ()


def make_sensors(values: object, path: Path, *, shipped: bool = False) -> Sensors:
    """The sensors that plain values stand for.

    Args:
        values: what a file holds.
        path: of the file, for the messages; its stem names them in tables.
        shipped: whether it is shipped with the package.

    Raises:
        UsageError: a value is not as it should be.
    """
    top = Section(path, values, ('gnss', 'imu', 'wheel', 'camera'))
    document = dict(values) if isinstance(values, dict) else {}
    camera = _camera(top) if 'camera' in top else None
    if camera is not None:  # a scenario holds the whole camera
        text = camera.mount.text
        mount = json.loads(text) if text.startswith('{') else text
        document['camera'] = {**document['camera'], 'mount': mount}
    found = Sensors(
        name=path.stem if shipped else 'sensors', title='sensors beside the camera',
        document=canonical(document), shipped=shipped, camera=camera,
        gnss=_gnss(top) if 'gnss' in top else None,
        imu=_imu(top) if 'imu' in top else None,
        wheel=_wheel(top) if 'wheel' in top else None,
    )
    if not found.present:
        raise top.wrong('expected one of gnss, imu, wheel, camera; without any, leave the key out')
    return found


def _gnss(top: Section) -> Gnss:
    own = top.section('gnss', (*_COMMON, 'noise_m', 'correlation_s', 'bias_m'))
    rate_hz, delay_s, loss, dropouts = _common(own)
    return Gnss(
        rate_hz=rate_hz, delay_s=delay_s, loss_fraction=loss, dropouts=dropouts,
        noise_m=own.number('noise_m', 0.0, MOST_NOISE_M, 0.0),
        correlation_s=own.number('correlation_s', 0.0, LONGEST_S, 0.0),
        bias_m=own.number('bias_m', -MOST_BIAS_M, MOST_BIAS_M, 0.0),
    )


def _imu(top: Section) -> Imu:
    own = top.section('imu', (
        *_COMMON, 'yaw_rate_noise_degps', 'yaw_rate_bias_degps', 'acceleration_noise_mps2',
        'acceleration_bias_mps2', 'heading_noise_deg', 'heading_bias_deg',
    ))

    def angle(key: str, low: float, high: float) -> float:
        return math.radians(own.number(key, low, high, 0.0))

    rate_hz, delay_s, loss, dropouts = _common(own)
    return Imu(
        rate_hz=rate_hz, delay_s=delay_s, loss_fraction=loss, dropouts=dropouts,
        yaw_rate_noise_radps=angle('yaw_rate_noise_degps', 0.0, 90.0),
        yaw_rate_bias_radps=angle('yaw_rate_bias_degps', -90.0, 90.0),
        acceleration_noise_mps2=own.number('acceleration_noise_mps2', 0.0, 50.0, 0.0),
        acceleration_bias_mps2=own.number('acceleration_bias_mps2', -50.0, 50.0, 0.0),
        heading_noise_rad=angle('heading_noise_deg', 0.0, 180.0),
        heading_bias_rad=angle('heading_bias_deg', -180.0, 180.0),
    )


def _wheel(top: Section) -> WheelSpeed:
    own = top.section('wheel', (*_COMMON, 'noise_mps', 'bias_percent'))
    rate_hz, delay_s, loss, dropouts = _common(own)
    return WheelSpeed(
        rate_hz=rate_hz, delay_s=delay_s, loss_fraction=loss, dropouts=dropouts,
        noise_mps=own.number('noise_mps', 0.0, 50.0, 0.0),
        bias_percent=own.number('bias_percent', -100.0, 100.0, 0.0),
    )


def _camera(top: Section) -> SecondCamera:
    own = top.section('camera', (*_COMMON, 'mount'))
    kind = f'one of {", ".join(CAMERAS.shipped)}, the YAML file of a camera, or its keys'
    given = own.take('mount', kind)
    if isinstance(given, dict):
        given = canonical(given)
    if not isinstance(given, str):
        raise own.wrong(expected(kind, given), 'mount')
    # Files are for files: a scenario from a bag has the whole camera.
    beside = top.path.parent / given if top.path.suffix and not given.startswith('{') else None
    mount = CAMERAS.find(given) if beside is None or not beside.suffix else CAMERAS.typed(
        str(beside))
    rate_hz, delay_s, loss, dropouts = _common(own)
    return SecondCamera(
        rate_hz=rate_hz, delay_s=delay_s, loss_fraction=loss, dropouts=dropouts, mount=mount,
    )


def _common(own: Section) -> tuple[int, float, float, tuple[tuple[float, float], ...]]:
    rate_hz = own.number('rate_hz', RATES_HZ[0], RATES_HZ[-1])
    if rate_hz not in RATES_HZ:
        raise own.wrong(f'expected one of {", ".join(map(str, RATES_HZ))}, got {rate_hz:g}',
                        'rate_hz')
    silences = own.sections('dropouts', ('start_s', 'length_s'), optional=True, most=_MOST_DROPOUTS)
    return (
        int(rate_hz), own.number('delay_s', 0.0, LONGEST_S, 0.0),
        own.number('loss_percent', 0.0, 100.0, 0.0) / 100.0,
        tuple((one.number('start_s', 0.0, LONGEST_S), one.number('length_s', 0.0, LONGEST_S))
              for one in silences),
    )


def _read(path: Path, shipped: bool) -> Sensors:
    if shipped and path.stem == NO_SENSORS:
        return Sensors(name=NO_SENSORS, title='no sensors', document='{}', shipped=True)
    return make_sensors(read_yaml(path, option='sensors'), path, shipped=shipped)


SENSOR_SETS: Catalogue[Sensors] = Catalogue(
    'sensors', shipped=(NO_SENSORS, 'standard'), read=_read, make=make_sensors,
    folder=Path(__file__).parent / 'shipped_sensors', one='sensors',
)
"""None, a usual set, and the user's."""
find_sensors = SENSOR_SETS.find


def load_sensors(source: str | Path | Mapping[str, Any]) -> str:
    """Load sensors beside the camera for a scenario.

    ``Scenario(sensors=load_sensors({'gnss': {'rate_hz': 5, 'noise_m': 1.5}}))``

    Args:
        source: a shipped name, a YAML file, or the sensors with the keys of such a file
            (docs/world.md).

    Raises:
        UsageError: none of these, or a value is not as it should be.
    """
    if isinstance(source, Mapping):
        return make_sensors(dict(source), Path('sensors')).text
    return SENSOR_SETS.typed(str(source)).text
