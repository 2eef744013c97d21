"""Others on the ground in the picture: marks, shadows and solids, in the scene's light and haze.

Marks lie in the ground's texture, below every shade. Shadows fall along the sun's rays; a faint
one right under a body stands for the sky that it hides. Solids are drawn from far to near: faces
that look at the camera, each in one tone, by its angle to sun and sky. Edges are drawn several
times finer than the picture and averaged.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.camera.atmosphere import Atmosphere
from taxinet_ros.core.camera.light import GAMMA, CloudShade, Light, display_code
from taxinet_ros.core.rig.outline import corners_of
from taxinet_ros.core.traffic.shapes import (
    PAINT,
    UNSEEN,
    Part,
    body,
    daylight_colour,
    face_normal,
)
from taxinet_ros.core.traffic.traffic import HOLD_LINE, GroundObject, Pose, Size, Traffic

Vectors = NDArray[np.float64]
Picture = NDArray[np.uint8]
Placed = Sequence[tuple[GroundObject, Pose]]
_Joined = tuple[Vectors, list[int]]

_DOWN = np.diag((1.0, 1.0, 0.0))
"""Casts what is above the ground straight down."""
_NEAREST_M = 0.3
_FARTHEST_PX = 1e7
"""Beyond this, coordinates are limited one by one, as they are integers."""
_FARTHEST_M = 3000.0
_SHIFT = 4
"""Drawings have sixteenths of a pixel."""
_SKY_HIDDEN = 0.4
"""Share of the sky's light that is missing right under a body."""
_CLEAR_UNDER_M = 0.9
"""Only what is lower hides the sky from the ground below."""
_BOUNCE = 0.18
"""Albedo of the ground that lights undersides."""
_MOST_BEAM = 2.2
"""Beam on a face that looks at the sun, over that on level ground: the exposure limits it."""

Polygon = Sequence[tuple[float, float]]
Polygons = Sequence[tuple[Sequence[Polygon], float]]
"""Polygons (length, width) of a mark, -0.5..0.5 of its size, painted at once, and their opacity."""


def _arms() -> Polygons:
    half = 0.11
    return [
        ([[(-0.5, sign * (0.5 - half)), (-0.5, sign * 0.5), (-0.5 + half, sign * 0.5),
           (0.5, -sign * (0.5 - half)), (0.5, -sign * 0.5), (0.5 - half, -sign * 0.5)]], 0.88)
        for sign in (1, -1)
    ]


def _rectangle(x0: float, x1: float, y0: float, y1: float) -> list[tuple[float, float]]:
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def _hold_line() -> Polygons:
    """Two solid lines, first for who has to hold, and two broken ones, 0.3 m each."""
    solid = [_rectangle(at / 7 - 0.5, (at + 1) / 7 - 0.5, -0.5, 0.5) for at in (0, 2)]
    dashes = [
        _rectangle(at / 7 - 0.5, (at + 1) / 7 - 0.5, dash / 24 - 0.5, (dash + 1) / 24 - 0.5)
        for at in (4, 6) for dash in range(0, 24, 2)
    ]
    return [(solid + dashes, 0.88)]


_MARKS: dict[str, Polygons] = {
    'closed_marking': _arms(),
    'painted_over': [([_rectangle(-0.5, 0.5, -0.5, 0.5)], 0.82)],
    'tyre_marks': [
        ([_rectangle(begin, end, side - 0.07, side + 0.07)], opacity)
        for side in (-0.43, 0.43)
        for begin, end, opacity in ((-0.5, -0.3, 0.35), (-0.3, 0.2, 0.6), (0.2, 0.5, 0.4))
    ],
    'patch': [
        ([_rectangle(-0.5, 0.5, -0.5, 0.5)], 0.4),
        ([_rectangle(-0.5, 0.5, -0.5, -0.47)], 0.6), ([_rectangle(-0.5, 0.5, 0.47, 0.5)], 0.6),
        ([_rectangle(-0.5, -0.485, -0.5, 0.5)], 0.6), ([_rectangle(0.485, 0.5, -0.5, 0.5)], 0.6),
    ],
    HOLD_LINE: _hold_line(),
}


