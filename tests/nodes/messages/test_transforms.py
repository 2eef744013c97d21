"""The frames: where ``tf`` and ``tf_static`` put things is where the camera sees them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_edits import GOLDEN, altered, unaltered
from geometry_msgs.msg import TransformStamped
from graph_runs import on_own_domain, spin
from nav_msgs.msg import Odometry
from playing import listening, playing
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage

from taxinet_ros.bag.cdr.alignment import Canonical
from taxinet_ros.bag.cdr.image import frame_of_cdr
from taxinet_ros.bag.check.compare import compare_bags
from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.reader import read_info, stored_messages
from taxinet_ros.bag.run.messages import odometry_cdr
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.run_bag import bag_topics
from taxinet_ros.bag.run.topics import is_of_frames
from taxinet_ros.bag.run.transforms import OdometryTransforms, camera_transform
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import message_definition, type_hash
from taxinet_ros.bag.writer import BagWriter
from taxinet_ros.core.camera import camera
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.place.markings import markings
from taxinet_ros.core.types import AircraftState
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.simulator import Simulator

GENUINE_HASH = 'RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087'
"""Of tf2_msgs/msg/TFMessage in ROS 2 Jazzy: `ros2 topic info -v /tf` shows it."""

TF, TF_STATIC, ODOMETRY = '/tf', '/tf_static', '/ground_truth/odom'


@pytest.fixture(scope='module')
def bare(tmp_path_factory) -> Path:
    """A run without transforms, as ``taxinet bag split`` writes it."""
    source = GOLDEN / 'truth-nominal'
    folder = tmp_path_factory.mktemp('bare') / source.name
    topics = [topic for topic in read_info(source).topics if not is_of_frames(topic.name)]
    with BagWriter(folder, topics, metadata={}, attachments={}, min_free_bytes=0) as writer:
        for topic, stamp_ns, cdr, _ in stored_messages(source, lambda name: not is_of_frames(name)):
            writer.write(topic.name, cdr, stamp_ns)
    return folder


def state(**more: float) -> AircraftState:
    values = {
        'x_m': 700.0, 'y_m': 2.0, 'z_m': 1.5, 'roll_rad': 0.01, 'pitch_rad': 0.02, 'yaw_rad': 0.3,
        'speed_mps': 5.0, 'yaw_rate_radps': 0.0,
    }
    return AircraftState(**{**values, **more})


def transform_in(cdr: bytes) -> TransformStamped:
    """The one transform of a message."""
    (transform,) = deserialize_message(cdr, TFMessage).transforms
    return transform


def into_child(transform: TransformStamped, points: np.ndarray) -> np.ndarray:
    """Points (N, 3) of the parent frame, in the child's."""
    moved, turned = transform.transform.translation, transform.transform.rotation
    rotation = Rotation.from_quat([turned.x, turned.y, turned.z, turned.w])
    return rotation.inv().apply(points - np.array([moved.x, moved.y, moved.z]))


def pixels_of(points: np.ndarray, tf: bytes, tf_static: bytes, k: Any) -> np.ndarray:
    """Where points in map (N, 3) lie in the picture (N, 2), as RViz and Foxglove compute it."""
    optical = into_child(transform_in(tf_static), into_child(transform_in(tf), points))
    assert (optical[:, 2] > 0).all(), 'behind the camera'
    image = optical @ np.reshape(k, (3, 3)).T
    return image[:, :2] / image[:, 2:]


def messages(bag: Path, *topics: str) -> dict[str, list[StoredMessage]]:
    found: dict[str, list[StoredMessage]] = {topic: [] for topic in topics}
    for stored in stored_messages(bag, topics.__contains__):
        found[stored.topic.name].append(stored)
    return found


def test_ros21_given_the_message_then_it_is_the_genuine_one_for_whoever_has_that():
    assert type_hash('tf2_msgs/msg/TFMessage') == GENUINE_HASH
    first, *_ = message_definition('tf2_msgs/msg/TFMessage').splitlines()
    assert first == 'geometry_msgs/TransformStamped[] transforms'


def test_ros21_given_a_pose_then_the_bytes_are_those_that_ros_makes_of_the_message():
    cdr = odometry_cdr(state(), 1_300_000_000)
    odometry = deserialize_message(cdr, Odometry)
    transform = TransformStamped(header=odometry.header, child_frame_id='base_link')
    transform.transform.translation.x, transform.transform.translation.y = 700.0, 2.0
    transform.transform.translation.z = 1.5
    transform.transform.rotation = odometry.pose.pose.orientation
    expected = serialize_message(TFMessage(transforms=[transform]))
    canonical = Canonical(bag_topics())
    found = OdometryTransforms()(cdr)
    assert found == canonical.message(TF, bytes(expected))
    static = camera_transform()
    again = serialize_message(deserialize_message(static, TFMessage))
    assert static == canonical.message(TF_STATIC, bytes(again))


def test_ros21_given_the_frames_then_a_point_goes_through_them_to_the_pixel_of_the_camera():
    at = state()
    target = np.array([[730.0, -4.0, 0.0], [760.0, 6.0, 2.0]])
    tf = OdometryTransforms()(odometry_cdr(at, 0))
    found = pixels_of(target, tf, camera_transform(), camera.intrinsics())
    np.testing.assert_allclose(found, camera.project(at, target)[0], atol=1e-9)


