"""What ``camera/camera_info`` says is what the camera does."""

from __future__ import annotations

import numpy as np

from taxinet_ros.core.camera import Camera, intrinsics, pose, project
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState
from taxinet_ros.nodes import convert

STATE = AircraftState(
    x_m=500.0, y_m=2.0, z_m=1.55, roll_rad=0.01, pitch_rad=0.02, yaw_rad=-0.1,
    speed_mps=5.0, yaw_rate_radps=0.0,
)


def test_given_the_message_then_size_and_matrices_are_the_cameras_and_it_is_rectified():
    message = convert.camera_info_message()
    assert (message.height, message.width, 3) == Camera(Scenario()).render(STATE, 0).shape
    np.testing.assert_array_equal(np.reshape(message.k, (3, 3)), intrinsics())
    np.testing.assert_array_equal(np.reshape(message.r, (3, 3)), np.eye(3))
    assert list(message.d) == [0.0] * 5
    assert message.distortion_model == 'plumb_bob'
    assert (message.binning_x, message.binning_y) in ((0, 0), (1, 1))


def test_given_points_in_the_optical_frame_when_p_is_applied_then_the_pixels_are_the_pictures():
    projection = np.reshape(convert.camera_info_message().p, (3, 4))
    points = np.array([(x, y, z) for x in (505.0, 530.0) for y in (-12.0, 4.0) for z in (0.0, 1.0)])
    _, to_optical, place = pose(STATE)
    optical = np.column_stack([(points - place) @ to_optical.T, np.ones(len(points))])
    homogenous = optical @ projection.T
    pixels, depth = project(STATE, points)
    np.testing.assert_allclose(homogenous[:, :2] / homogenous[:, 2:], pixels, atol=1e-9)
    np.testing.assert_allclose(homogenous[:, 2], depth, atol=1e-9)
