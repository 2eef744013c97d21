"""Our camera against FlightGear's pictures of the same poses: paint in pixels, light by the hour.

FlightGear paints its runways with textures of its own, so its paint is surveyed first: pictures
from 40 m straight above are put together to a map in the runway frame. From that map our camera
model tells how much of each pixel of a pose is paint, by its own geometry and on level ground; how
far from there FlightGear has it, is measured as in :mod:`opinions`. FlightGear's part is the
position and attitude of the eye, its projection and its terrain.

An error of the eye's position that is the same above and at the pose cancels; there FlightGear's
own reading of the eye is within 5 mm of what is asked for, or no picture is taken.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from mitsuba_scene import check_values
from numpy.typing import NDArray
from opinions import Floats, LightCurves, LightHour, SceneOpinion, find_edges

from taxinet_ros.core.camera.camera import Camera, pose, project
from taxinet_ros.core.camera.light import GAMMA, LUMINANCE, linear_exposure, scenario_light
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.place.markings import markings
from taxinet_ros.core.renderer import find_renderer
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.types import AircraftState
from taxinet_ros.extras.flightgear.camera import FlightGearCamera

SHOWS = frozenset({
    'cross_track_m', 'distance_m', 'heading_rad', 'time_of_day_s', 'date', 'aircraft', 'camera',
    'place', 'clouds', 'shadows',
})
"""Attributes of a scenario that the comparison has; the others have to have their defaults."""
FARTHEST_M = 60.0
"""Farther than this the terrain's bends are pixels [m]."""
HOURS = tuple(np.arange(8.5, 19.0, 1.0).tolist())

_ROLLED = json.dumps({
    'name': 'rolled', 'offset_m': [1.0, -1.5, 1.2], 'roll_deg': 9.0, 'pitch_deg': 22.0,
    'yaw_deg': -20.0, 'size_px': [320, 240], 'field_of_view_deg': 60.0,
})
_KEFLAVIK: Mapping[str, object] = {'place': 'bikf_10', 'time_of_day_h': 13.5}
SCENES: tuple[Mapping[str, object], ...] = (
    {'cross_track_m': 1, 'heading_deg': 5, 'distance_m': 285},
    {'cross_track_m': 9, 'heading_deg': 25, 'distance_m': 585},
    {'camera': _ROLLED, 'cross_track_m': -3, 'heading_deg': 12, 'distance_m': 300},
    {'cross_track_m': -12, 'heading_deg': -25, 'distance_m': 1500},
    {'camera': 'tail', 'cross_track_m': 5, 'heading_deg': -8, 'distance_m': 590},
    {'cross_track_m': -4, 'heading_deg': -12, 'distance_m': 20},
    {'camera': 'strut', 'aircraft': 'c172p', 'heading_deg': 10, 'distance_m': 295},
)
"""Default scenes, in human keys and units, where FlightGear's base package has terrain."""
LIGHT_SCENE: Mapping[str, object] = {
    'distance_m': 300, 'cross_track_m': 6, 'camera': json.dumps({
        'name': 'light', 'offset_m': [3.0, 0.0, 1.5], 'pitch_deg': 10.0, 'size_px': [120, 90],
        'field_of_view_deg': 80.0,
    }),
}
"""Scene of the curves of light: paint, pavement, open ground and sky in a small picture."""

_HIGH_M, _STEP_M = 40.0, 0.1
"""Height of the survey's eye above the aircraft's reference point, and spacing of its map."""
_ACROSS_PX, _AHEAD_PX = 400, 240
_TILE_M = 18.0, 34.0
"""Part of a picture from above that is kept, along and across the runway: less than it shows."""
_MARGIN_M = 2.0
_SUBPIXELS = 4, 8
"""Points across and down a pixel where the map is read."""
_LOCAL_M = 0.5
"""Paint is compared with the brightest within this; the textures have two kinds."""
_LEAST_CODES = 40.0
"""Least difference of paint and pavement in a survey, in display codes."""
_PURE, _PURE_TEXTURE = 0.99, 0.75
"""Least share of paint in a pixel of it; FlightGear's textures are mottled."""
_LEAST_SKY = math.radians(6.0)
_GROUND_M = 10.0
"""Open ground begins this far from the runway's edge, beyond shoulders [m]."""


