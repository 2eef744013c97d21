"""The aircraft's own shadow: the outline of a high-wing single projected along the sun's ray.

Outlines are convex boxes after the three-view of the Cessna 208B (span 15.9 m, length 11.5 m, wing
at 2.9 m above ground), in the body frame about the reference point (x forward, y left, z up) [m].
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]

Mask = tuple[slice, slice, NDArray[np.uint8]]
"""Rows and columns of the picture, and there 255 for full shade, soft at the edge."""

LOWEST_SUN_RAD = math.radians(1.0)
"""Below this the shadow is longer than the runway is wide and fainter than the sky's light."""

_NEAREST_M = 0.2
_PENUMBRA_PX = 3


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
_STARTS = np.cumsum([0, *(len(part) for part in OUTLINE[:-1])])


def shadow_on_ground(body_to_map: Vectors, position: Vectors, sun: Vectors) -> Vectors:
    """Where the corners of all convex parts, one after the other, throw their shadow: (N, 3) [m].

    Args:
        body_to_map: rotation matrix of the aircraft's attitude, (3, 3).
        position: reference point in ``map`` (3,).
        sun: unit vector towards the sun in ``map``; its z is positive.
    """
    points = _POINTS @ body_to_map.T + position
    points -= points[:, 2:] * (sun / sun[2])
    points[:, 2] = 0.0
    return points


def shadow_mask(optical: Vectors, intrinsics: Vectors, size: tuple[int, int]) -> Mask | None:
    """The shadow in the picture; None where none is in view.

    Args:
        optical: corners from :func:`shadow_on_ground` in the camera's optical frame, (N, 3) [m].
        intrinsics: camera matrix (3, 3).
        size: (height, width) of the picture [px].
    """
    polygons = [
        np.rint(np.clip(polygon, -4000, 4000) * 16).astype(np.int32)
        for polygon in _polygons_in_view(optical, intrinsics, size)
    ]
    if not polygons:
        return None
    mask = np.zeros(size, np.uint8)
    for polygon in polygons:
        cv2.fillConvexPoly(mask, polygon, (255,), lineType=cv2.LINE_AA, shift=4)
    corners = np.concatenate(polygons)[:, 0] // 16
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    margin = _PENUMBRA_PX
    rows = slice(max(int(top) - margin, 0), min(int(bottom) + margin + 1, size[0]))
    columns = slice(max(int(left) - margin, 0), min(int(right) + margin + 1, size[1]))
    soft = cv2.blur(mask[rows, columns], (_PENUMBRA_PX, _PENUMBRA_PX))
    return rows, columns, np.asarray(soft, np.uint8)


def _polygons_in_view(
    optical: Vectors, intrinsics: Vectors, size: tuple[int, int]
) -> list[NDArray[np.float32]]:
    """Outlines (n, 1, 2) [px] of the parts whose shadow may touch the picture."""
    scaled = optical @ intrinsics.T
    right = scaled[:, 0] - size[1] * scaled[:, 2]
    below = scaled[:, 1] - size[0] * scaled[:, 2]
    # Signed distances from the view's five sides, inside positive. A convex part that lies beyond
    # one of them is out of view, also where some of its corners are behind the camera.
    sides = np.stack([scaled[:, 0], scaled[:, 1], -right, -below, optical[:, 2] - _NEAREST_M])
    seen = (np.maximum.reduceat(sides, _STARTS, axis=1) > 0).all(axis=0)
    polygons = []
    for part in np.flatnonzero(seen):
        corners = optical[_STARTS[part] : _STARTS[part] + len(OUTLINE[part])]
        outline = _cut(corners) @ intrinsics.T
        pixels = (outline[:, :2] / outline[:, 2:]).astype(np.float32)
        polygons.append(cv2.convexHull(pixels).astype(np.float32))
    return polygons


def _cut(points: Vectors) -> Vectors:
    """Points whose hull is the share of these points' hull that lies before the camera.

    Every pair across the nearest plane adds the point where its line pierces it; convexity does
    the rest.
    """
    front = points[:, 2] >= _NEAREST_M
    if front.all():
        return points
    ahead, behind = points[front], points[~front]
    share = (_NEAREST_M - behind[None, :, 2]) / (ahead[:, None, 2] - behind[None, :, 2])
    cuts = behind[None] + share[:, :, None] * (ahead[:, None] - behind[None])
    return np.concatenate([ahead, cuts.reshape(-1, 3)])