def test_ros21_given_the_optical_frame_then_right_is_right_and_down_is_down_and_ahead_is_ahead():
    tf = OdometryTransforms()(odometry_cdr(state(yaw_rad=0.0), 0))
    spot, left, above, beyond = into_child(
        transform_in(camera_transform()),
        into_child(transform_in(tf), np.array([
            [740.0, 0, 0], [740.0, 3, 0], [740.0, 0, 2], [780.0, 0, 0],
        ])),
    )
    assert left[0] < spot[0] - 2
    assert above[1] < spot[1] - 1.5
    assert beyond[2] > spot[2] + 30


@pytest.mark.ros
def test_ros21_given_a_recorded_run_then_its_frames_lead_to_the_white_paint_in_its_pictures(bag):
    """Nothing here asks the renderer: the picture and the three messages are the bag's own."""
    found = messages(bag, '/camera/image_raw', '/camera/camera_info', TF, TF_STATIC)
    (static,) = found[TF_STATIC]
    # The cowling hides those on the left; the centreline is worn.
    bars = [np.array(m.polygon) for m in markings(default_runway()) if m.kind == 'touchdown']
    right = [bar for bar in bars if 0 < bar[:, 0].min() - 600.0 < 30 and bar[:, 1].max() < 0]
    assert len(right) == 2
    for image, info, tf in zip(
        found['/camera/image_raw'], found['/camera/camera_info'], found[TF], strict=True
    ):
        _, picture = frame_of_cdr(image.cdr)
        k = deserialize_message(info.cdr, CameraInfo).k
        for bar in right:
            shades = []
            for aside in (0.0, -1.12, 1.12):  # m: on the paint, and between and beside the bars
                spots = np.array([[x, bar[:, 1].mean() + aside, 0.0] for x in range(626, 632)])
                columns, rows = np.rint(pixels_of(spots, tf.cdr, static.cdr, k)).astype(int).T
                shades.append(picture[rows, columns].max(axis=1).mean())
            assert shades[0] > max(shades[1:]) + 40, (tf.stamp_ns, shades)


@pytest.mark.ros
def test_ros21_given_a_run_then_its_bag_has_the_frames_bit_for_bit_as_odometry_says(bag):
    found = messages(bag, TF, TF_STATIC, ODOMETRY)
    assert len(found[TF]) == len(found[ODOMETRY]) == 21
    for tf, odometry in zip(found[TF], found[ODOMETRY], strict=True):
        said, pose = transform_in(tf.cdr), deserialize_message(odometry.cdr, Odometry)
        at, moved = pose.pose.pose, said.transform
        assert tf.stamp_ns == odometry.stamp_ns
        assert (said.header, said.child_frame_id) == (pose.header, pose.child_frame_id)
        assert (said.header.frame_id, said.child_frame_id) == ('map', 'base_link')
        assert moved.rotation == at.orientation
        assert [getattr(moved.translation, axis) == getattr(at.position, axis)
                for axis in 'xyz'] == [True] * 3
    (static,) = found[TF_STATIC]
    assert static.stamp_ns == 0
    said = transform_in(static.cdr)
    assert (said.header.frame_id, said.child_frame_id) == ('base_link', 'camera_optical')
    image = next(stored_messages(bag, '/camera/image_raw'.__eq__))
    assert b'camera_optical\0' in image.cdr[:64], 'the picture is of that frame'
    assert check_bag(bag).findings == ()
    assert open_recording(bag).plain


@pytest.mark.ros
def test_ros21_given_bags_without_transforms_then_they_are_whole_and_compare_with_others(
    bag, bare, tmp_path
):
    assert TF not in read_info(bare).counts
    assert check_bag(bare).findings == ()
    old = altered(
        bag, tmp_path / bag.name, unaltered, keep=lambda m: m.topic.name not in (TF, TF_STATIC)
    )
    for pair in ((bag, old), (old, bag)):
        compared = compare_bags(*pair)
        assert all(topic.equal for topic in compared)
        assert len(compared) == len(bag_topics()) - 2
    both = {topic.topic for topic in compare_bags(bag, bag)}
    assert {TF, TF_STATIC} <= both


@pytest.mark.ros
def test_ros21_given_a_bag_that_is_played_then_whoever_asks_hears_where_the_frames_are(bag):
    steps = read_info(bag).counts[ODOMETRY]
    with listening(*interface.TRANSFORMS, interface.ODOMETRY) as (listener, executor, context):
        wait_for = ['ground_truth/odom', 'tf', 'tf_static']
        with playing(context, executor, bag, rate=20.0, wait_for=wait_for) as player:
            assert player.play(executor) == 0
            heard = listener.heard
            spin(executor, lambda: len(heard['ground_truth/odom']) == steps)
            spin(executor, lambda: len(heard['tf']) == steps)
    assert len(heard['tf_static']) == 1
    assert heard['tf_static'][0].startswith(camera_transform())
    of_odometry = OdometryTransforms()
    recorded = [of_odometry(one.cdr) for one in messages(bag, ODOMETRY)[ODOMETRY]]
    told = [one[:len(recorded[0])] for one in heard['tf']]
    assert told == recorded


@pytest.mark.ros
def test_ros21_given_a_namespace_then_the_frames_are_in_it_and_the_diagnostics_are_everybodys():
    with on_own_domain() as spinning:
        node = Simulator(context=spinning.context, namespace='/left')
        spinning.add(node)
        names = {publisher.topic_name for publisher in node.publishers}
    assert names >= {'/left/tf', '/left/tf_static', '/diagnostics'}
