"""Visible parts of the own aircraft: its shadow, and what the camera sees of it.

The Caravan's parts in the wing camera (cowling, gear leg and wheel at the left) are drawn by hand
after the published images; for a camera moved from there the drawing stays on the aircraft as a
plate in the plane of the nose wheel. Any other combination is rendered from the outline
(:mod:`taxinet_ros.core.camera.solids`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.camera.light import GAMMA, Light, display_code
from taxinet_ros.core.camera.solids import SolidDrawing, solid_drawing
from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.rig.camera_model import BY_HAND, CameraModel
from taxinet_ros.core.rig.catalogue import DEFAULT_AIRCRAFT, WING
from taxinet_ros.core.rig.outline import Part, corners_of

Vectors = NDArray[np.float64]
Mask = tuple[slice, slice, NDArray[np.uint8]]
"""Slices of rows and columns of the image, and the shade there (255: full), soft at the edge."""
LOWEST_SUN_RAD = math.radians(1.0)
"""Below this the shadow is longer than the runway is wide and fainter than the sky's light."""
_NEAREST_M = 0.2
_THROW = 0.5
"""Typical length of the shadow's fall, as a share of its distance from the camera."""
_FARTHEST_PX = 4000.0
_SHIFT = 4
"""OpenCV draws with integer coordinates: sixteenths of a pixel."""
_FARTHEST_FINE, _NEAREST = 1e6, 0.05


class OwnShadow:
    """Shadow of the aircraft in images, for one position of the sun."""

    def __init__(
        self, outline: Sequence[Part], sun: Vectors, sun_width_rad: float, intrinsics: Vectors,
        height: int, width: int,
    ) -> None:
        """Prepare for images of ``height`` by ``width`` pixels.

        Args:
            outline: parts of the aircraft, one at least.
            sun: unit vector towards the sun in ``map``; its z is positive.
            sun_width_rad: angular width of the sun, which sets the width of the penumbra [rad].
            intrinsics: camera matrix (3, 3).
            height: of the pictures [px].
            width: of the pictures [px].
        """
        self._size = (height, width)
        self._penumbra_px = 1 + 2 * math.ceil(0.5 * intrinsics[0, 0] * _THROW * sun_width_rad)
        self._cast = pixels.Shadow(
            *corners_of([part.points for part in outline]), sun, intrinsics, self._size,
            _NEAREST_M, _FARTHEST_PX, self._penumbra_px,
        )

    def mask(
        self, body: Vectors, place: tuple[float, float, float], to_optical: Vectors,
        camera: Vectors,
    ) -> Mask | None:
        """The shadow in the image; None if not in view.

        Args:
            body: rotation from the body frame to ``map`` (3, 3).
            place: the aircraft's reference point in ``map`` (3,).
            to_optical: rotation from ``map`` to the camera's optical frame (3, 3).
            camera: the camera's place in ``map`` (3,).
        """
        seen = self._cast.outlines(body, place, to_optical, camera)
        if seen is None:
            return None
        rows, columns, outlines = seen
        mask = np.zeros(self._size, np.uint8)
        for outline in outlines:
            hull = cv2.convexHull(outline)
            cv2.fillConvexPoly(mask, hull, (255,), cv2.LINE_AA, _SHIFT)
        soft = cv2.blur(mask[rows, columns], (self._penumbra_px, self._penumbra_px))
        return rows, columns, np.asarray(soft, np.uint8)


