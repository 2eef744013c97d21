"""Random cameras: valid on their aircraft, different, and all of them see through the eye."""

from __future__ import annotations

import numpy as np
import pytest

from taxinet_ros.core.perception.eye import VIEWS, _places
from taxinet_ros.core.rig.random_camera import random_camera
from taxinet_ros.core.scenario import Scenario


@pytest.mark.nightly
@pytest.mark.parametrize('aircraft', ['caravan', 'c172p'])
def test_given_random_cameras_when_mounted_then_they_see_most_of_the_view(aircraft: str) -> None:
    rng = np.random.default_rng(3)
    cameras = [random_camera(rng, aircraft) for _ in range(25)]
    again = np.random.default_rng(3)
    assert [random_camera(again, aircraft).text for _ in range(25)] == [
        camera.text for camera in cameras
    ]
    assert len({camera.digest for camera in cameras}) == 25
    assert 3 <= sum(camera.distorts for camera in cameras) <= 18
    shares = []
    for camera in cameras:
        scene = Scenario(aircraft=aircraft, camera=camera.text)  # refuses one below the ground
        u, v = np.moveaxis(_places(VIEWS['ahead'], scene.rig), -1, 0)
        within = (u >= 0) & (v >= 0)
        within &= (u <= 32 * (camera.width_px - 1)) & (v <= 32 * (camera.height_px - 1))
        shares.append(within.mean())
    assert min(shares) > 0.45
    assert np.mean(shares) > 0.75
