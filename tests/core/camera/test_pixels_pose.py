"""Where a camera is and looks, compared with what NumPy makes of it."""

from __future__ import annotations

import numpy as np
import pytest

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.rig.camera_model import rotation
from taxinet_ros.core.rig.catalogue import find_camera


@pytest.mark.parametrize('name', ['wing', 'nose', 'strut', 'tail'])
def test_given_any_pose_when_a_camera_is_placed_then_it_is_where_numpy_has_it_to_the_bit(
    name: str
) -> None:
    camera, rng = find_camera(name), np.random.default_rng(11)
    for scale in (0.0, 1e-6, 0.02, 1.0, 4.0) * 100:
        place, angles = rng.normal(0, 900, 3), rng.normal(0, scale, 3)
        body, to_optical, eye = pixels.pose(
            (*place, *angles), camera.body_to_optical, camera.offset_m
        )
        turn = rotation(*angles)
        np.testing.assert_array_equal(body, turn)
        np.testing.assert_array_equal(to_optical, camera.body_to_optical @ turn.T)
        np.testing.assert_array_equal(eye, place + turn @ np.array(camera.offset_m))


def test_given_what_is_no_rotation_when_a_camera_is_placed_then_it_says_so() -> None:
    with pytest.raises(ValueError, match=r'a rotation is \(3, 3\)'):
        pixels.pose((0.0,) * 6, np.eye(2), (0.0, 0.0, 0.0))