_PLATE_M = 3.7
"""Distance of the hand-drawn parts along the wing camera's axis: the nose wheel stands there."""
_PIXEL_CENTRE = 0.375
"""Centre of the first pixel in the coordinates of the drawing."""
_FINE = 4
_FLANK = (0.15, -0.75, 0.64)
"""Normal of the cowling's flank in the body frame: right and up."""
_YAW_STEP_RAD = math.radians(2.0)
_CREAM = (250, 243, 229)
_COWLING = (
    (-200, -42), (-54, -42), (26, -2), (33, 1.5), (42, 5), (48, 9.5), (51.5, 15), (53.2, 22),
    (53.4, 32), (52, 42), (49, 53), (44.5, 66), (41, 75), (35, 88), (28, 100), (20, 112), (10, 123),
    (-2, 133), (-200, 298),
)  # fmt: skip
"""Beyond the edge of the wing camera's picture, at -2, straight on: moved cameras see it."""
_LEG = (
    (-2, 126), (10, 121), (22, 108), (32, 93), (39.5, 81), (40, 88), (38.5, 104), (36.5, 122),
    (33, 138), (27.5, 151), (21, 163), (16, 170), (-2, 164), (-20, 158), (-20, 132),
)  # fmt: skip
_TYRE = (
    (-2, 161), (7, 163.5), (15, 170), (15.5, 178), (12, 190), (8, 197), (2, 199), (-2, 199),
    (-14, 197), (-18, 190), (-21.5, 178), (-21, 170), (-13, 163.5),
)  # fmt: skip
_WHEEL = (
    (-2, 180), (4, 180), (10, 177), (14, 174), (14.4, 181), (12, 189), (8.5, 194), (4, 195),
    (-2, 190), (-14, 192), (-18, 186), (-16, 178),
)  # fmt: skip


class _Canvas(NamedTuple):
    """Fine pixels, and where the wing camera's picture lies in theirs, as a homography (3, 3)."""

    pixels: NDArray[np.uint8]
    place: Vectors

    def corners(self, points: tuple[tuple[float, float], ...]) -> NDArray[np.int32]:
        found = _through(self.place, *np.array(points, np.float64).T) * (_FINE << _SHIFT)
        return np.rint(np.clip(found.T, -_FARTHEST_FINE, _FARTHEST_FINE)).astype(np.int32)


def _through(place: Vectors, x: Vectors, y: Vectors) -> Vectors:
    """Points in the plane of another camera's picture, (2, ...)."""
    depth = np.maximum(place[2, 0] * x + place[2, 1] * y + place[2, 2], _NEAREST)
    found: Vectors = np.stack([row[0] * x + row[1] * y + row[2] for row in place[:2]]) / depth
    return found


def _placed(camera: CameraModel) -> Vectors:
    """Homography from the drawing to a camera's pinhole picture, by the plane of the plate."""
    if camera.view == WING.view:
        return np.eye(3)
    turn = camera.body_to_optical @ WING.body_to_optical.T
    moved = camera.body_to_optical @ (np.array(WING.offset_m) - np.array(camera.offset_m))
    turn[:, 2] += moved / _PLATE_M
    centre = np.array([[1.0, 0.0, _PIXEL_CENTRE], [0.0, 1.0, _PIXEL_CENTRE], [0.0, 0.0, 1.0]])
    place = centre @ camera.inner_intrinsics @ turn @ np.linalg.inv(centre @ WING.intrinsics)
    return np.asarray(place)


@dataclass(frozen=True, kw_only=True, eq=False)
class _HandDrawing:
    """The Caravan drawn by hand; same interface as :class:`.SolidDrawing`."""

    rows: slice
    columns: slice
    behind: NDArray[np.uint8]
    hidden: NDArray[np.int32]
    paints: NDArray[np.intp]
    albedo: Vectors
    opacity: Vectors

    def lit(self, light: Light, yaw_rad: float) -> NDArray[np.uint8]:
        beam = np.zeros(3)
        if light.sun[2] > 0:
            cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
            x, y, z = _FLANK
            facing = max(0.0, float(light.sun @ (cos * x - sin * y, sin * x + cos * y, z)))
            beam = light.direct * min(facing / max(float(light.sun[2]), 0.12), 1.6)
        shine = 0.78 * (0.92 * light.diffuse + 0.55 * beam + 0.45 * light.direct)
        codes = display_code(self.albedo * shine) * self.opacity
        return np.rint(codes).astype(np.uint8).take(self.paints, axis=0)


