"""Visible parts of the own aircraft: its shadow, and what the camera sees of it.

The Caravan's parts in the wing camera (cowling, gear leg and wheel at the left) are drawn by hand
after the published images; any other combination is rendered from the outline
(:mod:`taxinet_ros.core.camera.solids`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.camera.light import GAMMA, Light, display_code
from taxinet_ros.core.camera.solids import SolidDrawing, solid_drawing
from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.rig.catalogue import DEFAULT_AIRCRAFT, DEFAULT_CAMERA, find_camera
from taxinet_ros.core.rig.outline import Part

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
        self._points = np.concatenate([part.points for part in outline])
        self._starts = np.cumsum([0, *(len(part.points) for part in outline[:-1])]).tolist()
        self._size = (height, width)
        self._penumbra_px = 1 + 2 * math.ceil(0.5 * intrinsics[0, 0] * _THROW * sun_width_rad)
        self._intrinsics = intrinsics
        self._flatten = np.eye(3)
        self._flatten[:, 2] -= sun / sun[2]

    def mask(
        self, body: Vectors, place: Vectors, to_optical: Vectors, camera: Vectors
    ) -> Mask | None:
        """The shadow in the image; None if not in view.

        Args:
            body: rotation from the body frame to ``map`` (3, 3).
            place: the aircraft's reference point in ``map`` (3,).
            to_optical: rotation from ``map`` to the camera's optical frame (3, 3).
            camera: the camera's place in ``map`` (3,).
        """
        turn = to_optical @ self._flatten
        optical = self._points @ (turn @ body).T + (turn @ place - to_optical @ camera)
        corners = pixels.outlines(
            optical, self._starts, self._intrinsics, self._size, _NEAREST_M, _FARTHEST_PX
        )
        polygons = [np.asarray(cv2.convexHull(part), np.int32) for part in corners]
        if not polygons:
            return None
        mask = np.zeros(self._size, np.uint8)
        for polygon in polygons:
            cv2.fillConvexPoly(mask, polygon, (255,), lineType=cv2.LINE_AA, shift=_SHIFT)
        left, top, width, height = cv2.boundingRect(np.concatenate(polygons) >> _SHIFT)
        margin = self._penumbra_px
        rows = slice(max(top - margin, 0), min(top + height + margin, self._size[0]))
        columns = slice(max(left - margin, 0), min(left + width + margin, self._size[1]))
        if rows.start >= rows.stop or columns.start >= columns.stop:
            return None  # it only seemed to be in view
        soft = cv2.blur(mask[rows, columns], (margin, margin))
        return rows, columns, np.asarray(soft, np.uint8)


HEIGHT, WIDTH = 200, 56
_FINE = 4
_FLANK = (0.15, -0.75, 0.64)
"""Normal of the cowling's flank in the body frame: right and up."""
_YAW_STEP_RAD = math.radians(2.0)
_CREAM = (250, 243, 229)
_COWLING = (
    (-2, -2), (26, -2), (33, 1.5), (42, 5), (48, 9.5), (51.5, 15), (53.2, 22), (53.4, 32),
    (52, 42), (49, 53), (44.5, 66), (41, 75), (35, 88), (28, 100), (20, 112), (10, 123), (-2, 133),
)  # fmt: skip
_LEG = (
    (-2, 126), (10, 121), (22, 108), (32, 93), (39.5, 81), (40, 88), (38.5, 104), (36.5, 122),
    (33, 138), (27.5, 151), (21, 163), (16, 170), (-2, 164),
)  # fmt: skip
_TYRE = ((-2, 161), (7, 163.5), (15, 170), (15.5, 178), (12, 190), (8, 197), (2, 199), (-2, 199))
_WHEEL = (
    (-2, 180),
    (4, 180),
    (10, 177),
    (14, 174),
    (14.4, 181),
    (12, 189),
    (8.5, 194),
    (4, 195),
    (-2, 190),
)