class ObjectsView:
    """Others on the ground in one scenario's light. Not to be shared between threads."""

    def __init__(
        self, traffic: Traffic, light: Light, clouds: CloudShade, atmosphere: Atmosphere,
        gain: Vectors, intrinsics: Vectors, size: tuple[int, int], *, casts: bool,
    ) -> None:
        """Prepare for one scenario.

        Args:
            traffic: the objects.
            light: light and weather.
            clouds: shade of single clouds.
            atmosphere: haze and spray.
            gain: factors on daylight codes of the ground's buffer, by channel.
            intrinsics: camera matrix (3, 3).
            size: height and width of the picture [px].
            casts: whether the sun casts shadows.
        """
        self._light, self._clouds, self._atmosphere = light, clouds, atmosphere
        self._focal_px = float(intrinsics[0, 0])
        self._pinhole = pixels.Pinhole(intrinsics, size, _NEAREST_M, _FARTHEST_PX)
        self._cast = np.eye(3) if casts else None
        if self._cast is not None:
            self._cast[:, 2] -= light.sun / light.sun[2]
        self._solids = {id(one): _Solid(one, light) for one in traffic.solids}
        self._buffer = np.empty(0, np.uint8)
        self._marks = [
            (mark.pose_at(0), corners_of(polygons), np.array(daylight_colour(mark.colour)) * gain,
             opacity)
            for mark in traffic.marks for polygons, opacity in _flat(mark)
        ]

    def paint_marks(
        self, ground: Picture, to_optical: Vectors, camera: Vectors
    ) -> None:
        """Paint the marks on the unlit ground (height, width, 3), in place.

        Args:
            ground: its daylight colours times the gain.
            to_optical: rotation from ``map`` to the camera's optical frame (3, 3).
            camera: the camera's place in ``map`` (3,).
        """
        for pose, parts, paint, opacity in self._marks:
            found = self._mask(parts, pose, _DOWN, to_optical, camera)
            if found is not None:
                rows, columns, mask = found
                pixels.blend_masked(ground[rows, columns], mask, paint, opacity)

    def shade(
        self, ground: Picture, to_optical: Vectors, camera: Vectors, solids: Placed,
        shaded: NDArray[np.uint8],
    ) -> None:
        """Darken the ground in the solids' shadows, in place.

        Args:
            ground: as for :meth:`paint_marks`.
            to_optical: rotation from ``map`` to the camera's optical frame (3, 3).
            camera: the camera's place in ``map`` (3,).
            solids: the solids, and where they are.
            shaded: (height, width) where another shadow is already, 255 for full; no ground is
                darkened twice. Shadows are added.
        """
        for one, pose in solids:
            solid = self._solids[id(one)]
            away_m = max(math.hypot(pose.x_m - camera[0], pose.y_m - camera[1]), _NEAREST_M)
            found = self._mask(
                solid.low, pose, _DOWN, to_optical, camera, 0.3 * self._focal_px / away_m
            )
            if found is not None:
                rows, columns, mask = found
                pixels.tint_masked(ground[rows, columns], mask, (_SKY_HIDDEN,) * 3)
            if self._cast is None:
                continue
            throw_px = self._focal_px * one.size.height_m * self._light.sun_width_rad / away_m
            found = self._mask(solid.parts, pose, self._cast, to_optical, camera, 0.5 * throw_px)
            if found is not None:
                rows, columns, mask = found
                before = shaded[rows, columns]
                more = np.asarray(cv2.subtract(mask, before), np.uint8)
                np.maximum(before, mask, out=before)
                depth = self._clouds.shadow_depth(pose.x_m, pose.y_m)
                pixels.tint_masked(ground[rows, columns], more, depth)

    def draw_solids(
        self, picture: Picture, to_optical: Vectors, camera: Vectors, solids: Placed
    ) -> None:
        """Draw the solids over a picture of ground and sky (height, width, 3), in place."""
        away = [math.hypot(pose.x_m - camera[0], pose.y_m - camera[1]) for _, pose in solids]
        for number in sorted(range(len(solids)), key=lambda k: (-away[k], k)):
            if away[number] < _FARTHEST_M:
                self._draw(picture, *solids[number], away[number], to_optical, camera)

    def _draw(
        self, picture: Picture, one: GroundObject, pose: Pose, away_m: float,
        to_optical: Vectors, camera: Vectors,
    ) -> None:
        solid = self._solids[id(one)]
        found = self._pinhole.faces(*solid.faces, pose, to_optical, camera)
        if found is None:
            return
        (rows, columns, fine, polygons), numbers = found
        sun_share = self._clouds.sun_share(pose.x_m, pose.y_m)
        kept, added = self._atmosphere.veil_at(away_m)
        codes = np.rint(solid.codes(pose.heading_rad, sun_share)[numbers] * kept + added)
        behind = picture[rows, columns]
        canvas = self._canvas(behind.shape[:2], fine, 4)
        for polygon, code in zip(polygons, codes.tolist(), strict=True):
            cv2.fillConvexPoly(canvas, polygon, (*code, 1), shift=_SHIFT)
        pixels.average(canvas, behind)

    def _mask(
        self, parts: _Joined, pose: Pose, cast: Vectors, to_optical: Vectors, camera: Vectors,
        blur_px: float = 0.0,
    ) -> tuple[slice, slice, NDArray[np.uint8]] | None:
        """How much of each pixel parts cover where they are cast, 0..255; None if not in view.

        Args:
            parts: convex, in a frame that is at a pose.
            pose: in ``map``.
            cast: casts points in ``map`` on the ground (3, 3).
            to_optical: rotation from ``map`` to the camera's optical frame (3, 3).
            camera: the camera's place in ``map`` (3,).
            blur_px: width of the soft edge.
        """
        margin = min(1 + 2 * math.ceil(0.5 * blur_px), 31)
        found = self._pinhole.cover(*parts, pose, cast, to_optical, camera, margin + 1)
        if found is None:
            return None
        rows, columns, fine, polygons = found
        mask = np.empty((rows.stop - rows.start, columns.stop - columns.start), np.uint8)
        canvas = self._canvas(mask.shape, fine, 1)
        for polygon in polygons:
            cv2.fillConvexPoly(canvas, polygon, (255,), shift=_SHIFT)
        pixels.average(canvas, mask)
        if margin > 1:
            mask = np.asarray(cv2.blur(mask, (margin, margin)), np.uint8)
        return rows, columns, mask

    def _canvas(self, size: tuple[int, ...], fine: int, codes: int) -> Picture:
        """An empty canvas, as many times finer than a size and with so many codes a pixel."""
        shape = size[0] * fine, size[1] * fine, *([codes] if codes > 1 else [])
        count = math.prod(shape)
        if count > len(self._buffer):
            self._buffer = np.empty(count, np.uint8)
        canvas = self._buffer[:count].reshape(shape)
        canvas.fill(0)
        return canvas


