# ruff: noqa: I001 (taxinet_ros has to be imported first)
"""Lay a folder of labelled frames into a rosbag2 with NavSatFix and heading, for ``taxinet score``.

The labels (``labels.csv``: image, cte_m, heading_error_deg, distance_m along the runway) become
latitude, longitude and a heading of the place. Frames have no times, so the aircraft is taken to
go at 5 m/s; where the distance falls back, another drive begins 20 s later.
"""

import argparse
import math
from pathlib import Path

import taxinet_ros  # noqa: F401 (before numpy, which it restricts)
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from taxinet_ros.core.place.catalogue import typed_place
from taxinet_ros.core.place.runway_frame import MapPose, runway_frame
from taxinet_ros.training.data.image_folder import open_folder

SPEED_MPS, PAUSE_S = 5.0, 20.0
BEGUN_S = 1_584_723_840.0  # 20 March 2020, 9:04 at Grant County: the light of the published frames
TYPES = get_typestore(Stores.ROS2_JAZZY)
IMAGE, FIX, IMU = (f'sensor_msgs/msg/{name}' for name in ('Image', 'NavSatFix', 'Imu'))

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument('folder', type=Path)
parser.add_argument('out', type=Path)
parser.add_argument('--place', default='kmwh_04')
parser.add_argument('--distance-offset', type=float, default=0.0,
                    help='our distance less theirs [m]')
given = parser.parse_args()
runway = typed_place(given.place).runway
frame = runway_frame(runway)


def make(kind, **fields):
    return TYPES.types[kind](**fields)


def header(stamp_ns, name):
    stamp = make('builtin_interfaces/msg/Time', sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return make('std_msgs/msg/Header', stamp=stamp, frame_id=name)


def messages(shot, stamp_ns):
    pose = frame.to_geodetic(MapPose(
        x_m=shot.distance_m + given.distance_offset, y_m=shot.truth.cte_m, z_m=0.0,
        yaw_rad=shot.truth.he_rad))
    pixels, _ = shot.picture()
    yield '/camera/image_raw', IMAGE, make(
        IMAGE, header=header(stamp_ns, 'camera'), height=pixels.shape[0], width=pixels.shape[1],
        encoding='rgb8', is_bigendian=0, step=3 * pixels.shape[1], data=pixels.reshape(-1))
    yield '/fix', FIX, make(
        FIX, header=header(stamp_ns, 'gnss'), altitude=pose.altitude_m,
        latitude=math.degrees(pose.latitude_rad), longitude=math.degrees(pose.longitude_rad),
        status=make('sensor_msgs/msg/NavSatStatus', status=0, service=1),
        position_covariance=np.zeros(9), position_covariance_type=0)
    yaw = math.pi / 2 - pose.heading_rad  # REP-103: counter-clockwise from east
    zero = make('geometry_msgs/msg/Vector3', x=0.0, y=0.0, z=0.0)
    yield '/imu', IMU, make(
        IMU, header=header(stamp_ns, 'imu'), orientation=make(
            'geometry_msgs/msg/Quaternion', x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2)),
        **dict.fromkeys(('angular_velocity', 'linear_acceleration'), zero),
        **{f'{name}_covariance': np.zeros(9) for name in (
            'orientation', 'angular_velocity', 'linear_acceleration')})


with Writer(given.out, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
    topics, time_s, before_m = {}, BEGUN_S, None
    for shot in open_folder(given.folder).frames:
        if before_m is not None:
            moved_m = shot.distance_m - before_m
            time_s += max(moved_m / SPEED_MPS, 0.01) if moved_m > -1 else PAUSE_S
        before_m = shot.distance_m
        for topic, kind, message in messages(shot, round(time_s * 1e9)):
            if topic not in topics:
                topics[topic] = bag.add_connection(topic, kind, typestore=TYPES)
            bag.write(topics[topic], round(time_s * 1e9), TYPES.serialize_cdr(message, kind))
print(f'written: {given.out}')
