"""The aircraft's own shadow: the outline of a high-wing single projected along the sun's ray.

Outlines are convex boxes after the three-view of the Cessna 208B (span 15.9 m, length 11.5 m, wing
at 2.9 m above ground), in the body frame about the reference point (x forward, y left, z up) [m].
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core import pixels

Vectors = NDArray[np.float64]

Mask = tuple[slice, slice, NDArray[np.uint8]]
"""Rows and columns of the picture, and there 255 for full shade, soft at the edge."""

LOWEST_SUN_RAD = math.radians(1.0)
"""Below this the shadow is longer than the runway is wide and fainter than the sky's light."""

_NEAREST_M = 0.2
_THROW = 0.5
"""How far a shadow falls, as a share of its distance from the camera: a typical value."""

_FARTHEST_PX = 4000.0
_SHIFT = 4
"""OpenCV draws in whole numbers: of sixteenths of a pixel."""


def _prism(
    rear: tuple[float, float, float, float, float], front: tuple[float, float, float, float, float]
) -> Vectors:
    """Eight corners between two rectangles (x, y_low, y_high, z_low, z_high)."""
    return np.array([
        (x, y, z) for x, y0, y1, z0, z1 in (rear, front) for y in (y0, y1) for z in (z0, z1)
    ])  # fmt: skip


def _wing(side: int) -> Vectors:
    return np.array([
        (x, side * y, z)
        for y, chord, lift in ((0.0, 1.98, 0.0), (7.95, 1.20, 0.42))
        for x in (0.55, 0.55 - chord)
        for z in (1.22 + lift, 1.42 + lift)
    ])  # fmt: skip


def _wheel(x: float, y: float, radius: float) -> Vectors:
    angles = np.linspace(0, 2 * math.pi, 8, endpoint=False)
    centre = radius - 1.55
    return np.array([
        (x + radius * math.cos(a), y + w, centre + radius * math.sin(a))
        for a in angles
        for w in (-0.12, 0.12)
    ])  # fmt: skip


OUTLINE: tuple[Vectors, ...] = (
    _prism((-1.2, -0.8, 0.8, -0.85, 1.25), (2.2, -0.8, 0.8, -0.85, 1.25)),
    _prism((-6.6, -0.15, 0.15, 0.35, 0.75), (-1.2, -0.8, 0.8, -0.85, 1.15)),
    _prism((2.2, -0.75, 0.75, -0.85, 0.95), (4.4, -0.4, 0.4, -0.55, 0.45)),
    _prism((-6.9, -0.06, 0.06, 0.6, 2.95), (-5.6, -0.06, 0.06, 0.6, 2.6)),
    np.array([(x, y, z) for x in (-6.7, -5.6) for y in (-3.1, 3.1) for z in (0.75, 0.85)]),
    _wing(1),
    _wing(-1),
    _wheel(-0.45, 1.78, 0.38),
    _wheel(-0.45, -1.78, 0.38),
    _wheel(3.6, 0.0, 0.32),
    np.array([(-0.3, 0.7, -0.8), (-0.6, 0.7, -0.8), (-0.35, 1.8, -1.2), (-0.55, 1.8, -1.2)]),
    np.array([(-0.3, -0.7, -0.8), (-0.6, -0.7, -0.8), (-0.35, -1.8, -1.2), (-0.55, -1.8, -1.2)]),
    np.array([(0.3, -3.6, 1.3), (0.2, -0.8, -0.5), (0.1, -0.8, -0.5), (0.2, -3.6, 1.3)]),
    np.array([(0.3, 3.6, 1.3), (0.2, 0.8, -0.5), (0.1, 0.8, -0.5), (0.2, 3.6, 1.3)]),
)


_POINTS = np.concatenate(OUTLINE)
_STARTS = np.cumsum([0, *(len(part) for part in OUTLINE[:-1])]).tolist()


class OwnShadow:
    """Where the aircraft's shadow lies in pictures, for one place of the sun."""

    def __init__(
        self, sun: Vectors, sun_width_rad: float, intrinsics: Vectors, height: int, width: int
    ) -> None:
        """Prepare for pictures of ``height`` by ``width`` pixels.

        Args:
            sun: unit vector towards the sun in ``map``; its z is positive.
            sun_width_rad: how wide the sun looks; it sets the width of the penumbra [rad].
            intrinsics: camera matrix (3, 3).
            height: of the pictures [px].
            width: of the pictures [px].
        """
        self._size = (height, width)
        self._penumbra_px = 1 + 2 * math.ceil(0.5 * intrinsics[0, 0] * _THROW * sun_width_rad)
        self._intrinsics = intrinsics
        self._flatten = np.eye(3)
        self._flatten[:, 2] -= sun / sun[2]

    def mask(
        self, body: Vectors, place: Vectors, to_optical: Vectors, camera: Vectors
    ) -> Mask | None:
        """The shadow in the picture; None where none is in view.

        Args:
            body: rotation from the body frame to ``map`` (3, 3).
            place: the aircraft's reference point in ``map`` (3,).
            to_optical: rotation from ``map`` to the camera's optical frame (3, 3).
            camera: the camera's place in ``map`` (3,).
        """
        turn = to_optical @ self._flatten
        optical = _POINTS @ (turn @ body).T + (turn @ place - to_optical @ camera)
        corners = pixels.outlines(
            optical, _STARTS, self._intrinsics, self._size, _NEAREST_M, _FARTHEST_PX
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
        soft = cv2.blur(mask[rows, columns], (margin, margin))
        return rows, columns, np.asarray(soft, np.uint8)