def _flat(mark: GroundObject) -> Iterator[tuple[list[Vectors], float]]:
    """Corners (n, 3) of the polygons of a mark that are painted at once, and their opacity."""
    for polygons, opacity in _MARKS[mark.kind]:
        yield [np.pad(np.array(one) * mark.size[:2], ((0, 0), (0, 1))) for one in polygons], opacity


@lru_cache(maxsize=64)
def _parts(kind: str, size: Size) -> list[Part]:
    return [part for part in body(kind, size) if part.colour != UNSEEN]


@lru_cache(maxsize=64)
def _faces(kind: str, size: Size) -> tuple[Vectors, list[int], Vectors]:
    """All faces, and of each its middle, its normal and the middle of its group (3 faces, 3).

    A group is a part with its details.
    """
    parts, about, group = _parts(kind, size), [], []
    for part, following in itertools.zip_longest(parts, parts[1:]):
        group.append(part)
        if following is None or not following.detail:
            middle = np.concatenate([one.corners for one in group]).mean(axis=0)
            for corners in (one.corners[list(face)] for one in group for face in one.faces):
                about += [corners.mean(axis=0), face_normal(corners), middle]
            group = []
    faces = [part.corners[list(face)] for part in parts for face in part.faces]
    return *corners_of(faces), np.array(about)


class _Solid:
    """A solid in one scenario's light."""

    def __init__(self, one: GroundObject, light: Light) -> None:
        parts = _parts(one.kind, one.size)
        corners = [part.corners for part in parts]
        self.parts = corners_of(corners)
        self.low = corners_of([part for part in corners if part[:, 2].min() < _CLEAR_UNDER_M])
        self.faces = _faces(one.kind, one.size)
        self._light, self._normals = light, self.faces[2][1::3]
        colours = [
            daylight_colour(one.colour if part.colour == PAINT else part.colour)
            for part in parts for _ in part.faces
        ]
        wet = 1 - 0.15 * light.wetness
        self._albedos = wet * (np.array(colours) / 255) ** GAMMA
        self._lit: tuple[float, float, Vectors] | None = None

    def codes(self, heading_rad: float, sun_share: float) -> Vectors:
        """Display codes (n, 3) of all faces; most solids stand, or go straight on in the sun."""
        if self._lit is None or self._lit[:2] != (heading_rad, sun_share):
            cos, sin = math.cos(heading_rad), math.sin(heading_rad)
            turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
            codes = _face_codes(self._light, self._albedos, self._normals @ turn.T, sun_share)
            self._lit = heading_rad, sun_share, codes
        return self._lit[2]


def _face_codes(light: Light, albedos: Vectors, normals: Vectors, sun_share: float) -> Vectors:
    """Display codes (n, 3) of faces with these normals in ``map``."""
    beam = np.zeros(len(normals))
    if light.sun[2] > 0:
        facing = np.maximum(normals @ light.sun, 0)
        beam = np.minimum(facing / max(float(light.sun[2]), 0.12), _MOST_BEAM) * sun_share
    sky = (1 + normals[:, 2]) / 2
    shine = beam[:, None] * light.direct + sky[:, None] * light.diffuse
    shine = shine + (_BOUNCE * (1 - sky))[:, None] * light.total
    return display_code(albedos * shine)
