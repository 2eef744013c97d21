"""The wing camera: mounting, projection and rendering.

Calibrated on the published X-Plane images: a 1920x1080 screen with a focal length of 1,125 px and
the principal point at its centre, cropped to the 1720x960 region at (100, 100), without its top 230
rows, resized (changing the aspect ratio) to 360x200. Screen coordinates are continuous and pixel
centres are integers, as in ROS, so image column u is at 100 + (u + 0.5) * 1720/360 on the screen;
hence cx = (960 - 100) * 360/1720 - 0.5 = 179.5 and cy = (540 - 330) * 200/730 - 0.5 = 57.03.

A frame is rendered by inverse mapping: each pixel's ray is intersected with the ground, whose
colour comes from a ripmap at the level of the pixel's footprint. Shade, light, haze, glare, sky,
rain, the aircraft's own parts and faults of lens and sensor follow. Equal state, stamp and scenario
give equal bytes in every process.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.camera.airframe import (
    LOWEST_SUN_RAD,
    AirframeView,
    Mask,
    OwnShadow,
    hidden_columns,
)
from taxinet_ros.core.camera.atmosphere import Atmosphere, RainSheet
from taxinet_ros.core.camera.ground.atlas import grain_atlas, ground_atlas, ground_layout
from taxinet_ros.core.camera.ground.view import GroundView
from taxinet_ros.core.camera.lens_faults import LensFaults
from taxinet_ros.core.camera.light import CloudShade, ground_table, scenario_light
from taxinet_ros.core.camera.objects import ObjectsView
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState, quaternion, quaternion_product

Mark = Callable[[str], None]
"""Callback with the name of every finished rendering stage, for benchmarks."""

IMAGE_HEIGHT, IMAGE_WIDTH = 200, 360

STAGES = (
    'ground', 'marks', 'cloud shade', 'own shadow', 'shadows of others', 'atmosphere', 'others',
    'rain', 'airframe', 'lens',
)
"""Rendering stages in order; a scene has those that it needs."""

_SCREEN_FOCAL_PX = 1125.0
_COLUMN_PX, _ROW_PX = 1720 / IMAGE_WIDTH, 730 / IMAGE_HEIGHT

_OPTICAL_TO_LINK = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def intrinsics() -> NDArray[np.float64]:
    """Camera matrix K (3, 3); pixel centres are integers; no distortion."""
    return np.array([
        [_SCREEN_FOCAL_PX / _COLUMN_PX, 0.0, (960 - 100) / _COLUMN_PX - 0.5],
        [0.0, _SCREEN_FOCAL_PX / _ROW_PX, (540 - 100 - 230) / _ROW_PX - 0.5],
        [0.0, 0.0, 1.0],
    ])  # fmt: skip


def rotation(roll_rad: float, pitch_rad: float, yaw_rad: float) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) of REP-103 fixed-axis angles, from the rotated to the base frame."""
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Mount:
    """Position and attitude of a camera on the aircraft.

    Attributes:
        offset_m: camera in the body frame (x forward, y left, z up) from the reference point [m].
        roll_rad, pitch_rad, yaw_rad: attitude (REP-103: pitch positive nose down, yaw positive
            left) [rad].
    """

    offset_m: tuple[float, float, float]
    roll_rad: float
    pitch_rad: float
    yaw_rad: float

    @property
    def attitude(self) -> tuple[float, float, float, float]:
        """Quaternion (x, y, z, w) of ``camera_optical`` (z forward, x right) in ``base_link``."""
        turned = quaternion(self.roll_rad, self.pitch_rad, self.yaw_rad)
        return quaternion_product(turned, (-0.5, 0.5, -0.5, 0.5))

    @cached_property
    def body_to_optical(self) -> NDArray[np.float64]:
        """Rotation matrix (3, 3) from the body frame to the optical one."""
        to_body = rotation(self.roll_rad, self.pitch_rad, self.yaw_rad) @ _OPTICAL_TO_LINK
        return np.asarray(to_body.T)


