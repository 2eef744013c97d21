"""A scenario's camera: projection and rendering.

The usual one, the paper's wing camera, was calibrated on the published X-Plane pictures: a
1920x1080 screen with a focal length of 1,125 px and the principal point in its middle, cut to the
1720x960 region at (100, 100), without its top 230 rows, resized (not keeping the aspect) to
360x200. Screen and picture edges are continuous coordinates, so picture pixel u, whose centre is
the whole number u as ROS has it, lies at 100 + (u + 0.5) * 1720/360 on the screen; hence
fx = 1125 * 360/1720, fy = 1125 * 200/730, cx = (960 - 100) * 360/1720 - 0.5 = 179.5 and
cy = (540 - 330) * 200/730 - 0.5 = 57.03.

A frame is rendered by inverse mapping: each pixel's ray is intersected with the ground, whose
colour comes from a ripmap at the level of the pixel's footprint. Shade, light, haze, glare, sky,
rain and the aircraft's own parts follow; distortion then resamples this pinhole image, the
sensor's noise is added, and faults of lens and sensor come last. Equal state, stamp and scenario
give equal bytes in every process.
"""

from __future__ import annotations

import hashlib
import math
import struct
import threading
from collections.abc import Callable
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
    covering_doubts,
    drawing,
)
from taxinet_ros.core.camera.atmosphere import SPARSE_PX, Atmosphere, RainSheet, scramble
from taxinet_ros.core.camera.ground.atlas import grain_atlas, ground_atlas, ground_layout
from taxinet_ros.core.camera.ground.view import GroundView
from taxinet_ros.core.camera.lens_faults import LensFaults
from taxinet_ros.core.camera.light import CloudShade, ground_table, scenario_light
from taxinet_ros.core.camera.objects import ObjectsView, Placed
from taxinet_ros.core.datarefs import refuse_datarefs
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.rig.catalogue import WING
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic import NOTHING_HELD, Holds
from taxinet_ros.core.types import AircraftState

Mark = Callable[[str], None]
"""Callback with the name of every finished rendering stage, for benchmarks."""

STAGES = (
    'ground', 'marks', 'cloud shade', 'own shadow', 'shadows of others', 'atmosphere', 'others',
    'rain', 'airframe', 'distortion and noise', 'lens',
)
"""Rendering stages in order; a scene has those that it needs."""

IMAGE_HEIGHT, IMAGE_WIDTH, _ = WING.shape
"""Image size of the wing camera [px]."""

Vectors = NDArray[np.float64]


def intrinsics() -> Vectors:
    """Camera matrix K (3, 3) of the wing camera; pixel centres are whole numbers."""
    return WING.intrinsics.copy()


def pose(state: AircraftState, camera: CameraModel = WING) -> tuple[Vectors, Vectors, Vectors]:
    """Rotation body to ``map`` (3, 3), rotation ``map`` to optical (3, 3), camera in ``map`` (3,).

    Raises:
        ValueError: a pose coordinate is not finite, or the camera would be at or below the ground.
    """
    numbers = (state.x_m, state.y_m, state.z_m, state.roll_rad, state.pitch_rad, state.yaw_rad)
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f'camera: the pose is not finite: {state}')
    body, to_optical, place = pixels.pose(numbers, camera.body_to_optical, camera.offset_m)
    if place[2] < 0.05:
        raise ValueError(
            f'camera: {place[2]:.3f} m above ground, the aircraft is not on its wheels'
        )
    return body, to_optical, place


def project(
    state: AircraftState, points_map: NDArray[np.floating], camera: CameraModel = WING
) -> tuple[Vectors, Vectors]:
    """Project points in ``map`` into the image.

    Takes (N, 3) points [m]; gives (N, 2) pixels (u, v) and (N,) depths along the optical axis [m].

    Pixels are valid only for positive depth.
    """
    _, to_optical, place = pose(state, camera)
    points = (np.asarray(points_map, np.float64) - place) @ to_optical.T
    return camera.pixels(points), points[:, 2]


