"""Recordings with known answers, small and made by code.

The pictures show cross-track and heading error as colours, by halves, so that a function of a few
lines sees them exactly, and with the other sign in a mirrored picture.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
from PIL import Image
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from taxinet_ros.core.place.catalogue import find_place
from taxinet_ros.core.place.runway_frame import GeodeticPose, MapPose, runway_frame

TYPES = get_typestore(Stores.ROS2_JAZZY)
BEGUN_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000
WHITE = 2**24 - 1
COMPRESSED = 'sensor_msgs/msg/CompressedImage'

SEE = '''
"""What the pictures of a synthetic recording show, with errors where they are asked for."""
import math
import zlib

SCALES = 20.0, 1.0

def number(image, row, column):
    red, green, blue = (int(one) for one in image[row, column])
    return (red * 65536 + green * 256 + blue) / (2**24 - 1)

def see(image):
    cte, he = (
        (number(image, row, 90) - number(image, row, 270)) * scale
        for row, scale in zip((50, 150), SCALES)
    )
    return cte, he

def biased(image):
    cte, he = see(image)
    return cte + 0.5, he + math.radians(1)

def in_degrees(image):
    cte, he = see(image)
    return cte, math.degrees(he)

def turned(image):
    cte, he = see(image)
    return -cte, he

def feet(image):
    return see(image)

def elsewhere(image):
    noise = zlib.crc32(image.tobytes()) / 2**32 - 0.5  # hash() differs between processes
    return noise, 0.3 * noise
'''


def path(t: float) -> tuple[float, float, float]:
    """x, y [m] and yaw [rad] in ``map`` at a time [s]: weaving along the runway at 5 m/s."""
    def y(at: float) -> float:
        return 2.0 * math.sin(at / 3.0) + 1.5 * math.sin(at / 7.3)

    slope = (y(t + 1e-4) - y(t - 1e-4)) / 2e-4
    return 500.0 + 5.0 * t, y(t), math.atan2(slope, 5.0)


@dataclass(kw_only=True)
class Drive:
    """What is recorded.

    Attributes:
        seconds, hz: length, and positions a second.
        noise_m: standard deviation of a position.
        late_s: by how much the stamps of pictures are late.
        antenna_m: place of the antenna, forward and left.
        picture: changes pixels.
        heading: yaw of the Imu message from the true heading [rad].
        shift_deg: added to latitude.
        stamp: header stamp [ns] of a message by its kind and true time.
        encoding: of the pictures.
        more: further messages: topic, type, message, time [ns].
    """

    seconds: float = 60.0
    hz: float = 10.0
    noise_m: float = 0.0
    late_s: float = 0.0
    antenna_m: tuple[float, float] = (0.0, 0.0)
    picture: Callable[[np.ndarray], np.ndarray] = lambda pixels: pixels
    heading: Callable[[float], float] = lambda heading: math.pi / 2 - heading
    shift_deg: float = 0.0
    stamp: Callable[[str, int], int] = lambda kind, stamp_ns: stamp_ns
    encoding: str = 'rgb8'
    place: str = 'kmwh_04'
    along: Callable[[float], tuple[float, float, float]] = path
    truth: str = 'fix'
    size: tuple[int, int] = (8, 12)
    more: list[tuple[str, str, Any, int]] = field(default_factory=list)


def pixels_of(cte_m: float, he_rad: float, size: tuple[int, int]) -> np.ndarray:
    """Picture (H, W, 3) uint8 of the two errors."""
    height, width = size
    pixels = np.zeros((height, width, 3), np.uint8)
    rows = (slice(None, height // 2), slice(height // 2, None))
    for own, share in zip(rows, (cte_m / 20.0, he_rad), strict=True):
        for columns, value in ((slice(None, width // 2), 0.5 + share / 2),
                               (slice(width // 2, None), 0.5 - share / 2)):
            code = round(min(max(value, 0.0), 1.0) * WHITE)
            pixels[own, columns] = code >> 16, code >> 8 & 255, code & 255
    return pixels


def make(kind: str, **fields: Any) -> Any:
    """A message; the fields have to be complete."""
    return TYPES.types[kind](**fields)


def header(stamp_ns: int, frame: str) -> Any:
    time = make('builtin_interfaces/msg/Time', sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return make('std_msgs/msg/Header', stamp=time, frame_id=frame)


def quaternion(yaw: float) -> Any:
    return make('geometry_msgs/msg/Quaternion', x=0.0, y=0.0, z=math.sin(yaw / 2),
                w=math.cos(yaw / 2))


def point(x: float, y: float) -> dict[str, float]:
    return {'x': x, 'y': y, 'z': 0.0}


def image(pixels: np.ndarray, stamp_ns: int, encoding: str, frame: str = 'camera') -> Any:
    """Image, padded by three bytes a row, or CompressedImage of ``png`` or ``jpeg``."""
    if encoding in ('png', 'jpeg'):
        buffer = io.BytesIO()
        Image.fromarray(pixels).save(buffer, format=encoding, quality=95)
        data = np.frombuffer(buffer.getvalue(), np.uint8)
        return make('sensor_msgs/msg/CompressedImage', header=header(stamp_ns, frame),
                    format=encoding, data=data)
    height, width = pixels.shape[:2]
    channels = pixels[..., ::-1] if encoding == 'bgr8' else pixels
    rows = channels.reshape(height, -1)
    padded = np.concatenate([rows, np.full((height, 3), 7, np.uint8)], axis=1)
    return make('sensor_msgs/msg/Image', header=header(stamp_ns, frame), height=height, width=width,
                encoding=encoding, is_bigendian=0, step=padded.shape[1], data=padded.reshape(-1))


def fix(latitude: float, longitude: float, stamp_ns: int, *, status: int = 0) -> Any:
    return make(
        'sensor_msgs/msg/NavSatFix', header=header(stamp_ns, 'gnss'), latitude=latitude,
        longitude=longitude, altitude=350.0, position_covariance=np.zeros(9),
        position_covariance_type=0,
        status=make('sensor_msgs/msg/NavSatStatus', status=status, service=1),
    )


def imu(yaw: float, stamp_ns: int) -> Any:
    zero = make('geometry_msgs/msg/Vector3', x=0.0, y=0.0, z=0.0)
    return make(
        'sensor_msgs/msg/Imu', header=header(stamp_ns, 'imu'), orientation=quaternion(yaw),
        orientation_covariance=np.zeros(9), angular_velocity=zero,
        angular_velocity_covariance=np.zeros(9), linear_acceleration=zero,
        linear_acceleration_covariance=np.zeros(9),
    )


def pose(x: float, y: float, yaw: float) -> Any:
    return make('geometry_msgs/msg/Pose', position=make('geometry_msgs/msg/Point', **point(x, y)),
                orientation=quaternion(yaw))


def odometry(x: float, y: float, yaw: float, stamp_ns: int) -> Any:
    zero = make('geometry_msgs/msg/Vector3', x=0.0, y=0.0, z=0.0)
    return make(
        'nav_msgs/msg/Odometry', header=header(stamp_ns, 'odom'), child_frame_id='base_link',
        pose=make('geometry_msgs/msg/PoseWithCovariance', pose=pose(x, y, yaw),
                  covariance=np.zeros(36)),
        twist=make('geometry_msgs/msg/TwistWithCovariance', covariance=np.zeros(36),
                   twist=make('geometry_msgs/msg/Twist', linear=zero, angular=zero)),
    )


def transform(parent: str, child: str, x: float, y: float, yaw: float, stamp_ns: int) -> Any:
    return make('geometry_msgs/msg/TransformStamped', header=header(stamp_ns, parent),
                child_frame_id=child, transform=make(
                    'geometry_msgs/msg/Transform', rotation=quaternion(yaw),
                    translation=make('geometry_msgs/msg/Vector3', **point(x, y))))


@cache  # several drives take the same way, and most of the time of making one goes here
def _geodetic(place: str, x_m: float, y_m: float, yaw_rad: float) -> GeodeticPose:
    frame = runway_frame(find_place(place).runway)
    return frame.to_geodetic(MapPose(x_m=x_m, y_m=y_m, z_m=0.0, yaw_rad=yaw_rad))


def messages(drive: Drive) -> list[tuple[str, str, Any, int]]:
    """Topic, type, message and time of recording [ns], in the order of time."""
    rng = np.random.default_rng(5)
    runway = find_place(drive.place).runway
    found = list(drive.more)
    for number in range(round(drive.seconds * 10) + 1):
        shown_ns = BEGUN_NS + number * PERIOD_NS
        _, cte, he = drive.along(number / 10)
        pixels = drive.picture(pixels_of(cte, he, drive.size))
        stamp_ns = drive.stamp('image', shown_ns + round(drive.late_s * 1e9))
        found.append((
            '/cam', COMPRESSED if drive.encoding in ('png', 'jpeg') else 'sensor_msgs/msg/Image',
            image(pixels, stamp_ns, drive.encoding), shown_ns + round(drive.late_s * 1e9) + 1000,
        ))
    for number in range(-5, round(drive.seconds * drive.hz) + 5):
        t = number / drive.hz
        time_ns = BEGUN_NS + round(t * 1e9)
        x, y, yaw = drive.along(t)
        ahead, left = drive.antenna_m
        x += math.cos(yaw) * ahead - math.sin(yaw) * left + rng.normal(0, drive.noise_m)
        y += math.sin(yaw) * ahead + math.cos(yaw) * left + rng.normal(0, drive.noise_m)
        stamp_ns = drive.stamp('truth', time_ns)
        geodetic = _geodetic(drive.place, x, y, yaw)
        if drive.truth == 'fix':
            found.append(('/fix', 'sensor_msgs/msg/NavSatFix', fix(
                math.degrees(geodetic.latitude_rad) + drive.shift_deg,
                math.degrees(geodetic.longitude_rad), stamp_ns), time_ns))
            found.append(('/imu', 'sensor_msgs/msg/Imu', imu(
                drive.heading(geodetic.heading_rad), stamp_ns), time_ns))
        elif drive.truth == 'odometry':
            east, north, _ = pymap3d.geodetic2enu(
                math.degrees(geodetic.latitude_rad), math.degrees(geodetic.longitude_rad),
                runway.elevation_m, *runway.threshold_deg, runway.elevation_m)
            found.append(('/odom', 'nav_msgs/msg/Odometry', odometry(
                east, north, math.pi / 2 - geodetic.heading_rad, stamp_ns), time_ns))
        else:
            found.append(('/tf', 'tf2_msgs/msg/TFMessage', make(
                'tf2_msgs/msg/TFMessage', transforms=[
                    transform('map', 'odom', 100.0, 0.0, 0.0, stamp_ns),
                    transform('odom', 'base_link', x - 100.0, y, yaw, stamp_ns)]), time_ns))
    return sorted(found, key=lambda one: one[3])


def record(
    folder: Path, drive: Drive, *, storage: StoragePlugin = StoragePlugin.MCAP,
    compression: CompressionMode = CompressionMode.NONE,
    keep: Callable[[str, int], bool] = lambda topic, number: True,
) -> Path:
    """Write a bag of a drive."""
    writer = Writer(folder, version=9, storage_plugin=storage)
    if compression is not CompressionMode.NONE:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    numbers: dict[str, int] = {}
    with writer:
        known: dict[str, Any] = {}
        for topic, kind, message, log_ns in messages(drive):
            number = numbers[topic] = numbers.get(topic, -1) + 1
            if not keep(topic, number):
                continue
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            writer.write(known[topic], log_ns, TYPES.serialize_cdr(message, kind))
    return folder
