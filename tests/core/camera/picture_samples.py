"""Cameras, poses and a projection of its own for the tests of what the picture shows."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState

Picture = NDArray[np.float64]
Numbers = NDArray[np.float64]

OPEN = slice(60, None)
"""Columns right of the aircraft's own parts."""

# The published calibration, written out: 1920x1080 screen, 1,125 px, cut at (100, 330) to 1720x730.
FOCAL = np.array([1125 * 360 / 1720, 1125 * 200 / 730])
CENTRE = np.array([(960 - 100) * 360 / 1720 - 0.5, (540 - 330) * 200 / 730 - 0.5])
MOUNT_M = np.array([0.085, -2.17, 0.50])
MOUNT = Rotation.from_euler('xyz', [0.0, 10.42, -4.15], degrees=True)


def at(
    x: float = 1000.0, y: float = 0.0, heading_deg: float = 0.0, pitch_deg: float = 0.1064,
    roll_deg: float = 0.0,
) -> AircraftState:
    return AircraftState(
        x_m=x, y_m=y, z_m=1.55, roll_rad=math.radians(roll_deg), pitch_rad=math.radians(pitch_deg),
        yaw_rad=math.radians(heading_deg), speed_mps=5.0, yaw_rate_radps=0.0,
    )


@lru_cache(maxsize=8)
def camera(hour: float = 12.0, clouds: str = 'clear', shadows: bool = False) -> Camera:
    return Camera(Scenario(time_of_day_s=hour * 3600, clouds=clouds, shadows=shadows))


def shot(
    state: AircraftState, hour: float = 12.0, clouds: str = 'clear', shadows: bool = False
) -> Picture:
    """A picture (200, 360, 3) as numbers that can be subtracted."""
    return camera(hour, clouds, shadows).render(state, 0).astype(np.float64)


def luminance(picture: Picture) -> Numbers:
    return np.asarray(picture @ np.array([0.2126, 0.7152, 0.0722]))


def placed(state: AircraftState) -> tuple[Rotation, Numbers]:
    """The body's attitude and place in map."""
    attitude = Rotation.from_euler('xyz', [state.roll_rad, state.pitch_rad, state.yaw_rad])
    return attitude, np.array([state.x_m, state.y_m, state.z_m])


def pixels(state: AircraftState, points: Numbers) -> Numbers:
    """Where points (N, 3) in map before the camera lie in the picture: (N, 2), u and v."""
    attitude, place = placed(state)
    x, y, z = (attitude * MOUNT).inv().apply(points - place - attitude.apply(MOUNT_M)).T
    assert (x > 0).all()
    return CENTRE + FOCAL * np.stack([-y / x, -z / x], axis=1)


def ground_points(state: AircraftState) -> Numbers:
    """The point (200, 360, 3) on the ground that every pixel's middle sees; NaN in the sky."""
    u, v = np.meshgrid(np.arange(360.0), np.arange(200.0))
    rays = np.stack([np.ones_like(u), (CENTRE[0] - u) / FOCAL[0], (CENTRE[1] - v) / FOCAL[1]], -1)
    attitude, place = placed(state)
    rays = (attitude * MOUNT).apply(rays.reshape(-1, 3)).reshape(rays.shape)
    origin = place + attitude.apply(MOUNT_M)
    reach = np.where(rays[..., 2:] < -1e-6, -origin[2] / rays[..., 2:], np.nan)
    return np.asarray(origin + reach * rays)