@lru_cache(maxsize=8)
def _hand_drawing(camera: CameraModel, size: tuple[int, int]) -> _HandDrawing | None:
    """Draw the parts where a camera sees them; None if nowhere."""
    place = _placed(camera)
    reach = _through(place, *np.array((*_COWLING, *_TYRE), np.float64).T)[0].max()
    height, width = size[0], min(size[1], math.ceil(reach) + 2)
    if width < 1:
        return None
    fine = (height * _FINE, width * _FINE)
    colour = _Canvas(np.zeros((*fine, 3), np.uint8), place)
    opacity = _Canvas(np.zeros(fine, np.uint8), place)
    for outline, paint in ((_TYRE, (20, 20, 23)), (_WHEEL, (172, 168, 160)), (_LEG, (98, 86, 76))):
        _fill(colour, outline, paint)
        _fill(opacity, outline, (255,))
    _details(colour)
    _fill(colour, _COWLING, _CREAM)
    _fill(opacity, _COWLING, (255,))
    _rivets(colour)
    shaded = _rounded(colour)
    coverage = opacity.pixels.astype(np.float64) / 255
    # Colours are averaged with their opacity to exclude the background of the drawing.
    weight = cv2.resize(coverage, (width, height), interpolation=cv2.INTER_AREA)[:, :, None]
    mixed = cv2.resize(shaded * coverage[:, :, None], (width, height), interpolation=cv2.INTER_AREA)
    behind = np.rint(np.repeat(255 * (1 - weight), 3, axis=2)).astype(np.uint8)
    seen = np.pad(behind.any(axis=2), ((0, 0), (0, 1)), constant_values=True)
    hidden: NDArray[np.int32] = seen.argmax(axis=1).astype(np.int32)
    hidden.flags.writeable = False
    colours = np.dstack([mixed / np.maximum(weight, 1e-6) / 255, weight]).reshape(-1, 4)
    # Far fewer than pixels, and each is lit once for every heading.
    palette, paints = np.unique(colours, axis=0, return_inverse=True)
    return _HandDrawing(
        rows=slice(0, height), columns=slice(0, width), behind=behind, hidden=hidden,
        paints=paints.reshape(height, width), albedo=palette[:, :3] ** GAMMA,
        opacity=palette[:, 3:],
    )


def _fill(
    canvas: _Canvas, outline: tuple[tuple[float, float], ...], paint: tuple[int, ...]
) -> None:
    cv2.fillPoly(canvas.pixels, [canvas.corners(outline)], paint, lineType=cv2.LINE_AA, shift=4)


def _line(
    canvas: _Canvas, points: tuple[tuple[float, float], ...], paint: tuple[int, ...], px: int,
) -> None:
    cv2.polylines(canvas.pixels, [canvas.corners(points)], False, paint, px, cv2.LINE_AA, 4)


def _details(colour: _Canvas) -> None:
    """Clamps and hoses on the gear leg, hub of the wheel, dark gap above the tyre."""
    _line(colour, ((0, 128), (11, 133), (19, 142), (25, 154)), (150, 142, 134), 3)
    _line(colour, ((-1, 140), (6, 143), (14, 151), (20, 163)), (158, 150, 142), 3)
    _line(colour, ((39, 82), (37.5, 100), (35, 122)), (142, 130, 118), 4)
    _line(colour, ((28, 98), (34, 101), (37.5, 100)), (140, 130, 120), 2)
    _fill(colour, ((-2, 160), (8, 164), (15, 171), (10, 178), (4, 181), (-2, 181)), (16, 19, 26))
    _line(colour, ((2, 184), (6, 187), (9, 184)), (92, 90, 88), 4)