def scenes(settings: Mapping[str, object]) -> list[Scenario]:
    """The default scenes with some values set, each once.

    Raises:
        UsageError: a value that no scenario may have, or that this comparison does not show.
    """
    found = list(dict.fromkeys(
        scenario_from_human({**_KEFLAVIK, **one, **settings}) for one in SCENES
    ))
    for scenario in found:
        _check(scenario)
    return found


def light_scenes(settings: Mapping[str, object]) -> list[Scenario]:
    """The scenes of a day's light, without the aircraft's shadow.

    Raises:
        UsageError: as for :func:`scenes`.
    """
    found = [
        scenario_from_human({
            **_KEFLAVIK, **LIGHT_SCENE, **settings, 'time_of_day_h': hour,
        }) for hour in HOURS
    ]
    for scenario in found:
        _check(scenario)
    return found


def _check(scenario: Scenario) -> None:
    check_values('flightgear', SHOWS, scenario)
    chosen = find_renderer('flightgear')
    assert chosen is not None
    chosen.check(scenario)


def check_running(scenario: Scenario) -> None:
    """Check that FlightGear is there, and has the scene's runway.

    Raises:
        UsageError: it cannot show the scene.
        InfraError: it does not answer, or is another than ``taxinet flightgear start`` starts.
    """
    FlightGearCamera(scenario).close()


def compare_scene(scenario: Scenario, *, shown: bool = False) -> SceneOpinion:
    """Photograph and measure one scene.

    Args:
        scenario: the scene.
        shown: whether FlightGear's picture is wanted.

    Raises:
        UsageError: FlightGear cannot show it.
        InfraError: FlightGear failed.
    """
    state = Aircraft(scenario).state
    camera = FlightGearCamera(scenario)
    theirs = camera.render(state, 0)
    sun = camera.sun_elevation_deg
    ours = _Ground(scenario.camera_model, state)
    paint, known = ours.shares(_survey(scenario, ours.seen()))
    found = find_edges(paint, theirs.min(axis=2).astype(np.float64), ~known, ours.distance_m)
    return SceneOpinion(
        scenario=scenario, ours=Camera(scenario).render(state, 0),
        theirs=theirs if shown else None,
        # Found are their shifts from ours.
        markings=replace(found, shift_px=-found.shift_px), shadow=None,
        sun_apart_deg=abs(sun - math.degrees(scenario_light(scenario).sun_elevation_rad)),
    )


def compare_light(day: Iterable[Scenario]) -> LightCurves:
    """Compare the light of scenes that differ in their hour; those by night are left out.

    Raises:
        UsageError: FlightGear cannot show a scene.
        InfraError: FlightGear failed.
    """
    found: list[LightHour] = []
    regions: tuple[_Regions, _Regions] | None = None
    for scenario in day:
        light = scenario_light(scenario)
        if light.sun_elevation_rad <= 0:
            continue
        state, camera = Aircraft(scenario).state, FlightGearCamera(scenario)
        ours = Camera(replace(scenario, shadows=False)).render(state, 0)
        theirs = camera.render(state, 0)
        # The same at each hour.
        regions = regions or _regions(scenario, state)
        codes = np.minimum(ours.astype(np.float64), 254.0)
        found.append(LightHour(
            hour=scenario.time_of_day_s / 3600, sun_elevation_deg=camera.sun_elevation_deg,
            ours=_medians(linear_exposure(codes) / light.exposure @ LUMINANCE, regions[0]),
            # FlightGear has no exposure: its codes are what a screen shows.
            theirs=_medians((theirs / 255.0) ** GAMMA @ LUMINANCE, regions[1]),
            shade_ours=None, shade_theirs=None,
        ))
    return LightCurves(hours=tuple(found))


_Regions = dict[str, NDArray[np.bool_]]