@cache
def _drawing() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Colours (HEIGHT, WIDTH, 3) in daylight, 0..255, and opacity (HEIGHT, WIDTH, 1), 0..1."""
    size = (HEIGHT * _FINE, WIDTH * _FINE)
    colour, opacity = np.zeros((*size, 3), np.uint8), np.zeros(size, np.uint8)
    for outline, paint in ((_TYRE, (20, 20, 23)), (_WHEEL, (172, 168, 160)), (_LEG, (98, 86, 76))):
        _fill(colour, outline, paint)
        _fill(opacity, outline, (255,))
    _details(colour)
    _fill(colour, _COWLING, _CREAM)
    _fill(opacity, _COWLING, (255,))
    _rivets(colour)
    shaded = _rounded(colour.astype(np.float64))
    coverage = opacity.astype(np.float64) / 255
    # Colours are averaged with their opacity to exclude the background of the drawing.
    weight = cv2.resize(coverage, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)[:, :, None]
    mixed = cv2.resize(shaded * coverage[:, :, None], (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return mixed / np.maximum(weight, 1e-6), np.asarray(weight, np.float64)


@cache
def _albedo() -> NDArray[np.float64]:
    """Albedo of the parts, (HEIGHT, WIDTH, 3)."""
    colour, _ = _drawing()
    return np.asarray((colour / 255) ** GAMMA, np.float64)


@cache
def _behind() -> NDArray[np.uint8]:
    """Transparency, (HEIGHT, WIDTH, 3), in 255ths."""
    _, opacity = _drawing()
    return np.rint(np.repeat(255 * (1 - opacity), 3, axis=2)).astype(np.uint8)


@cache
def hidden_columns() -> NDArray[np.int32]:
    """Number of columns at the left of each image row fully covered by the parts, (HEIGHT,)."""
    seen = np.pad(_behind().any(axis=2), ((0, 0), (0, 1)), constant_values=True)
    columns: NDArray[np.int32] = seen.argmax(axis=1).astype(np.int32)
    columns.flags.writeable = False
    return columns


def _fill(
    canvas: NDArray[np.uint8], outline: tuple[tuple[float, float], ...], paint: tuple[int, ...]
) -> None:
    points = np.rint(np.array(outline) * _FINE * 16).astype(np.int32)
    cv2.fillPoly(canvas, [points], paint, lineType=cv2.LINE_AA, shift=4)


def _line(
    canvas: NDArray[np.uint8],
    points: tuple[tuple[float, float], ...],
    paint: tuple[int, ...],
    px: int,
) -> None:
    corners = np.rint(np.array(points) * _FINE * 16).astype(np.int32)
    cv2.polylines(canvas, [corners], False, paint, px, cv2.LINE_AA, 4)


def _details(colour: NDArray[np.uint8]) -> None:
    """Clamps and hoses on the gear leg, hub of the wheel, dark gap above the tyre."""
    _line(colour, ((0, 128), (11, 133), (19, 142), (25, 154)), (150, 142, 134), 3)
    _line(colour, ((-1, 140), (6, 143), (14, 151), (20, 163)), (158, 150, 142), 3)
    _line(colour, ((39, 82), (37.5, 100), (35, 122)), (142, 130, 118), 4)
    _line(colour, ((28, 98), (34, 101), (37.5, 100)), (140, 130, 120), 2)
    _fill(colour, ((-2, 160), (8, 164), (15, 171), (10, 178), (4, 181), (-2, 181)), (16, 19, 26))
    _line(colour, ((2, 184), (6, 187), (9, 184)), (92, 90, 88), 4)


def _rivets(colour: NDArray[np.uint8]) -> None:
    """Panel seams of the cowling."""
    seam = (214, 206, 190)
    _line(colour, ((1, 9), (7, 13), (11, 24), (13, 45), (13.5, 75), (12.5, 108)), seam, 2)
    _line(colour, ((0, 36), (6, 34.5), (12, 33)), seam, 2)
    _line(colour, ((0, 89), (5, 86), (12, 82)), seam, 2)
    for ends in (((38.3, 65), (38.3, 75)), ((19, 86), (18.6, 98)), ((14.5, 107), (16, 103))):
        _line(colour, ends, (60, 56, 50), 3)


def _rounded(colour: NDArray[np.float64]) -> NDArray[np.float64]:
    """Darken towards the rim and the underside, as round bodies do."""
    y = (np.arange(colour.shape[0]) / _FINE)[:, None]
    x = (np.arange(colour.shape[1]) / _FINE)[None, :]
    under = np.clip((y - 62 + 0.5 * x) / 90, 0, 1)
    rim = np.clip((x - 44) / 10, 0, 1)
    factor = 1 - 0.10 * under * (y < 134) - 0.05 * rim
    leg = np.clip(np.abs(x - (46 - 0.16 * y)) / 18, 0, 1)
    factor = np.where(colour[:, :, 0] < 180, 0.72 + 0.42 * leg, factor)
    shaded: NDArray[np.float64] = np.clip(colour * factor[:, :, None], 0, 255)
    return shaded


class _WingDrawing:
    """The Caravan in the wing camera; same interface as :class:`.SolidDrawing`."""

    rows, columns = slice(0, HEIGHT), slice(0, WIDTH)

    def __init__(self) -> None:
        self.behind, self.hidden = _behind(), hidden_columns()

    def lit(self, light: Light, yaw_rad: float) -> NDArray[np.uint8]:
        beam = np.zeros(3)
        if light.sun[2] > 0:
            cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
            x, y, z = _FLANK
            facing = max(0.0, float(light.sun @ (cos * x - sin * y, sin * x + cos * y, z)))
            beam = light.direct * min(facing / max(float(light.sun[2]), 0.12), 1.6)
        shine = 0.78 * (0.92 * light.diffuse + 0.55 * beam + 0.45 * light.direct)
        _, opacity = _drawing()
        return np.rint(display_code(_albedo() * shine) * opacity).astype(np.uint8)


Drawing = _WingDrawing | SolidDrawing


def drawing(
    aircraft: AircraftModel, camera: CameraModel, size: tuple[int, int]
) -> Drawing | None:
    """Drawing of the aircraft in a camera's pinhole image; None if it is not visible.

    Args:
        aircraft: the aircraft, with its outline.
        camera: the camera.
        size: height and width of the pinhole image [px].
    """
    if aircraft.name == DEFAULT_AIRCRAFT and camera.view == find_camera(DEFAULT_CAMERA).view:
        return _WingDrawing()
    return solid_drawing(aircraft, camera, size)


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
