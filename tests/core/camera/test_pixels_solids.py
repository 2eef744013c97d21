"""What stands or lies on the ground, projected, drawn and measured: as NumPy and OpenCV do it."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.rig.camera_model import rotation
from taxinet_ros.core.rig.catalogue import WING
from taxinet_ros.core.traffic.shapes import body, face_normal, hull
from taxinet_ros.core.traffic.traffic import KINDS

SIZE = HEIGHT, WIDTH = 200, 360
MATRIX = WING.intrinsics
NEAREST_M, FARTHEST_PX, BESIDE_PX = 0.3, 1e7, 4000.0
CAMERA = pixels.Pinhole(MATRIX, SIZE, NEAREST_M, FARTHEST_PX)
BODIES = [body(kind, known.size) for kind, known in KINDS.items() if known.solid]
DOWN, UP = np.diag((1.0, 1.0, 0.0)), np.eye(3)
SLANTED = np.array([(1.0, 0.0, -2.3), (0.0, 1.0, 0.7), (0.0, 0.0, 0.0)])
Drawing = tuple[slice, slice, int, list[np.ndarray]]

POSES = st.tuples(st.floats(-8, 40), st.floats(-12, 12), st.floats(-4, 4))
EYES = st.builds(
    lambda yaw, pitch, roll, height: (
        WING.body_to_optical @ rotation(roll, pitch, yaw).T, np.array((0.0, 0.0, height))
    ),
    st.floats(-3, 3), st.floats(-0.2, 0.2), st.floats(-0.1, 0.1), st.floats(0.5, 4),
)


def joined(parts: list[np.ndarray]) -> tuple[np.ndarray, list[int]]:
    return np.concatenate(parts), np.cumsum([0, *(len(one) for one in parts[:-1])]).tolist()


def turn_of(heading_rad: float) -> np.ndarray:
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    return np.array([(cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)])


def clipped(polygon: np.ndarray, axis: int, limit: float, sign: int) -> np.ndarray:
    """What of a convex polygon is at sign * axis <= limit (Sutherland and Hodgman)."""
    kept = []
    for here, there in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        over, next_over = sign * here[axis] - limit, sign * there[axis] - limit
        if over <= 0:
            kept.append(here)
        if (over <= 0) != (next_over <= 0):
            kept.append(here + over / (over - next_over) * (there - here))
    return np.array(kept).reshape(-1, polygon.shape[1])


def beside(polygon: np.ndarray) -> np.ndarray:
    if len(polygon) and np.abs(polygon).max() > BESIDE_PX:
        for axis, sign, most in ((0, 1, WIDTH), (0, -1, 0), (1, 1, HEIGHT), (1, -1, 0)):
            polygon = clipped(polygon, axis, most + BESIDE_PX, sign)
    return polygon


def drawing(polygons: list[np.ndarray], margin: int) -> Drawing | None:
    points = np.concatenate([np.empty((0, 2)), *polygons])
    if not len(points):
        return None
    (left, top), (right, bottom) = points.min(axis=0), points.max(axis=0)
    rows = slice(max(math.floor(top) - margin, 0), min(math.ceil(bottom) + margin + 1, HEIGHT))
    columns = slice(max(math.floor(left) - margin, 0), min(math.ceil(right) + margin + 1, WIDTH))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return None
    count = (rows.stop - rows.start) * (columns.stop - columns.start)
    fine = 8 if count <= 2500 else 4 if count <= 20_000 else 2
    start = np.array([columns.start, rows.start])
    return rows, columns, fine, [
        np.rint(((one - start + 0.5) * fine - 0.5) * 16).astype(np.int32) for one in polygons
    ]


def outline(part: np.ndarray) -> np.ndarray | None:
    """The hull of a convex part in the optical frame; None if it is out of view."""
    u, v = (part[:, k] * MATRIX[k, k] + part[:, 2] * MATRIX[k, 2] for k in (0, 1))
    depth = part[:, 2]
    sides = u, v, WIDTH * depth - u, HEIGHT * depth - v, depth - NEAREST_M
    if min(side.max() for side in sides) <= 0:
        return None
    ahead, behind = part[depth >= NEAREST_M], part[depth < NEAREST_M]
    seen = np.array([*ahead, *(
        near + (NEAREST_M - near[2]) / (far[2] - near[2]) * (far - near)
        for near in behind for far in ahead
    )])
    scaled = seen[:, :2] * MATRIX[[0, 1], [0, 1]] + seen[:, 2:] * MATRIX[:2, 2]
    fine = np.rint(16 * np.clip(scaled / seen[:, 2:], -FARTHEST_PX, FARTHEST_PX))
    return beside(cv2.convexHull(fine.astype(np.int32))[:, 0] / 16)


def canvas(found: Drawing) -> np.ndarray:
    rows, columns, fine, polygons = found
    size = (rows.stop - rows.start) * fine, (columns.stop - columns.start) * fine
    drawn = np.zeros(size, np.uint8)
    for polygon in polygons:
        cv2.fillConvexPoly(drawn, polygon, (255,), shift=4)
    return drawn


@given(st.sampled_from(BODIES), POSES, EYES, st.sampled_from([DOWN, UP, SLANTED]),
       st.integers(1, 32))  # fmt: skip
def test_given_a_body_anywhere_when_covered_then_it_is_drawn_as_the_reference_to_the_bit(
    parts: tuple, pose: tuple, eye: tuple[np.ndarray, np.ndarray], cast: np.ndarray, margin: int
) -> None:
    to_optical, camera = eye
    corners = [part.corners for part in parts]
    hulls = [
        outline((((one @ turn_of(pose[2]).T + (*pose[:2], 0.0)) @ cast.T) - camera) @ to_optical.T)
        for one in corners
    ]
    wanted = drawing([one for one in hulls if one is not None and len(one)], margin)
    found = CAMERA.cover(*joined(corners), pose, cast, to_optical, camera, margin)
    assert (found is None) == (wanted is None)
    if found is not None and wanted is not None:
        assert found[:3] == wanted[:3]
        np.testing.assert_array_equal(canvas(found), canvas(wanted))


@given(st.sampled_from(BODIES), POSES, EYES)
def test_given_a_body_anywhere_when_its_faces_are_sought_then_they_are_the_references_to_the_bit(
    parts: tuple, pose: tuple, eye: tuple[np.ndarray, np.ndarray]
) -> None:
    to_optical, camera = eye
    faces = [part.corners[list(face)] for part in parts for face in part.faces]
    groups = [part.corners.mean(axis=0) for part in parts for _ in part.faces]
    middles = np.array([one.mean(axis=0) for one in faces])
    normals = np.array([face_normal(one) for one in faces])
    turn, place = turn_of(pose[2]), np.array((*pose[:2], 0.0))
    seen = (normals @ turn.T * (camera - place - middles @ turn.T)).sum(axis=1) > 0
    away = np.hypot(*(np.array(groups) @ turn.T + place - camera)[:, :2].T)
    polygons, numbers = [], []
    for number in np.lexsort((np.arange(len(faces)), -away)).tolist():
        optical = ((faces[number] @ turn.T + place) - camera) @ to_optical.T
        before = []
        for here, there in zip(optical, np.roll(optical, -1, axis=0), strict=True):
            if here[2] >= NEAREST_M:
                before.append(here)
            if (here[2] >= NEAREST_M) != (there[2] >= NEAREST_M):
                before.append(here + (NEAREST_M - here[2]) / (there[2] - here[2]) * (there - here))
        image = np.array(before).reshape(-1, 3) @ MATRIX.T
        polygon = beside(np.clip(image[:, :2] / image[:, 2:], -FARTHEST_PX, FARTHEST_PX))
        if seen[number] and len(polygon):
            polygons.append(polygon)
            numbers.append(number)
    wanted = drawing(polygons, 1)
    about = np.stack([middles, normals, np.array(groups)], axis=1).reshape(-1, 3)
    found = CAMERA.faces(*joined(faces), about, pose, to_optical, camera)
    assert (found is None) == (wanted is None)
    if found is not None and wanted is not None:
        assert found[1] == numbers
        assert found[0][:3] == wanted[:3]
        for one, other in zip(found[0][3], wanted[3], strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize('place', [(-40, 0), (10, 60), (10, -90)])
def test_given_a_body_out_of_view_when_covered_then_there_is_nothing(place: tuple) -> None:
    cone = BODIES[2][0].corners
    eye = WING.body_to_optical, np.array((0.0, 0.0, 1.5)), 1
    assert CAMERA.cover(cone, [0], (*place, 0.0), UP, *eye) is None


BOX = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


@pytest.mark.parametrize(('corners', 'starts', 'cast', 'reason'), [
    (BOX[:, :2], [0], UP, r'corners are \(N, 3\)'),
    (BOX, [4, 0], UP, 'one after the other'),
    (BOX, [0, 9], UP, 'within the corners'),
    (BOX, [-1, 4], UP, 'within the corners'),
    (BOX, [0], np.eye(2), r'casts points on the ground is \(3, 3\)'),
])  # fmt: skip
def test_given_what_does_not_fit_when_covered_then_it_says_which(
    corners: np.ndarray, starts: list[int], cast: np.ndarray, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        CAMERA.cover(corners, starts, (5.0, 0.0, 0.0), cast, np.eye(3), np.zeros(3), 1)
    with pytest.raises(ValueError, match='three points about each face'):
        CAMERA.faces(BOX, [0, 4], BOX[:5], (5.0, 0.0, 0.0), np.eye(3), np.zeros(3))


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 4, 8]), st.booleans())
def test_given_a_canvas_when_averaged_then_it_is_what_opencv_makes_of_it(
    seed: int, finer: int, is_mask: bool
) -> None:
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, 40, 2).tolist()
    fine = height * finer, width * finer
    most = int(rng.choice([2, 256]))  # few codes make many ties
    if is_mask:
        codes = rng.integers(0, most, fine, np.uint8)
        found = np.empty((height, width), np.uint8)
        pixels.average(codes, found)
    else:
        picture = rng.integers(0, most, (height, width + 3, 3), np.uint8)
        found, drawn = picture[:, 2:-1], rng.random(fine) < rng.random()
        codes = cv2.resize(found, fine[::-1], interpolation=cv2.INTER_NEAREST)
        canvas = np.zeros((*fine, 4), np.uint8)
        canvas[drawn] = (*rng.integers(0, most, 3, np.uint8), 1)
        codes[drawn] = canvas[drawn][:, :3]
        pixels.average(canvas, found)
    wanted = cv2.resize(codes, (width, height), interpolation=cv2.INTER_AREA)
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(('canvas', 'picture', 'reason'), [
    ((8, 8, 3), (4, 4, 3), 'its canvas four'), ((8, 8, 4), (4, 4), 'its canvas four'),
    ((8, 12, 4), (4, 4, 3), 'as many times as high'), ((9, 9), (3, 3), '2, 4 or 8 times'),
])  # fmt: skip
def test_given_a_canvas_that_does_not_fit_when_averaged_then_it_says_so(
    canvas: tuple, picture: tuple, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        pixels.average(np.zeros(canvas, np.uint8), np.zeros(picture, np.uint8))


@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.tuples(*[st.floats(0, 255)] * 3))
def test_given_a_mask_when_paint_is_blended_then_it_is_that_of_single_precision(
    seed: int, opacity: float, paint: tuple[float, float, float]
) -> None:
    rng = np.random.default_rng(seed)
    picture = rng.integers(0, 256, (5, 40, 3), np.uint8)
    part, mask = picture[:, 3:], rng.integers(0, 256, (5, 37), np.uint8)
    share = np.float32(opacity / 255) * mask[:, :, None].astype(np.float32)
    wanted = np.rint(part + share * (np.array(paint, np.float32) - part)).astype(np.uint8)
    pixels.blend_masked(part, mask, paint, opacity)
    np.testing.assert_array_equal(part, wanted)


def gap_m(one: np.ndarray, other: np.ndarray) -> float:
    """Between two convex polygons (n, 2), counter-clockwise; 0 where they overlap."""
    edges, others = np.roll(one, -1, axis=0) - one, np.roll(other, -1, axis=0) - other

    def sides(start: np.ndarray, along: np.ndarray, points: np.ndarray) -> np.ndarray:
        x, y = (points[None] - start[:, None]).transpose(2, 0, 1)
        return np.asarray(along[:, None, 0] * y - along[:, None, 1] * x)

    def least2(start: np.ndarray, along: np.ndarray, points: np.ndarray) -> float:
        x, y = (points[None] - start[:, None]).transpose(2, 0, 1)
        dx, dy = along[:, 0, None], along[:, 1, None]
        part = np.clip((x * dx + y * dy) / (dx * dx + dy * dy), 0, 1)
        return float(((x - part * dx) ** 2 + (y - part * dy) ** 2).min())

    apart = sides(one, edges, other) * sides(one, edges, other + others) < 0
    across = sides(other, others, one) * sides(other, others, one + edges) < 0
    within = [(sides(one, edges, other) >= 0).all(axis=0).any(),
              (sides(other, others, one) >= 0).all(axis=0).any()]
    if any(within) or (apart & across.T).any():
        return 0.0
    return math.sqrt(min(least2(one, edges, other), least2(other, others, one)))


def flat(polygon: np.ndarray) -> np.ndarray:
    return np.pad(polygon, ((0, 0), (0, 1)))


@given(st.integers(0, 2**32 - 1), st.floats(0, 12))
def test_given_polygons_when_their_gap_is_measured_then_it_is_the_references_to_the_bit(
    seed: int, away_m: float
) -> None:
    rng = np.random.default_rng(seed)
    others = [np.array(hull(rng.normal(rng.normal(0, 4, 2), 1, (7, 2)))) for _ in range(3)]
    polygon = np.array(hull(rng.normal((away_m, 0), 2, (6, 2))))
    wanted = min(gap_m(one, polygon) for one in others)
    assert pixels.gap(*joined([flat(one) for one in others]), flat(polygon)) == wanted


@pytest.mark.parametrize(('x', 'y', 'half', 'wanted_m'), [
    (5, 0, (1, 1), 3), (5, 6, (1, 1), 5), (0.5, 0, (1, 1), 0), (0, 0, (0.1, 0.1), 0),
    (0, 0, (9, 0.1), 0),
])  # fmt: skip
def test_given_two_boxes_when_their_gap_is_measured_then_it_is_between_them_or_nothing(
    x: float, y: float, half: tuple[float, float], wanted_m: float
) -> None:
    square = np.array([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)])
    other = square * (*half, 0.0) + np.array((x, y, 5.0))
    assert pixels.gap(square, [0], other) == wanted_m
    assert pixels.gap(other, [0], square) == wanted_m