def _medians(luminance: Floats, regions: _Regions) -> dict[str, float | None]:
    return {
        name: float(np.median(luminance[where])) if where.any() else None
        for name, where in regions.items()
    }


def _regions(scenario: Scenario, state: AircraftState) -> tuple[_Regions, _Regions]:
    """Pixels of each surface in our picture and in theirs: paint is elsewhere in each."""
    import shapely

    ground = _Ground(scenario.camera_model, state)
    painted = shapely.union_all([
        shapely.Polygon(one.polygon)
        for one in markings(scenario.runway, crossing=scenario.crossing)
    ])
    shapely.prepare(painted)
    x, y = ground.at_m
    runway, half = scenario.runway, scenario.runway.half_width_m
    with np.errstate(invalid='ignore'):
        on = ground.mean((np.abs(y) < half - 1) & (x > 0) & (x < runway.length_m)) > _PURE
        beside = ground.mean(np.abs(y) > half + _GROUND_M) > _PURE
    ours = ground.mean(shapely.contains_xy(painted, x, y))
    theirs, known = ground.shares(_survey(scenario, ground.seen()))
    near = ground.distance_m < FARTHEST_M

    def of(paint: Floats, pure: float) -> _Regions:
        return {
            'pavement': on & near & known & (paint < 1 - pure),
            'paint': near & known & (paint > pure), 'ground': beside, 'sky': ground.sky,
        }

    return of(ours, _PURE), of(theirs, _PURE_TEXTURE)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Survey:
    """FlightGear's paint from above: share of paint by place, (along, across), NaN where unseen."""

    share: NDArray[np.float32]
    start_m: tuple[float, float]

    def at(self, x: Floats, y: Floats) -> Floats:
        """Shares of paint at places; NaN where they are not in it."""
        rows, columns = ((value - start) / _STEP_M for value, start in zip(
            (x, y), self.start_m, strict=True,
        ))
        # In rows of pictures, as OpenCV's coordinates end at 32,767.
        found = [
            cv2.remap(
                self.share, across.astype(np.float32), along.astype(np.float32), cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT, borderValue=math.nan,
            ) for across, along in zip(np.atleast_2d(columns), np.atleast_2d(rows), strict=True)
        ]
        return np.asarray(found, np.float64).reshape(x.shape)


class _Ground:
    """Where each pixel's points are on level ground, by our camera model."""

    def __init__(self, model: CameraModel, state: AircraftState) -> None:
        _, to_optical, eye = pose(state, model)
        across, down = _SUBPIXELS
        rows, columns = (
            (np.arange(side * parts) + 0.5) / parts - 0.5
            for side, parts in ((model.height_px, down), (model.width_px, across))
        )
        v, u = np.meshgrid(rows, columns, indexing='ij')
        x, y = model.straight_rays(u, v)
        rays = np.stack([x, y, np.ones_like(x)], axis=2) @ to_optical
        rays /= np.linalg.norm(rays, axis=2, keepdims=True)
        self._blocks = model.height_px, down, model.width_px, across
        fall = np.where(rays[..., 2] < -1e-4, -rays[..., 2], np.nan)
        reach = eye[2] / fall
        self.at_m: tuple[Floats, Floats] = (
            eye[0] + reach * rays[..., 0], eye[1] + reach * rays[..., 1]
        )
        """x and y of each point in ``map``; NaN in the sky."""
        self.distance_m: Floats = np.nan_to_num(self.mean(reach), nan=math.inf)
        """Of each pixel from the camera; infinite in the sky."""
        self.sky: NDArray[np.bool_] = self.mean(rays[..., 2] > math.sin(_LEAST_SKY)) > _PURE

    def mean(self, points: NDArray[Any]) -> Floats:
        """Mean of the points of each pixel, (height, width)."""
        found: Floats = points.reshape(self._blocks).mean(axis=(1, 3))
        return found

    def seen(self) -> tuple[Floats, Floats]:
        """Places that the survey has to have: least and greatest x and y."""
        near = self.mean(np.isnan(self.at_m[0])) == 0
        near &= self.distance_m < FARTHEST_M
        whole = np.repeat(np.repeat(near, self._blocks[1], 0), self._blocks[3], 1)
        x, y = (side[whole] for side in self.at_m)
        return np.array([x.min(), y.min()]), np.array([x.max(), y.max()])

    def shares(self, survey: _Survey) -> tuple[Floats, NDArray[np.bool_]]:
        """Share of paint in each pixel, and where it is known, (height, width) each."""
        share = self.mean(survey.at(*self.at_m))
        known = ~np.isnan(share) & (self.distance_m < FARTHEST_M)
        return np.nan_to_num(share), known


