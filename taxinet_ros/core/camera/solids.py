"""Rendering of the own aircraft from its outline.

The camera is fixed to the aircraft, so the image positions of the parts are constant: their faces
are rasterised once, with a depth buffer and several samples per pixel. Only the lighting changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.light import GAMMA, Light, display_code
from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.rig.outline import Part

Vectors = NDArray[np.float64]
_NEAREST_M = 0.02
_MANY_SAMPLES = 3_000_000
_FINEST = 4
_FLAT_M = 1e-6
_SHIFT = 4
_LOWEST_SINE = 0.12
"""Least sine of the sun's elevation when converting irradiance of level ground to the beam's."""
_FROM_GROUND = 0.18
"""Reflectance of the ground for light on faces that look down."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SolidDrawing:
    """Rasterised faces of the aircraft.

    Attributes:
        rows, columns: part of the image that contains them.
        behind: transparency (rows, columns, 3), in 255ths.
        hidden: columns at the left of each row of the whole picture that are covered, (height,).
        faces: face of each sample, 0 for none, (n * rows, n * columns).
        normals: outward normals of the faces in the body frame, (faces + 1, 3).
        albedo: albedo of the faces, (faces + 1, 3).
    """

    rows: slice
    columns: slice
    behind: NDArray[np.uint8]
    hidden: NDArray[np.int32]
    faces: NDArray[np.uint16]
    normals: Vectors
    albedo: Vectors

    def lit(self, light: Light, yaw_rad: float) -> NDArray[np.uint8]:
        """Display codes (rows, columns, 3) in a light, times the opacity."""
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        x, y, z = light.sun
        sun = np.array([cos * x + sin * y, cos * y - sin * x, z])
        up = 0.5 + 0.5 * self.normals[:, 2:]
        beam = np.maximum(self.normals @ sun, 0.0)[:, None] / max(float(z), _LOWEST_SINE)
        shine = up * light.diffuse + (1 - up) * _FROM_GROUND * light.total
        if z > 0:
            shine = shine + np.minimum(beam, 1 / _LOWEST_SINE) * light.direct
        codes = np.rint(display_code(self.albedo * shine)).astype(np.uint8)
        codes[0] = 0
        size = self.behind.shape[1], self.behind.shape[0]
        shown = cv2.resize(codes[self.faces], size, interpolation=cv2.INTER_AREA)
        # Rounding must not make the sum with what shines through exceed 255.
        return np.minimum(np.asarray(shown, np.uint8), 255 - self.behind)