WING_MOUNT = Mount(
    offset_m=(0.085, -2.17, 0.50), roll_rad=0.0, pitch_rad=math.radians(10.42),
    yaw_rad=math.radians(-4.15),
)
"""The settled Caravan adds 0.11 degrees nose down: 10.53 degrees in all, as calibrated."""


def pose(
    state: AircraftState, mount: Mount = WING_MOUNT
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Rotation body to ``map`` (3, 3), rotation ``map`` to optical (3, 3), camera in ``map`` (3,).

    Raises:
        ValueError: a pose coordinate is not finite, or the camera would be at or below the ground.
    """
    numbers = (state.x_m, state.y_m, state.z_m, state.roll_rad, state.pitch_rad, state.yaw_rad)
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f'camera: the pose is not finite: {state}')
    body = rotation(state.roll_rad, state.pitch_rad, state.yaw_rad)
    camera = np.array(numbers[:3]) + body @ np.array(mount.offset_m)
    if camera[2] < 0.05:
        raise ValueError(
            f'camera: {camera[2]:.3f} m above ground, the aircraft is not on its wheels'
        )
    return body, mount.body_to_optical @ body.T, camera


def project(
    state: AircraftState, points_map: NDArray[np.floating], mount: Mount = WING_MOUNT
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Project points in ``map``, (N, 3) [m], into the image.

    Returns:
        Pixels (u, v), (N, 2), and depths along the optical axis (N,) [m]; pixels are valid only for
        positive depth.
    """
    _, to_optical, camera = pose(state, mount)
    points = (np.asarray(points_map, np.float64) - camera) @ to_optical.T
    with np.errstate(divide='ignore', invalid='ignore'):
        pixels = (points @ intrinsics().T)[:, :2] / points[:, 2:]
    return pixels, points[:, 2]


def shared_curve(table: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Split the light table of three channels into a common curve and a gain per channel.

    The display code of every channel is the same function of albedo times irradiance, and albedo is
    a power of the ground code; so the tables differ only in the scale of their argument.

    Args:
        table: display code by ground code and channel, (1, 256, 3).

    Returns:
        Table of the brightest channel (256,), and factors on red, green and blue codes, 0..1.
    """
    codes = table[0].astype(np.float64)
    brightest = int(codes.sum(axis=0).argmax())
    seen = np.arange(60, 200)
    gain = [
        np.interp(column[seen], codes[:, brightest], np.arange(256)).sum() / seen.sum()
        for column in codes.T
    ]
    return table[0, :, brightest].copy(), np.minimum(gain, 1.0)


def prepare() -> None:
    """Build the data shared by all cameras of a process ahead of the first camera."""
    ground_atlas(default_runway())
    grain_atlas()


class Camera:
    """The wing camera in one scenario's light and weather. Not thread-safe."""

    def __init__(
        self, scenario: Scenario, ground: NDArray[np.uint8] | None = None, *,
        mount: Mount = WING_MOUNT, runway: Runway | None = None,
    ) -> None:
        """Precompute everything fixed by the scenario; textures are made once per process.

        Args:
            scenario: scenario with light and weather.
            ground: atlas of another ground style
                (:mod:`taxinet_ros.core.camera.ground.atlas`); it then also determines whether there
                is a crossing.
            mount: mounting; the aircraft parts in the image, and the ground they hide, are always
                those of the wing mount.
            runway: replaces the scenario's runway (sun, surface and paint).
        """
        self._mount = mount
        runway = runway or scenario.runway
        track = None if scenario.line.is_runway else scenario.line
        self._light = scenario_light(scenario, runway)
        self._intrinsics = intrinsics()
        self._to_ray = np.linalg.inv(self._intrinsics)
        self._curve, gain = shared_curve(ground_table(self._light))
        if ground is None:
            ground = ground_atlas(runway, track, crossing=scenario.crossing)
        self._ground = GroundView(
            ground, grain_atlas(), gain, hidden_columns(), IMAGE_WIDTH,
            ground_layout(runway, track),
        )
        self._clouds = CloudShade(self._light, IMAGE_HEIGHT, IMAGE_WIDTH)
        self._atmosphere = Atmosphere(self._light, IMAGE_HEIGHT, IMAGE_WIDTH)
        self._airframe = AirframeView(self._light)
        self._rain = (
            RainSheet(self._light, IMAGE_HEIGHT, IMAGE_WIDTH) if self._light.rain > 0 else None
        )
        sunny = float(self._light.direct.max()) > 0.01 * float(self._light.total.max())
        casts_any = sunny and self._light.sun_elevation_rad > LOWEST_SUN_RAD
        casts = scenario.shadows and casts_any
        self._shadow = (
            OwnShadow(
                self._light.sun, self._light.sun_width_rad, self._intrinsics, IMAGE_HEIGHT,
                IMAGE_WIDTH,
            )
            if casts
            else None
        )
        size = IMAGE_HEIGHT, IMAGE_WIDTH
        self._faults = LensFaults(scenario, self._light, self._intrinsics, size)
        self._objects = (
            ObjectsView(
                scenario.others, self._light, self._clouds, self._atmosphere, gain,
                self._intrinsics, size, casts=casts_any,
            ) if scenario.traffic else None
        )

    def render(
        self, state: AircraftState, stamp_ns: int, mark: Mark = lambda stage: None
    ) -> NDArray[np.uint8]:
        """Render the scene from ``state``.

        Args:
            state: the aircraft's true state.
            stamp_ns: simulated time since the start of the run [ns]; seeds the rain pattern.
            mark: called with the name of each of :data:`STAGES` when it is finished.

        Returns:
            (200, 360, 3) uint8 RGB, C-contiguous, owned by the caller.

        Raises:
            ValueError: the pose is not finite or the camera would be below the ground.
        """
        body, to_optical, camera = pose(state, self._mount)
        rays = to_optical.T @ self._to_ray
        colour = self._ground.render(rays, camera)
        mark('ground')
        if self._objects is not None:
            self._objects.paint_marks(colour, to_optical, camera)
            mark('marks')
        if self._clouds.casts:
            self._clouds.shade(colour, rays, camera)
            mark('cloud shade')
        shadow = None
        if self._shadow is not None:
            place = np.array([state.x_m, state.y_m, state.z_m])
            shadow = self._shadow.mask(body, place, to_optical, camera)
            self._shade(colour, shadow, state)
            mark('own shadow')
        if self._objects is not None:
            shaded = np.zeros((IMAGE_HEIGHT, IMAGE_WIDTH), np.uint8)
            if shadow is not None:
                shaded[shadow[:2]] = shadow[2]
            self._objects.shade(colour, to_optical, camera, stamp_ns, shaded)
            mark('shadows of others')
        picture = np.empty((IMAGE_HEIGHT, IMAGE_WIDTH, 3), np.uint8)
        self._atmosphere.develop(colour, self._curve, rays, float(camera[2]), picture)
        mark('atmosphere')
        if self._objects is not None:
            self._objects.draw_solids(picture, to_optical, camera, stamp_ns)
            mark('others')
        if self._rain is not None:
            cv2.add(picture, self._rain.at(stamp_ns), dst=picture)
            mark('rain')
        self._airframe.lay_over(picture, state.yaw_rad)
        mark('airframe')
        if self._faults.any:
            picture = self._faults.apply(picture, to_optical, stamp_ns)
            mark('lens')
        return picture

    def _shade(self, colour: NDArray[np.uint8], shadow: Mask | None, state: AircraftState) -> None:
        """Darken the ground in the aircraft's shadow."""
        if shadow is None:
            return
        rows, columns, mask = shadow
        depth = 1 - self._light.shade_factor(self._clouds.sun_share(state.x_m, state.y_m))
        pixels.tint_masked(colour[rows, columns], mask, depth)