def _survey(scenario: Scenario, seen: tuple[Floats, Floats]) -> _Survey:
    """Photograph the ground between two corners from above, and find the paint in it.

    Raises:
        UsageError: FlightGear cannot show the scene.
        InfraError: FlightGear failed.
    """
    half = scenario.runway.half_width_m + _MARGIN_M
    (x0, y0), (x1, y1) = (
        (corner[0] + side * _MARGIN_M, np.clip(corner[1] + side * _MARGIN_M, -half, half))
        for side, corner in zip((-1, 1), seen, strict=True)
    )
    shape = math.ceil((x1 - x0) / _STEP_M) + 1, math.ceil((y1 - y0) / _STEP_M) + 1
    bright = np.full(shape, np.nan, np.float32)
    down = replace(
        scenario.camera_model, offset_m=(0.0, 0.0, _HIGH_M), roll_rad=0.0, pitch_rad=math.pi / 2,
        yaw_rad=0.0, width_px=_ACROSS_PX, height_px=_AHEAD_PX,
        focal_px=(_HIGH_M / _STEP_M,) * 2, centre_px=((_ACROSS_PX - 1) / 2, (_AHEAD_PX - 1) / 2),
        distortion=(0.0,) * 5, exposure_ev=0.0, noise_codes=0.0,
    )
    camera = FlightGearCamera(scenario, model=down)
    level = replace(Aircraft(scenario).state, roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0)
    for rows in _tiles(shape[0], _TILE_M[0]):
        for columns in _tiles(shape[1], _TILE_M[1]):
            x, y = (
                start + _STEP_M * np.arange(part.start, part.stop)
                for start, part in ((x0, rows), (y0, columns))
            )
            state = replace(level, x_m=float(x.mean()), y_m=float(y.mean()))
            light = camera.render(state, 0).min(axis=2).astype(np.float32)
            places = np.stack(
                [*np.meshgrid(x, y, indexing='ij'), np.zeros((len(x), len(y)))], axis=2
            )
            pixels, _ = project(state, places.reshape(-1, 3), down)
            u, v = pixels.astype(np.float32).reshape(len(x), len(y), 2).transpose(2, 0, 1)
            bright[rows, columns] = cv2.remap(light, u, v, cv2.INTER_LINEAR)
    return _Survey(share=_painted(bright), start_m=(float(x0), float(y0)))


def _tiles(count: int, side_m: float) -> Iterator[slice]:
    """Equal parts of a side of the map, none longer than the picture shows."""
    parts = math.ceil(count * _STEP_M / side_m)
    for number in range(parts):
        yield slice(number * count // parts, (number + 1) * count // parts)


def _painted(bright: NDArray[np.float32]) -> NDArray[np.float32]:
    """Share of paint by brightness, relative to the brightest paint nearby."""
    codes = np.rint(bright).astype(np.uint8)
    level, _ = cv2.threshold(codes, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    light, dark = codes > level, codes <= level
    if not light.any() or not dark.any():
        return np.zeros_like(bright)
    pavement = float(np.median(bright[dark]))
    if float(np.median(bright[light])) - pavement < _LEAST_CODES:
        return np.zeros_like(bright)
    side = 2 * round(_LOCAL_M / _STEP_M) + 1
    brightest = cv2.dilate(cv2.medianBlur(codes, 3), np.ones((side, side), np.uint8))
    share = (bright - pavement) / (np.maximum(brightest, level + 1.0) - pavement)
    return np.clip(share, 0.0, 1.0).astype(np.float32)