@lru_cache(maxsize=8)
def solid_drawing(
    aircraft: AircraftModel, camera: CameraModel, size: tuple[int, int]
) -> SolidDrawing | None:
    """Rasterise the aircraft in a camera's pinhole image; None if it is not visible.

    Args:
        aircraft: the aircraft, with its outline.
        camera: the camera; its distortion is not applied.
        size: height and width of the pinhole image [px].
    """
    height, width = size
    finer = min(_FINEST, max(1, math.isqrt(_MANY_SAMPLES // (height * width))))
    matrix = camera.inner_intrinsics.copy()
    matrix[:2, 2] += 0.5
    matrix[:2] *= finer
    matrix[:2, 2] -= 0.5
    buffer = _Buffer(matrix, (finer * height, finer * width))
    normals, albedo = [np.zeros(3)], [np.zeros(3)]
    eye = np.array(camera.offset_m)
    for part in (part for part in aircraft.outline if part.seen):
        for normal, corners in _seen_faces(part, eye):
            if buffer.add(len(normals), (corners - eye) @ camera.body_to_optical.T):
                normals.append(normal)
                albedo.append((np.array(part.colour) / 255) ** GAMMA)
    return buffer.drawing(finer, np.array(normals), np.array(albedo))


class _Buffer:
    """Nearest face of each sample."""

    def __init__(self, matrix: Vectors, size: tuple[int, int]) -> None:
        self._matrix, self._size = matrix, size
        self._to_ray = np.linalg.inv(matrix)
        self._faces = np.zeros(size, np.uint16)
        self._nearness = np.zeros(size, np.float32)

    def add(self, number: int, corners: Vectors) -> bool:
        """Draw a face with corners in the optical frame; return whether any sample is visible."""
        corners = _before_camera(corners)
        if len(corners) < 3:
            return False
        places = (corners @ self._matrix.T)[:, :2] / corners[:, 2:]
        height, width = self._size
        left, top = np.floor(np.clip(places.min(axis=0), -1, (width, height))).astype(int)
        right, bottom = np.ceil(np.clip(places.max(axis=0), -1, (width, height))).astype(int)
        left, top = max(left, 0), max(top, 0)
        right, bottom = min(right + 1, width), min(bottom + 1, height)
        if left >= right or top >= bottom:
            return False
        mask = np.zeros((bottom - top, right - left), np.uint8)
        points = np.rint((places - (left, top)) * (1 << _SHIFT)).astype(np.int32)
        cv2.fillConvexPoly(mask, points, (1,), lineType=cv2.LINE_8, shift=_SHIFT)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        across, down, rest = (normal / (normal @ corners[0])) @ self._to_ray
        nearness = (
            across * np.arange(left, right)[None, :] + down * np.arange(top, bottom)[:, None] + rest
        ).astype(np.float32)
        inside = slice(top, bottom), slice(left, right)
        nearer = (mask > 0) & (nearness > self._nearness[inside])
        self._nearness[inside][nearer] = nearness[nearer]
        self._faces[inside][nearer] = number
        return bool(nearer.any())

    def drawing(self, finer: int, normals: Vectors, albedo: Vectors) -> SolidDrawing | None:
        """The drawing of all faces so far, reduced to pixels."""
        covered = self._faces > 0
        if not covered.any():
            return None
        height, width = (side // finer for side in self._size)
        counts = covered.reshape(height, finer, width, finer).sum(axis=(1, 3))
        by_row, by_column = (np.flatnonzero(counts.any(axis=axis)) for axis in (1, 0))
        rows = slice(int(by_row[0]), int(by_row[-1]) + 1)
        columns = slice(int(by_column[0]), int(by_column[-1]) + 1)
        open_share = 1 - counts[rows, columns] / finer**2
        behind = np.rint(255 * open_share).astype(np.uint8)[:, :, None].repeat(3, axis=2)
        full = counts == finer**2
        hidden = np.where(full.all(axis=1), width, full.argmin(axis=1)).astype(np.int32)
        hidden.flags.writeable = False
        samples = self._faces[
            rows.start * finer:rows.stop * finer, columns.start * finer:columns.stop * finer
        ]
        return SolidDrawing(
            rows=rows, columns=columns, behind=np.ascontiguousarray(behind), hidden=hidden,
            faces=samples.copy(), normals=normals, albedo=albedo,
        )


def _before_camera(corners: Vectors) -> Vectors:
    """Clip a polygon at the nearest depth (Sutherland and Hodgman)."""
    kept = []
    for one, following in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if one[2] >= _NEAREST_M:
            kept.append(one)
        if (one[2] >= _NEAREST_M) != (following[2] >= _NEAREST_M):
            share = (_NEAREST_M - one[2]) / (following[2] - one[2])
            kept.append(one + share * (following - one))
    return np.array(kept).reshape(-1, 3)


def _seen_faces(part: Part, eye: Vectors) -> list[tuple[Vectors, Vectors]]:
    """Outward normals and corners of the faces that are turned towards the camera."""
    return [
        (normal, corners) for normal, corners in hull_faces(part)
        if normal @ (eye - corners[0]) > _FLAT_M
    ]


@lru_cache(maxsize=512)
def hull_faces(part: Part) -> tuple[tuple[Vectors, Vectors], ...]:
    """Outward normal and ordered corners of each face of a convex part."""
    points = part.points
    triples = np.array(list(combinations(range(len(points)), 3)))
    first, second, third = (points[triples[:, i]] for i in range(3))
    normals = np.cross(second - first, third - first)
    lengths = np.linalg.norm(normals, axis=1)
    real = lengths > _FLAT_M**2
    normals = normals[real] / lengths[real, None]
    sides = normals @ points.T - (normals * first[real]).sum(axis=1)[:, None]
    found: dict[tuple[float, ...], tuple[Vectors, Vectors]] = {}
    for sign in (1.0, -1.0):
        for normal, side in zip(sign * normals, sign * sides, strict=True):
            if side.max() > _FLAT_M:
                continue
            flat = np.abs(side) <= _FLAT_M
            half = len(points) // 2
            if flat.sum() == half and (
                (flat[:half].all() and not part.caps[0]) or (flat[half:].all() and not part.caps[1])
            ):
                continue
            corners = points[flat]
            key = tuple(np.round(normal, 5) + 0.0)
            if key not in found or len(corners) > len(found[key][1]):
                found[key] = normal, _around(corners, normal)
    return tuple(found.values())


def _around(corners: Vectors, normal: Vectors) -> Vectors:
    """Sort the corners of a flat face around its centre; points within it or its edges go."""
    middle = corners.mean(axis=0)
    along = corners[np.linalg.norm(corners - middle, axis=1) > _FLAT_M][0] - middle
    aside = np.cross(normal, along)
    angles = np.arctan2((corners - middle) @ aside, (corners - middle) @ along)
    around = list(corners[np.argsort(angles, kind='stable')])
    at, unbent = 0, 0
    while unbent < len(around) > 3:
        before, here, after = (around[(at + step) % len(around)] for step in (-1, 0, 1))
        if np.cross(here - before, after - here) @ normal > _FLAT_M**2:
            at, unbent = (at + 1) % len(around), unbent + 1
        else:
            del around[at % len(around)]
            at, unbent = (at - 1) % len(around), 0
    return np.array(around)
