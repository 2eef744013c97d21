"""Others on the ground in the picture: marks, shadows and solids, in the scene's light and haze.

Marks lie in the ground's texture, below every shade. Shadows fall along the sun's rays; a faint
one right under a body stands for the sky that it hides. Solids are drawn from far to near: faces
that look at the camera, each in one tone, by its angle to sun and sky. Edges are drawn several
times finer than the picture and averaged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.camera.atmosphere import Atmosphere
from taxinet_ros.core.camera.light import GAMMA, CloudShade, Light, display_code
from taxinet_ros.core.traffic.shapes import PAINT, UNSEEN, body, daylight_colour, face_normal
from taxinet_ros.core.traffic.traffic import HOLD_LINE, GroundObject, Holds, Pose, Traffic

Vectors = NDArray[np.float64]
Picture = NDArray[np.uint8]

_NEAREST_M = 0.3
_FARTHEST_PX = 1e7
"""Beyond this, coordinates are limited one by one, as they are integers; polygons that near ones
have beside the camera are cut off beside the picture before."""
_BESIDE_PX = 4000.0
_FARTHEST_M = 3000.0
_SHIFT = 4
_FINENESS = ((2500, 8), (20_000, 4))
"""Most pixels of a part of the picture, and how many times finer its edges are drawn there."""
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
        self._traffic, self._light, self._clouds = traffic, light, clouds
        self._atmosphere, self._gain = atmosphere, gain
        self._intrinsics, self._size = intrinsics, size
        self._to_ground = np.eye(3) if casts else None
        if self._to_ground is not None:
            self._to_ground[:, 2] -= light.sun / light.sun[2]
        self._meshes = {
            id(one): _Mesh(one, light) for one in traffic.solids
        }

    def paint_marks(
        self, ground: Picture, to_optical: Vectors, camera: Vectors
    ) -> None:
        """Paint the marks on the unlit ground (height, width, 3), in place.

        Args:
            ground: its daylight colours times the gain.
            to_optical: rotation from ``map`` to the camera's optical frame (3, 3).
            camera: the camera's place in ``map`` (3,).
        """
        for mark in self._traffic.marks:
            pose = mark.pose_at(0)
            paint = np.array(daylight_colour(mark.colour)) * self._gain
            for polygons, opacity in _MARKS[mark.kind]:
                scale = mark.size.length_m, mark.size.width_m
                flat = [
                    np.column_stack([np.array(one) * scale, np.zeros(len(one))]) for one in polygons
                ]
                found = self._coverage([
                    _to_optical(_placed(part, pose), to_optical, camera) for part in flat
                ])
                if found is not None:
                    rows, columns, mask = found
                    _blend(ground[rows, columns], mask, paint, opacity)

    def shade(
        self, ground: Picture, to_optical: Vectors, camera: Vectors, stamp_ns: int,
        shaded: NDArray[np.uint8], held: Holds,
    ) -> None:
        """Darken the ground in the solids' shadows, in place.

        Args:
            ground: as for :meth:`paint_marks`.
            to_optical: rotation from ``map`` to the camera's optical frame (3, 3).
            camera: the camera's place in ``map`` (3,).
            stamp_ns: simulated time [ns].
            shaded: (height, width) where another shadow is already, 255 for full; no ground is
                darkened twice. Shadows are added.
            held: those that the aircraft has held.
        """
        for one, pose in self._traffic.solids_at(stamp_ns, held):
            parts = [_placed(part, pose) for part in self._meshes[id(one)].parts]
            away_m = max(math.hypot(pose.x_m - camera[0], pose.y_m - camera[1]), _NEAREST_M)
            low = [_flattened(part) for part in parts if part[:, 2].min() < _CLEAR_UNDER_M]
            focal_px = self._intrinsics[0, 0]
            found = self._coverage(
                [_to_optical(part, to_optical, camera) for part in low],
                blur_px=0.3 * focal_px / away_m,
            )
            if found is not None:
                rows, columns, mask = found
                pixels.tint_masked(ground[rows, columns], mask, (_SKY_HIDDEN,) * 3)
            if self._to_ground is None:
                continue
            fall = [_to_optical(part @ self._to_ground.T, to_optical, camera) for part in parts]
            throw_px = focal_px * one.size.height_m * self._light.sun_width_rad / away_m
            found = self._coverage(fall, blur_px=0.5 * throw_px)
            if found is not None:
                rows, columns, mask = found
                before = shaded[rows, columns]
                more = cv2.subtract(mask, before)
                np.maximum(before, mask, out=before)
                depth = self._clouds.shadow_depth(pose.x_m, pose.y_m)
                pixels.tint_masked(ground[rows, columns], np.ascontiguousarray(more), depth)

    def draw_solids(
        self, picture: Picture, to_optical: Vectors, camera: Vectors, stamp_ns: int, held: Holds
    ) -> None:
        """Draw the solids over a picture of ground and sky (height, width, 3), in place."""
        placed = self._traffic.solids_at(stamp_ns, held)
        away = [math.hypot(pose.x_m - camera[0], pose.y_m - camera[1]) for _, pose in placed]
        for number in sorted(range(len(placed)), key=lambda k: (-away[k], k)):
            if away[number] < _FARTHEST_M:
                self._draw(picture, *placed[number], away[number], to_optical, camera)

    def _draw(
        self, picture: Picture, one: GroundObject, pose: Pose, away_m: float,
        to_optical: Vectors, camera: Vectors,
    ) -> None:
        mesh = self._meshes[id(one)]
        turn = _turn(pose)
        corners = mesh.corners @ turn.T + (pose.x_m, pose.y_m, 0.0)
        optical = (corners - camera) @ to_optical.T
        if optical[:, 2].max() <= _NEAREST_M:
            return
        place = np.array([pose.x_m, pose.y_m, 0.0])
        normals = mesh.normals @ turn.T
        seen = (normals * (camera - place - mesh.middles @ turn.T)).sum(axis=1) > 0
        # Group after group from far to near, and in each its parts in their order.
        away = np.hypot(*(mesh.group_middles @ turn.T + place - camera)[:, :2].T)
        order = np.lexsort((np.arange(len(seen)), -away[mesh.group_of]))
        order = order[seen[order]]
        share = self._clouds.sun_share(pose.x_m, pose.y_m)
        codes = _face_codes(self._light, mesh.albedos[order], normals[order], share)
        kept, added = self._atmosphere.veil_at(away_m)
        faces = [mesh.faces[k] for k in order.tolist()]
        if optical[:, 2].min() < _NEAREST_M:
            optical, faces = _before_camera(optical, faces)
        if faces:
            image = optical @ self._intrinsics.T
            points = np.clip(image[:, :2] / image[:, 2:], -_FARTHEST_PX, _FARTHEST_PX)
            if np.abs(points).max() > _BESIDE_PX:
                polygons = [beside_picture(points[face], self._size) for face in faces]
                ends = np.cumsum([len(one) for one in polygons]).tolist()
                faces = [
                    np.arange(end - len(one), end)
                    for one, end in zip(polygons, ends, strict=True)
                ]
                points = np.concatenate(polygons)
            if len(points):
                _draw_faces(picture, points, faces, codes * kept + added, self._size)

    def _coverage(
        self, parts: Sequence[Vectors], blur_px: float = 0.0
    ) -> tuple[slice, slice, NDArray[np.uint8]] | None:
        """How much of each pixel convex parts cover, 0..255; None if they are not in view.

        Args:
            parts: corners (n, 3) in the optical frame.
            blur_px: width of the soft edge.
        """
        if not parts:
            return None
        starts = np.cumsum([0, *(len(part) for part in parts[:-1])]).tolist()
        found = pixels.outlines(
            np.concatenate(parts), starts, self._intrinsics, self._size, _NEAREST_M, _FARTHEST_PX
        )
        polygons = [
            beside_picture(
                np.asarray(cv2.convexHull(part)[:, 0], np.float64) / (1 << _SHIFT), self._size
            )
            for part in found
        ]
        polygons = [one for one in polygons if len(one)]
        margin = min(1 + 2 * math.ceil(0.5 * blur_px), 31)
        area = _area(polygons, self._size, margin + 1)
        if area is None:
            return None
        rows, columns = area
        fine = _fineness(rows, columns)
        height, width = rows.stop - rows.start, columns.stop - columns.start
        mask = np.zeros((height * fine, width * fine), np.uint8)
        for polygon in polygons:
            cv2.fillConvexPoly(mask, _fine_points(polygon, area, fine), (255,), shift=_SHIFT)
        small = cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA)
        if margin > 1:
            small = cv2.blur(small, (margin, margin))
        return rows, columns, np.asarray(small, np.uint8)


class _Mesh:
    """Faces of a solid in its own frame, with their albedos."""

    def __init__(self, one: GroundObject, light: Light) -> None:
        parts = [part for part in body(one.kind, one.size) if part.colour != UNSEEN]
        self.parts = [part.corners for part in parts]
        self.corners = np.concatenate(self.parts)
        starts = np.cumsum([0, *(len(part.corners) for part in parts[:-1])]).tolist()
        self.faces = [
            np.array([start + k for k in face])
            for start, part in zip(starts, parts, strict=True) for face in part.faces
        ]
        groups = np.cumsum([not part.detail for part in parts]) - 1
        self.group_of = np.repeat(groups, [len(part.faces) for part in parts])
        self.group_middles = np.array([
            np.concatenate([
                part.corners for part, group in zip(parts, groups, strict=True) if group == number
            ]).mean(axis=0)
            for number in range(groups[-1] + 1)
        ])
        self.middles = np.array([self.corners[face].mean(axis=0) for face in self.faces])
        self.normals = np.array([face_normal(self.corners[face]) for face in self.faces])
        wet = 1 - 0.15 * light.wetness
        colours = [
            daylight_colour(one.colour if part.colour == PAINT else part.colour)
            for part in parts for _ in part.faces
        ]
        self.albedos = wet * (np.array(colours) / 255) ** GAMMA


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


def _draw_faces(
    picture: Picture, points: Vectors, faces: Sequence[NDArray[np.intp]], codes: Vectors,
    size: tuple[int, int],
) -> None:
    """Fill polygons of pixels one over the other.

    Args:
        picture: (height, width, 3), changed in place.
        points: (n, 2) pixels.
        faces: indices of the points of each polygon.
        codes: display codes of each (faces, 3).
        size: height and width of the picture [px].
    """
    area = _area([points[np.concatenate(faces)]], size, 1)
    if area is None:
        return
    rows, columns = area
    fine = _fineness(rows, columns)
    height, width = rows.stop - rows.start, columns.stop - columns.start
    behind = picture[rows, columns]
    canvas = cv2.resize(
        behind, (width * fine, height * fine), interpolation=cv2.INTER_NEAREST
    )
    corners = _fine_points(points, area, fine)
    for face, code in zip(faces, np.rint(codes).tolist(), strict=True):
        if len(face):
            cv2.fillConvexPoly(canvas, corners[face], code, shift=_SHIFT)
    behind[:] = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)


def beside_picture(polygon: Vectors, size: tuple[int, int]) -> Vectors:
    """Cut a convex polygon of pixels (n, 2) off far beside a picture (Sutherland and Hodgman)."""
    if not len(polygon) or np.abs(polygon).max() <= _BESIDE_PX:
        return polygon
    height, width = size
    for axis, sign, most in (
        (0, 1, width + _BESIDE_PX), (0, -1, _BESIDE_PX), (1, 1, height + _BESIDE_PX),
        (1, -1, _BESIDE_PX),
    ):
        kept = []
        for here, there in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            over, next_over = sign * here[axis] - most, sign * there[axis] - most
            if over <= 0:
                kept.append(here)
            if (over <= 0) != (next_over <= 0):
                kept.append(here + over / (over - next_over) * (there - here))
        polygon = np.array(kept).reshape(-1, 2)
    return polygon


def _area(
    polygons: Sequence[NDArray[np.float64]], size: tuple[int, int], margin: int
) -> tuple[slice, slice] | None:
    """Rows and columns of the picture that polygons may touch; None if there are none."""
    points = np.concatenate(polygons) if polygons else np.empty((0, 2))
    if not len(points):
        return None
    (left, top), (right, bottom) = points.min(axis=0), points.max(axis=0)
    rows = slice(max(math.floor(top) - margin, 0), min(math.ceil(bottom) + margin + 1, size[0]))
    columns = slice(max(math.floor(left) - margin, 0), min(math.ceil(right) + margin + 1, size[1]))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return None
    return rows, columns


def _fineness(rows: slice, columns: slice) -> int:
    count = (rows.stop - rows.start) * (columns.stop - columns.start)
    return next((fine for most, fine in _FINENESS if count <= most), 2)


def _fine_points(
    polygon: NDArray[np.float64], area: tuple[slice, slice], fine: int
) -> NDArray[np.int32]:
    """Corners on a finer canvas, in sixteenths; pixel centres are whole numbers on both."""
    start = np.array([area[1].start, area[0].start])
    points = ((polygon - start + 0.5) * fine - 0.5) * (1 << _SHIFT)
    return np.asarray(np.rint(points), np.int32)


def _blend(ground: Picture, mask: NDArray[np.uint8], paint: Vectors, opacity: float) -> None:
    share = (opacity / 255) * mask[:, :, None].astype(np.float32)
    mixed = ground + share * (paint.astype(np.float32) - ground)
    ground[:] = np.rint(mixed).astype(np.uint8)


def _turn(pose: Pose) -> Vectors:
    cos, sin = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _placed(points: Vectors, pose: Pose) -> Vectors:
    """Points (n, 3) of an object's frame in ``map``."""
    return points @ _turn(pose).T + (pose.x_m, pose.y_m, 0.0)


def _to_optical(points: Vectors, to_optical: Vectors, camera: Vectors) -> Vectors:
    return np.ascontiguousarray((points - camera) @ to_optical.T)


def _flattened(points: Vectors) -> Vectors:
    return points * (1.0, 1.0, 0.0)


def _before_camera(
    optical: Vectors, faces: Sequence[NDArray[np.intp]]
) -> tuple[Vectors, list[NDArray[np.intp]]]:
    """Corners (n, 3) and faces, cut off at the nearest depth (Sutherland and Hodgman).

    Faces keep their number; one that is wholly behind the camera has no corner.
    """
    corners: list[Vectors] = []
    found: list[NDArray[np.intp]] = []
    for face in faces:
        polygon, first = optical[face], len(corners)
        for here, there in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            inside = here[2] >= _NEAREST_M
            if inside:
                corners.append(here)
            if inside != (there[2] >= _NEAREST_M):
                share = (_NEAREST_M - here[2]) / (there[2] - here[2])
                corners.append(here + share * (there - here))
        found.append(np.arange(first, len(corners)))
    return np.array(corners).reshape(-1, 3), found if corners else []