def shared_curve(table: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Split the light table of three channels into one common curve and a gain before it.

    Every channel's display code is the same function of albedo times irradiance, and albedo is a
    power of the ground's code; so the channels' tables differ by the scale of their argument only.

    Args:
        table: display code by ground code and channel, (1, 256, 3).

    Returns:
        The brightest channel's table (256,), and factors on red, green and blue codes, 0..1.
    """
    codes = table[0].astype(np.float64)
    brightest = int(codes.sum(axis=0).argmax())
    seen = np.arange(60, 200)
    gain = [
        np.interp(column[seen], codes[:, brightest], np.arange(256)).sum() / seen.sum()
        for column in codes.T
    ]
    return table[0, :, brightest].copy(), np.minimum(gain, 1.0)


def prepare() -> threading.Thread:
    """Build what all cameras of a process share ahead of the first one, in a thread.

    Returns:
        The thread; a camera that is made before its end waits for it.
    """
    def share() -> None:
        scenario = Scenario()
        covering_doubts(scenario.aircraft_model, scenario.camera_model)  # which draws the aircraft
        grain_atlas()
        ground_atlas(default_runway())

    thread = threading.Thread(target=share, daemon=True)
    thread.start()
    return thread


class Camera:
    """The camera in one scenario's light and weather. Not to be shared between threads."""

    def __init__(
        self, scenario: Scenario, ground: NDArray[np.uint8] | None = None, *,
        model: CameraModel | None = None, runway: Runway | None = None,
    ) -> None:
        """Precompute everything fixed by the scenario; textures are made once per process.

        Args:
            scenario: scenario with light and weather.
            ground: atlas of another look of the ground
                (:mod:`taxinet_ros.core.camera.ground.atlas`), which then also decides whether
                there is a crossing.
            model: replaces the scenario's camera.
            runway: replaces the scenario's: its sun, surface and paint.
        """
        refuse_datarefs(scenario.datarefs, 'our camera')
        self.model = model = model or scenario.camera_model
        runway = runway or scenario.runway
        track = None if scenario.line.is_runway else scenario.line
        self._light = scenario_light(scenario, runway, model)
        self._intrinsics, (height, width), *taken_from = model.inner_view
        # The renderer needs a multiple of columns; the excess is cropped.
        width += -width % SPARSE_PX
        self._size = height, width
        self._to_ray = np.linalg.inv(self._intrinsics)
        aircraft = scenario.aircraft_model
        parts = drawing(aircraft, model, self._size)
        self._airframe = AirframeView(self._light, parts) if parts else None
        hidden = parts.hidden if parts else np.zeros(height, np.int32)
        self._curve, gain = shared_curve(ground_table(self._light))
        if ground is None:
            ground = ground_atlas(
                runway, track, scenario.airport, crossing=scenario.crossing
            )
        self._ground = GroundView(
            ground, grain_atlas(), gain, hidden, width, ground_layout(runway, track)
        )
        self._clouds = CloudShade(self._light, height, width)
        # The wing camera is level enough for whole rows, and keeps the bytes of older versions.
        self._atmosphere = Atmosphere(
            self._light, height, width, float(self._intrinsics[0, 0]),
            in_strips=model.view != WING.view,
        )
        self._rain = RainSheet(self._light, height, width) if self._light.rain > 0 else None
        sunny = float(self._light.direct.max()) > 0.01 * float(self._light.total.max())
        casts = sunny and self._light.sun_elevation_rad > LOWEST_SUN_RAD
        shading = [part for part in aircraft.outline if part.shades]
        self._shadow = (
            OwnShadow(
                shading, self._light.sun, self._light.sun_width_rad, self._intrinsics,
                height, width,
            )
            if casts and scenario.shadows and shading
            else None
        )
        self._others = scenario.others
        self._objects = (
            ObjectsView(
                scenario.others, self._light, self._clouds, self._atmosphere, gain,
                self._intrinsics, self._size, casts=casts,
            ) if scenario.others.objects else None
        )
        if model.distorts:
            across, down = (table.astype(np.float32) for table in taken_from)
            # Integer maps give the same bytes on every processor.
            self._maps = cv2.convertMaps(across, down, cv2.CV_16SC2)
            self._straight = np.empty((*self._size, 3), np.uint8)
        self._noise = SensorNoise(scenario, model)
        self._faults = LensFaults(scenario, self._light, model.intrinsics, model.shape[:2])

    def render(
        self, state: AircraftState, stamp_ns: int, mark: Mark = lambda stage: None, *,
        held: Holds = NOTHING_HELD,
    ) -> NDArray[np.uint8]:
        """Render the scene from ``state``.

        Args:
            state: the aircraft's true state.
            stamp_ns: simulated time since the start of the run [ns]; it sets the rain's pattern
                and the noise.
            mark: called with the name of each of :data:`STAGES` when it ends.
            held: of the others that react to the aircraft, of each how long it was held.

        Returns:
            RGB uint8 of the camera's shape, usually (200, 360, 3), C-contiguous, owned by the
            caller.

        Raises:
            ValueError: the pose is not finite or the camera would be below the ground.
            KeyError: others react, and after the start ``held`` does not say how.
        """
        body, to_optical, camera = pose(state, self.model)
        rays = to_optical.T @ self._to_ray
        solids = self._others.solids_at(stamp_ns, held)
        colour = self._ground.render(rays, camera)
        mark('ground')
        if self._objects is not None:
            self._objects.paint_marks(colour, to_optical, camera)
            mark('marks')
        if self._clouds.casts:
            self._clouds.shade(colour, rays, camera)
            mark('cloud shade')
        self._shade(colour, (body, to_optical, camera), state, solids, mark)
        # What is distorted is another picture; a large one is slow to get anew.
        picture = self._straight if self.model.distorts else np.empty((*self._size, 3), np.uint8)
        self._atmosphere.develop(colour, self._curve, rays, float(camera[2]), picture)
        mark('atmosphere')
        if self._objects is not None:
            self._objects.draw_solids(picture, to_optical, camera, solids)
            mark('others')
        if self._rain is not None:
            cv2.add(picture, self._rain.at(stamp_ns), dst=picture)
            mark('rain')
        if self._airframe is not None:
            self._airframe.lay_over(picture, state.yaw_rad)
            mark('airframe')
        if self.model.distorts or picture.shape != self.model.shape or self.model.noise_codes:
            picture = self._taken(picture, stamp_ns)
            mark('distortion and noise')
        if self._faults.any:
            picture = self._faults.apply(picture, to_optical, stamp_ns)
            mark('lens')
        return picture

    def _taken(self, picture: NDArray[np.uint8], stamp_ns: int) -> NDArray[np.uint8]:
        """Apply distortion, crop and noise."""
        if self.model.distorts:
            across, down = self._maps
            picture = np.asarray(cv2.remap(picture, across, down, cv2.INTER_LINEAR), np.uint8)
        picture = np.ascontiguousarray(picture[:, :self.model.width_px])
        if self.model.noise_codes:
            self._noise.add_to(picture, stamp_ns)
        return picture

    def _shade(
        self, colour: NDArray[np.uint8], at: tuple[Vectors, Vectors, Vectors],
        state: AircraftState, solids: Placed, mark: Mark,
    ) -> None:
        """Darken the ground in the shadows of the aircraft and of others, nowhere twice."""
        body, to_optical, camera = at
        shadow: Mask | None = None
        if self._shadow is not None:
            place = state.x_m, state.y_m, state.z_m
            shadow = self._shadow.mask(body, place, to_optical, camera)
            if shadow is not None:
                rows, columns, mask = shadow
                depth = self._clouds.shadow_depth(state.x_m, state.y_m)
                pixels.tint_masked(colour[rows, columns], mask, depth)
            mark('own shadow')
        if self._objects is not None:
            shaded = np.zeros(self._size, np.uint8)
            if shadow is not None:
                shaded[shadow[:2]] = shadow[2]
            self._objects.shade(colour, to_optical, camera, solids, shaded)
            mark('shadows of others')


class SensorNoise:
    """Gaussian noise of a sensor: one field per run, with another offset for each image."""

    _SPARE_PX = 128

    def __init__(self, scenario: Scenario, model: CameraModel) -> None:
        # From start and time only: independent of the number of scenario keys.
        self._seed = struct.pack(
            '<4d', scenario.cross_track_m, scenario.distance_m, scenario.heading_rad,
            scenario.time_of_day_s,
        )
        self._model = model

    @cached_property
    def _field(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """What it adds, and what it takes off: as bytes, which are several times as fast."""
        height, width, channels = self._model.shape
        rng = np.random.default_rng(list(hashlib.sha256(self._seed).digest()))
        size = height + self._SPARE_PX, width + self._SPARE_PX, channels
        noise = rng.standard_normal(size, np.float32) * np.float32(self._model.noise_codes)
        codes = np.rint(noise).astype(np.int16)
        more, less = np.clip(codes, 0, 255), np.clip(-codes, 0, 255)
        return more.astype(np.uint8), less.astype(np.uint8)

    def add_to(self, picture: NDArray[np.uint8], stamp_ns: int) -> None:
        """Add the noise at a stamp to an image (height, width, 3), in place."""
        bits = scramble(stamp_ns)
        top, left = bits % self._SPARE_PX, (bits >> 20) % self._SPARE_PX
        height, width = picture.shape[:2]
        more, less = (one[top:top + height, left:left + width] for one in self._field)
        cv2.add(picture, more, dst=picture)
        cv2.subtract(picture, less, dst=picture)
