"""Messages carry the core's values unchanged, and refuse what they cannot mean.

What ``camera/camera_info`` says is what the camera does.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, Image

from taxinet_ros.bag.cdr.image import frame_of_cdr, image_cdr
from taxinet_ros.bag.run import message_values
from taxinet_ros.bag.run.messages import camera_info_cdr
from taxinet_ros.core.camera.camera import Camera, intrinsics, pose, project
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.types import AircraftState, quaternion
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.nodes.messages import convert


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_given_a_stamp_when_sent_and_read_then_no_nanosecond_is_lost(stamp_ns):
    assert convert.stamp_of(convert.time_of(stamp_ns)) == stamp_ns


def test_given_a_scenario_when_sent_and_read_then_every_field_is_there():
    scenario = Scenario(
        cross_track_m=-1.25, distance_m=612.5, heading_rad=0.1, clouds='overcast',
        rain_fraction=0.4, time_of_day_s=30000.0, date='2020-06-01', shadows=False, crossing=False,
        aircraft='c172p', wind_speed_mps=2.0, wind_direction_rad=1.5, gust_mps=0.5, gust_seed=3.0,
        runway_state='icy', slope_fraction=-0.01, speed_mps=4.0, track='rapid_exit',
        camera_dropout_fraction=0.1,
        camera_freeze_s=1.0, lens_dirt_fraction=0.2, lens_drops_fraction=0.3,
        glare_ghost_fraction=0.4, exposure_jump_ev=-1.5, loop_delay_s=0.2, loop_jitter_s=0.3,
        steering_bias_rad=0.01, steering_rate_limit_radps=0.1, fault_onset_s=2.0, fault_seed=5.0,
        traffic=load_traffic([{'kind': 'cone', 'x_m': 830, 'y_m': 1}]), camera='nose',
        camera_dx_m=0.1, camera_dy_m=0.1, camera_dz_m=-0.1, camera_droll_rad=0.01,
        camera_dpitch_rad=0.1 + 1e-12, camera_dyaw_rad=-0.0123456789012,
        datarefs='{"sim/a/b":1.0}',
        duration_s=12.0, place='bikf_10', signals='{"gust_mps@5":0.9}',
        sensors='standard', gnss_noise_m=0.5, gnss_bias_m=-0.2, gnss_dropout_start_s=3.0,
        gnss_dropout_s=2.0, control_rate_hz=20.0,
    )
    default = Scenario()
    for field in dataclasses.fields(Scenario):
        assert getattr(scenario, field.name) != getattr(default, field.name), field.name
    request = RunRequest(
        run_id='run', index=3, program='s_falsif', seed=9, scenario=scenario,
        judging=Judging(specs=('phi_always',)), participants=('perception',),
    )
    message = convert.scenario_message(request)
    assert message_values.scenario_of(message) == scenario
    assert (message.run_id, message.index) == ('run', 3)
    assert (message.program, message.seed) == ('s_falsif', 9)


def frame_message(**change):
    pixels = np.random.default_rng(0).integers(0, 256, (200, 360, 3), dtype=np.uint8)
    message = Image(
        header=convert.header(100_000_000, 'camera_optical'), height=200, width=360, step=1080,
        encoding='rgb8', data=pixels.tobytes(),
    )
    for name, value in change.items():
        setattr(message, name, value)
    return pixels, message


def test_given_a_frame_when_sent_and_read_then_ros_reads_it_and_so_do_we_what_ros_writes():
    pixels, message = frame_message()
    assert deserialize_message(image_cdr(pixels, 100_000_000, 'camera_optical'), Image) == message
    stamp_ns, seen = frame_of_cdr(serialize_message(message))
    assert stamp_ns == 100_000_000
    np.testing.assert_array_equal(seen, pixels)


@given(st.integers(1, 5), st.integers(1, 5), st.text('abc_', max_size=9))
def test_given_any_size_and_frame_when_written_and_read_then_the_pixels_are_there(
    height, width, frame_id
):
    pixels = np.arange(height * width * 3, dtype=np.uint8).reshape(height, width, 3)
    stamp_ns, seen = frame_of_cdr(image_cdr(pixels, 7, frame_id))
    assert stamp_ns == 7
    np.testing.assert_array_equal(seen, pixels)


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'encoding': 'mono8'}, "encoding is 'mono8'"),
        ({'step': 12}, 'has step 12'),
        ({'height': 3}, 'of 360 x 3'),
        ({'data': b''}, 'has step 1080 and 0 bytes'),
        ({'data': b'', 'encoding': '', 'height': 0, 'width': 0, 'step': 0}, 'encoding'),
    ],
)
def test_given_an_image_that_contradicts_itself_then_it_is_refused(change, words):
    _, message = frame_message(**change)
    with pytest.raises(ValueError, match=words):
        frame_of_cdr(serialize_message(message))


@given(st.data())
def test_given_bytes_that_are_cut_or_changed_then_a_frame_is_refused_or_read(data):
    clean = image_cdr(np.zeros((2, 3, 3), np.uint8), 5, 'camera_optical')
    at = data.draw(st.integers(0, len(clean)))
    spoilt = clean[:at] + data.draw(st.binary(max_size=6))
    with contextlib.suppress(ValueError):
        assert frame_of_cdr(spoilt)[1].ndim == 3


@given(
    st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-math.pi + 1e-6, math.pi - 1e-6)
)
def test_given_an_attitude_then_its_quaternion_turns_the_axes_the_same_way(roll, pitch, yaw):
    x, y, z, w = quaternion(roll, pitch, yaw)
    assert math.hypot(x, y, z, w) == pytest.approx(1)
    forward = (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w))
    expected = (
        math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), -math.sin(pitch)
    )
    assert forward == pytest.approx(expected), 'positive pitch is nose down'


STATE = AircraftState(
    x_m=500.0, y_m=2.0, z_m=1.55, roll_rad=0.01, pitch_rad=0.02, yaw_rad=-0.1,
    speed_mps=5.0, yaw_rate_radps=0.0,
)


def test_given_the_message_then_size_and_matrices_are_the_cameras_and_it_is_rectified():
    message = deserialize_message(camera_info_cdr(0), CameraInfo)
    assert (message.height, message.width, 3) == Camera(Scenario()).render(STATE, 0).shape
    np.testing.assert_array_equal(np.reshape(message.k, (3, 3)), intrinsics())
    np.testing.assert_array_equal(np.reshape(message.r, (3, 3)), np.eye(3))
    assert list(message.d) == [0.0] * 5
    assert message.distortion_model == 'plumb_bob'
    assert (message.binning_x, message.binning_y) in ((0, 0), (1, 1))


def test_given_points_in_the_optical_frame_when_p_is_applied_then_the_pixels_are_the_pictures():
    projection = np.reshape(deserialize_message(camera_info_cdr(0), CameraInfo).p, (3, 4))
    points = np.array([(x, y, z) for x in (505.0, 530.0) for y in (-12.0, 4.0) for z in (0.0, 1.0)])
    _, to_optical, place = pose(STATE)
    optical = np.column_stack([(points - place) @ to_optical.T, np.ones(len(points))])
    homogenous = optical @ projection.T
    pixels, depth = project(STATE, points)
    np.testing.assert_allclose(homogenous[:, :2] / homogenous[:, 2:], pixels, atol=1e-9)
    np.testing.assert_allclose(homogenous[:, 2], depth, atol=1e-9)