def _rivets(colour: _Canvas) -> None:
    """Panel seams of the cowling."""
    seam = (214, 206, 190)
    _line(colour, ((1, 9), (7, 13), (11, 24), (13, 45), (13.5, 75), (12.5, 108)), seam, 2)
    _line(colour, ((0, 36), (6, 34.5), (12, 33)), seam, 2)
    _line(colour, ((0, 89), (5, 86), (12, 82)), seam, 2)
    for ends in (((38.3, 65), (38.3, 75)), ((19, 86), (18.6, 98)), ((14.5, 107), (16, 103))):
        _line(colour, ends, (60, 56, 50), 3)


def _rounded(canvas: _Canvas) -> NDArray[np.float64]:
    """Darken towards the rim and the underside, as round bodies do."""
    colour = canvas.pixels.astype(np.float64)
    height, width = colour.shape[:2]
    across, down = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)
    back = np.asarray(np.linalg.inv(canvas.place), np.float64)
    x, y = _through(back, across[None, :] / _FINE, down[:, None] / _FINE)
    under = np.clip((y - 62 + 0.5 * x) / 90, 0, 1)
    rim = np.clip((x - 44) / 10, 0, 1)
    factor = 1 - 0.10 * under * ((y < 134) | (x < 0)) - 0.05 * rim
    leg = np.clip(np.abs(x - (46 - 0.16 * y)) / 18, 0, 1)
    factor = np.where(colour[:, :, 0] < 180, 0.72 + 0.42 * leg, factor)
    shaded: NDArray[np.float64] = np.clip(colour * factor[:, :, None], 0, 255)
    return shaded


Drawing = _HandDrawing | SolidDrawing


def drawing(
    aircraft: AircraftModel, camera: CameraModel, size: tuple[int, int]
) -> Drawing | None:
    """Drawing of the aircraft in a camera's pinhole image; None if it is not visible.

    Args:
        aircraft: the aircraft, with its outline.
        camera: the camera.
        size: height and width of the pinhole image [px].
    """
    by_hand = camera.aircraft_parts == BY_HAND or camera.view == WING.view
    if aircraft.name == DEFAULT_AIRCRAFT and by_hand:
        return _hand_drawing(camera, size)
    return solid_drawing(aircraft, camera, size)


MOST_COVERED = 1 / 3
"""Share of a picture covered by the own aircraft above which there is a warning."""


def covering_doubts(aircraft: AircraftModel, camera: CameraModel) -> list[str]:
    """A warning if the aircraft itself covers much of a camera's picture."""
    _, (height, width), *_ = camera.inner_view
    parts = drawing(aircraft, camera, (height, width))
    share = 0.0 if parts is None else float((1 - parts.behind[:, :, 0] / 255).sum())
    share /= height * width
    if share <= MOST_COVERED:
        return []
    return [
        f'camera {camera.reference}: the aircraft itself ({aircraft.reference}) covers '
        f'{100 * share:.0f} % of the picture; taxinet camera draws it'
    ]


class AirframeView:
    """The aircraft's parts in one scenario's light, to be drawn over images."""

    def __init__(self, light: Light, parts: Drawing) -> None:
        """Store the light; the parts are lit on first use of a heading."""
        self._light, self._parts = light, parts
        self._lit: dict[int, NDArray[np.uint8]] = {}

    def lay_over(self, picture: NDArray[np.uint8], yaw_rad: float) -> None:
        """Draw the parts over a picture (height, width, 3), in place.

        Args:
            picture: image of ground and sky.
            yaw_rad: heading of the aircraft in ``map``; it turns the parts in the sun, in steps.
        """
        parts, step = self._parts, round(yaw_rad / _YAW_STEP_RAD)
        if step not in self._lit:
            self._lit[step] = parts.lit(self._light, step * _YAW_STEP_RAD)
        pixels.lay_over(picture[parts.rows, parts.columns], parts.behind, self._lit[step])
