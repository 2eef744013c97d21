"""The own aircraft's shadow mask, compared with one that NumPy and OpenCV alone make."""

from __future__ import annotations

import math
from itertools import product

import cv2
import numpy as np
import pytest
from picture_samples import at

from taxinet_ros.core.camera.airframe import OwnShadow
from taxinet_ros.core.camera.camera import pose
from taxinet_ros.core.camera.pixels import Shadow
from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.rig.catalogue import find_aircraft, find_camera

RIGS = list(product(('caravan', 'c172p'), ('wing', 'nose', 'strut', 'tail')))
NEAREST_M, FARTHEST_PX = 0.2, 4000.0
Mask = tuple[slice, slice, np.ndarray]


def clipped(part: np.ndarray) -> np.ndarray:
    """What of the lines between the corners of a part lies before the camera."""
    ahead, behind = part[part[:, 2] >= NEAREST_M], part[part[:, 2] < NEAREST_M]
    cuts = [
        near + (NEAREST_M - near[2]) / (far[2] - near[2]) * (far - near)
        for near in behind for far in ahead
    ]
    return np.array([*ahead, *cuts])


def reference(
    parts: list[np.ndarray], sun: np.ndarray, side_px: int, camera: CameraModel,
    where: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
) -> Mask | None:
    """Mask of the parts' shadows, as :meth:`.OwnShadow.mask` gives it."""
    body, place, to_optical, eye = where
    matrix, (height, width), *_ = camera.inner_view
    mask, corners = np.zeros((height, width), np.uint8), []
    flatten = np.eye(3)
    flatten[:, 2] -= sun / sun[2]
    turn = to_optical @ flatten
    for part in parts:
        optical = part @ (turn @ body).T + (turn @ place - to_optical @ eye)
        u, v = optical[:, 0] * matrix[0, 0] + optical[:, 2] * matrix[0, 2], \
            optical[:, 1] * matrix[1, 1] + optical[:, 2] * matrix[1, 2]
        depth = optical[:, 2]
        sides = u, v, width * depth - u, height * depth - v, depth - NEAREST_M
        if min(side.max() for side in sides) <= 0:
            continue
        seen = clipped(optical)
        scaled = seen[:, :2] * matrix[[0, 1], [0, 1]] + seen[:, 2:] * matrix[:2, 2]
        fine = np.rint(16 * np.clip(scaled / seen[:, 2:], -FARTHEST_PX, FARTHEST_PX))
        corners.append(fine.astype(np.int32))
        hull = cv2.convexHull(corners[-1])
        cv2.fillConvexPoly(mask, hull, (255,), lineType=cv2.LINE_AA, shift=4)
    if not corners:
        return None
    left, top, wide, high = cv2.boundingRect(np.concatenate(corners) >> 4)
    rows = slice(max(top - side_px, 0), min(top + high + side_px, height))
    columns = slice(max(left - side_px, 0), min(left + wide + side_px, width))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return None
    return rows, columns, cv2.blur(mask[rows, columns], (side_px, side_px))


def shades(aircraft: AircraftModel) -> list[np.ndarray]:
    return [part.points for part in aircraft.outline if part.shades]


@pytest.mark.parametrize(('aircraft_name', 'camera_name'), RIGS)
def test_given_any_sun_and_pose_when_the_shadow_is_cast_then_its_mask_is_the_references_to_the_bit(
    aircraft_name: str, camera_name: str
) -> None:
    aircraft, camera = find_aircraft(aircraft_name), find_camera(camera_name)
    rng, found = np.random.default_rng(47), 0
    matrix, (height, width), *_ = camera.inner_view
    for _ in range(200):
        elevation, azimuth = rng.uniform(math.radians(1), math.pi / 2), rng.uniform(0, math.tau)
        flat = math.cos(elevation)
        sun = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])
        width_rad = rng.choice([0.0093, 0.03, 0.08])
        parts = [part for part in aircraft.outline if part.shades]
        shadow = OwnShadow(parts, sun, width_rad, matrix, height, width)
        side_px = 1 + 2 * math.ceil(0.25 * matrix[0, 0] * width_rad)
        state = at(rng.uniform(0, 2500), rng.uniform(-20, 20), *rng.normal(0, (60, 2, 2)))
        body, to_optical, eye = pose(state, camera)
        place = state.x_m, state.y_m, state.z_m
        got = shadow.mask(body, place, to_optical, eye)
        expected = reference(
            shades(aircraft), sun, side_px, camera, (body, np.array(place), to_optical, eye)
        )
        assert (got is None) == (expected is None)
        if got is None or expected is None:
            continue
        found += got[2].any()
        assert got[:2] == (expected[0], expected[1])
        np.testing.assert_array_equal(got[2], expected[2])
    assert found > 5


@pytest.mark.parametrize(('corners', 'starts', 'body', 'reason'), [
    (np.zeros((4, 2)), [0], np.eye(3), r'corners are \(N, 3\)'),
    (np.zeros((4, 3)), [0, 5], np.eye(3), 'within the corners'),
    (np.zeros((4, 3)), [0], np.eye(2), r'a rotation is \(3, 3\)'),
])  # fmt: skip
def test_given_what_does_not_fit_when_a_shadow_is_cast_then_it_says_which(
    corners: np.ndarray, starts: list[int], body: np.ndarray, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        Shadow(
            corners, starts, (0.0, 0.0, 1.0), np.eye(3), (200, 360), NEAREST_M, FARTHEST_PX, 3
        ).outlines(body, (0.0, 0.0, 1.5), np.eye(3), np.array([0.0, 0.0, 2.0]))
