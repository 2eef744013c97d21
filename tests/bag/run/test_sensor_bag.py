"""The bag of a run with sensors beside the camera: standard messages, checked, rendered, scored."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from bag_edits import altered, unaltered
from rosbags.highlevel import AnyReader

import taxinet_ros as tx
from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.reader import read_attachment
from taxinet_ros.bag.rewrite.frames import restore_frames
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.run_bag import bag_topics
from taxinet_ros.core import topics
from taxinet_ros.core.place.catalogue import find_place
from taxinet_ros.recordings.reader import Recording
from taxinet_ros.recordings.truth import TruthReader, TruthSource

SENSORS = {
    'gnss': {'rate_hz': 10, 'delay_s': 0.2}, 'imu': {'rate_hz': 20, 'heading_noise_deg': 1},
    'wheel': {'rate_hz': 5, 'noise_mps': 0.25},
}
SCENE = tx.Scenario(
    cross_track_m=2.0, heading_rad=0.1, duration_s=4.0, sensors=tx.load_sensors(SENSORS),
)


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    run = tx.run(SCENE, perception='truth', specs='phi_always')
    return run.save_bag(tmp_path_factory.mktemp('sensed') / 'run', images=False)


def test_given_the_bag_then_its_messages_are_standard_ones_with_frames_and_covariances(bag):
    found: dict[str, list] = {}
    with AnyReader([bag]) as reader:
        for connection, stamp_ns, cdr in reader.messages():
            message = reader.deserialize(cdr, connection.msgtype)
            found.setdefault(connection.topic, []).append((connection.msgtype, stamp_ns, message))
    fixes, turned, speeds = found['/gnss/fix'], found['/imu/data'], found['/wheel/twist']
    assert [len(one) for one in (fixes, turned, speeds)] == [39, 81, 21]
    for kind, stamp_ns, fix in fixes:
        assert kind == 'sensor_msgs/msg/NavSatFix'
        measured_ns = fix.header.stamp.sec * 10**9 + fix.header.stamp.nanosec
        assert stamp_ns == measured_ns + 200_000_000, 'logged when it arrived'
        assert (fix.header.frame_id, fix.status.status, fix.position_covariance_type) == (
            'base_link', 0, 0)
    kind, stamp_ns, one = turned[3]
    assert (kind, one.header.frame_id) == ('sensor_msgs/msg/Imu', 'base_link')
    assert (stamp_ns, one.header.stamp.nanosec) == (200_000_000, 150_000_000)
    assert one.orientation_covariance[8] == pytest.approx(np.radians(1) ** 2)
    assert one.linear_acceleration.z == pytest.approx(9.8, abs=0.1)
    kind, _, one = speeds[0]
    assert (kind, one.header.frame_id) == (
        'geometry_msgs/msg/TwistWithCovarianceStamped', 'base_link')
    assert one.twist.covariance[0] == 0.25 ** 2
    assert not one.twist.covariance[1:].any()


def test_given_a_gnss_without_noise_then_recordings_read_the_true_path_to_1_mm(bag):
    place = find_place('kmwh_04')
    recording = Recording(bag)
    ways = []
    for source in (TruthSource(topic='/gnss/fix'),
                   TruthSource(topic='/ground_truth/odom', frame='runway')):
        reader = TruthReader(source, recording, place.runway)
        for topic, logged_ns, message in recording.decoded(reader.topics):
            reader.add(topic, logged_ns, message)
        ways.append(reader.finish())
    fixes, truth = ways
    assert len(fixes.stamps_ns) == 39
    there = truth.at(fixes.stamps_ns)
    for name in ('x_m', 'y_m'):
        off = np.abs(getattr(fixes.poses, name) - getattr(there, name))
        assert np.isfinite(off).all()
        assert off.max() < 1e-3


def test_given_the_bag_when_scored_against_its_gnss_then_figures_are_those_of_the_truth(
    bag, taxinet
):
    (bag.parent / 'mine.py').write_text('def still(image):\n    return 0.0, 0.0\n')
    rendered = bag.parent / 'rendered' / 'run'
    rendered.parent.mkdir()
    assert list(restore_frames(open_recording(bag), rendered)) == list(range(41))
    figures = []
    for topic in ('/gnss/fix', '/ground_truth/odom'):
        code, out, _ = taxinet('score', rendered, '--truth', topic, '--json', '--latency', '0',
                               '--perception', f'{bag.parent}/mine.py:still')
        assert code == 0
        figures.append(json.loads(out))
    fixes, truth = figures
    assert 30 < fixes['frames'] <= truth['frames'] == 41
    assert fixes['cte_mae_m'] == pytest.approx(truth['cte_mae_m'], rel=0.1)
    assert check_bag(rendered).findings == ()


def test_given_the_bag_then_all_is_well_and_a_measurement_that_lacks_or_is_late_is_found(bag):
    assert check_bag(bag).findings == ()
    gone = altered(bag, bag.parent / 'gone' / 'run', unaltered, keep=lambda stored: not (
        stored.topic.name == '/imu/data' and stored.stamp_ns == 1_500_000_000))
    found = check_bag(gone).findings
    assert [(one.where, one.what) for one in found] == [
        ('step 15', '/imu/data: not the measurements due')]


def test_given_a_second_camera_then_its_frames_are_recorded_rendered_checked_and_not_scored(
    tmp_path, taxinet
):
    scene = dataclasses.replace(SCENE, duration_s=2.0, sensors=tx.load_sensors(
        {'camera': {'mount': 'nose', 'rate_hz': 5, 'delay_s': 0.1}}))
    run = tx.run(scene, perception='truth', specs='phi_always')
    filmed, bare = (run.save_bag(tmp_path / name / 'run', images=name == 'filmed')
                    for name in ('filmed', 'bare'))
    assert '/camera2/image_raw' not in open_recording(bare).info.counts
    (tmp_path / 'rendered').mkdir()
    assert list(restore_frames(open_recording(bare), tmp_path / 'rendered' / 'run')) == [*range(21)]
    for file in filmed.iterdir():
        assert file.read_bytes() == (tmp_path / 'rendered' / 'run' / file.name).read_bytes()
    with AnyReader([filmed]) as reader:
        said = [
            (connection.topic, stamp_ns, reader.deserialize(cdr, connection.msgtype))
            for connection, stamp_ns, cdr in reader.messages()
            if connection.topic in ('/camera2/image_raw', '/tf_static')
        ]
    (_, _, mounted), *frames = said
    assert [(one.child_frame_id, one.transform.translation.x) for one in mounted.transforms] == [
        ('camera_optical', scene.camera_model.offset_m[0]),
        ('camera2_optical', scene.cameras[1].offset_m[0]),
    ]
    assert len(frames) == 10
    for _, stamp_ns, frame in frames:
        assert frame.header.stamp.nanosec == (stamp_ns - 100_000_000) % 10**9
        assert (frame.header.frame_id, frame.encoding) == ('camera2_optical', 'rgb8')
        assert (frame.height, frame.width, len(frame.data)) == (400, 640, 400 * 640 * 3)
    assert check_bag(filmed).findings == ()
    gone = altered(filmed, tmp_path / 'gone' / 'run', unaltered, keep=lambda stored: not (
        stored.topic.name == '/camera2/image_raw' and stored.stamp_ns == 1_100_000_000))
    assert [(one.where, one.what) for one in check_bag(gone).findings] == [
        ('step 11', '/camera2/image_raw: not the measurements due')]
    (tmp_path / 'mine.py').write_text(
        'def still(image):\n    assert image.shape == (200, 360, 3)\n    return 0.0, 0.0\n')
    code, out, _ = taxinet('score', filmed, '--json', '--latency', '0',
                           '--perception', f'{tmp_path}/mine.py:still')
    assert (code, json.loads(out)['frames']) == (0, 21)


def test_given_no_sensors_then_topics_and_request_are_as_before_there_were_any(tmp_path):
    plain = dataclasses.replace(SCENE, sensors='none')
    bag = tx.run(plain, specs='phi_always').save_bag(tmp_path / 'run', images=False)
    info = open_recording(bag).info
    assert [topic.name for topic in info.topics] == [
        topic.name for topic in bag_topics(images=False)]
    assert not {f'/{topic.name}' for topic in topics.SENSORS.values()} & set(info.counts)
    request = json.loads(read_attachment(bag, 'scenario.json'))
    assert len(request) > 40
    assert not [key for key in request if 'gnss' in key or key == 'sensors']
    assert 'gnss_noise_m' in json.loads(read_attachment(
        tx.run(SCENE, specs='phi_always').save_bag(tmp_path / 'other', images=False),
        'scenario.json'))
