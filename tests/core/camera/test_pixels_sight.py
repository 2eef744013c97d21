from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from picture_samples import at
from scipy.spatial import ConvexHull

from taxinet_ros.core.camera.camera import IMAGE_HEIGHT, IMAGE_WIDTH, intrinsics, pose
from taxinet_ros.core.camera.pixels import Sight, outlines


class Seen(NamedTuple):
    """A sight, and what it is made of."""

    rays: np.ndarray
    camera: np.ndarray
    sight: Sight

    def ground_point(self, u: float, v: float) -> np.ndarray:
        """Where the ray of a pixel meets the ground, in map [m]."""
        ray = self.rays @ (u, v, 1.0)
        return self.camera - ray * (self.camera[2] / ray[2])

    def fall(self) -> np.ndarray:
        by_column, by_row = self.sight.fall()
        return by_column[None, :] + by_row[:, None]


def seen_from(heading_deg: float, roll_deg: float = 0.0, pitch_deg: float = 0.0) -> Seen:
    _, to_optical, camera = pose(at(900.0, -3.0, heading_deg, pitch_deg, roll_deg))
    rays = to_optical.T @ np.linalg.inv(intrinsics())
    return Seen(rays, camera, Sight(rays, camera, IMAGE_HEIGHT, IMAGE_WIDTH))


SIGHTS = st.builds(seen_from, st.floats(-180, 180), st.floats(-4, 4), st.floats(-4, 4))
PIXELS = st.tuples(st.floats(0, IMAGE_WIDTH - 1), st.floats(60, IMAGE_HEIGHT - 1))


@given(SIGHTS, PIXELS, st.sampled_from([0, 1]), st.floats(0.01, 10), st.floats(-1e3, 1e3))
def test_given_a_pixel_when_its_coordinate_is_evaluated_then_it_is_the_ground_points(
    seen: Seen, pixel: tuple[float, float], axis: int, unit_m: float, origin: float
) -> None:
    u, v = pixel
    w = -1 / (seen.rays[2] @ (u, v, 1.0))
    by_uw, by_w, constant = seen.sight.coordinate(axis, unit_m, origin)
    truth = seen.ground_point(u, v)[axis] / unit_m + origin
    assert by_uw * u * w + by_w * w + constant == pytest.approx(truth, rel=1e-9, abs=1e-6)


@given(SIGHTS, st.integers(1, IMAGE_WIDTH - 2), st.integers(60, IMAGE_HEIGHT - 2),
       st.sampled_from([0, 1]))  # fmt: skip
def test_given_a_pixel_when_its_density_is_measured_then_it_is_that_of_its_larger_step(
    seen: Seen, u: int, v: int, axis: int
) -> None:
    step = 1e-3
    sides = [
        abs(seen.ground_point(u + du, v + dv)[axis] - seen.ground_point(u - du, v - dv)[axis])
        for du, dv in ((step, 0), (0, step))
    ]
    assume(max(sides) > 1e-6)
    by_column, by_row = seen.sight.density(axis, 0.1)
    density = min(by_column[u], by_row[v]) * seen.fall()[v, u] ** 2
    assert density == pytest.approx(0.1 / (max(sides) / (2 * step)), rel=2e-3)


@given(SIGHTS, st.floats(2, 60))
def test_given_a_reach_when_its_first_row_is_sought_then_only_that_and_lower_ones_are_within(
    seen: Seen, reach_m: float
) -> None:
    first = seen.sight.first_row_nearer_than(reach_m)
    middle = seen.rays @ np.stack([
        np.full(IMAGE_HEIGHT, IMAGE_WIDTH / 2), np.arange(IMAGE_HEIGHT), np.ones(IMAGE_HEIGHT)
    ])
    within = seen.camera[2] < -middle[2] * reach_m
    np.testing.assert_array_equal(within, np.arange(IMAGE_HEIGHT) >= first)


@pytest.mark.parametrize(('rays', 'camera', 'reason'), [
    (np.eye(2), np.ones(3), r'rays are \(3, 3\)'),
    (np.ones(9), np.ones(3), r'rays are \(3, 3\)'),
    (np.eye(3), np.ones(2), r'a camera is at a place \(3,\)'),
])  # fmt: skip
def test_given_arrays_of_another_shape_when_a_sight_is_made_then_it_says_so(
    rays: np.ndarray, camera: np.ndarray, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        Sight(rays, camera, IMAGE_HEIGHT, IMAGE_WIDTH)
    with pytest.raises(ValueError, match='axes 0 and 1'):
        seen_from(0.0).sight.density(2, 0.1)


SIZE = IMAGE_HEIGHT, IMAGE_WIDTH
NEAREST_M, FARTHEST_PX = 0.2, 4000.0
BOX = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
PLACES = st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-3, 12))


def box_at(x: float, y: float, z: float) -> np.ndarray:
    """Corners (8, 3) of a cube of 2 m around a place in the optical frame."""
    return BOX + np.array([x, y, z])


def seen(*parts: np.ndarray) -> list[np.ndarray]:
    starts = np.cumsum([0, *(len(part) for part in parts[:-1])]).tolist()
    return outlines(np.concatenate(parts), starts, intrinsics(), SIZE, NEAREST_M, FARTHEST_PX)


def sampled(part: np.ndarray) -> np.ndarray:
    """Points all through the hull of a part's corners, and in the picture (n, 2) [px]."""
    shares = np.random.default_rng(1).dirichlet(np.full(len(part), 0.3), 3000)
    inside = shares @ part
    inside = inside[inside[:, 2] > NEAREST_M]
    pixels = (inside @ intrinsics().T)[:, :2] / inside[:, 2:]
    return pixels[((pixels >= 0) & (pixels <= SIZE[::-1])).all(axis=1)]


@given(PLACES)
def test_given_a_box_anywhere_when_outlined_then_all_of_it_in_view_lies_within_the_outline(
    place: tuple[float, float, float],
) -> None:
    box = box_at(*place)
    found, points = seen(box), sampled(box)
    if not len(points):
        return
    (outline,) = found
    hull = cv2.convexHull(outline)
    for u, v in (points * 16).tolist():
        # A corner is rounded by half a sixteenth, and cut to a picture of pictures.
        assert cv2.pointPolygonTest(hull, (u, v), measureDist=True) > -2.0


def test_given_a_box_before_the_camera_when_outlined_then_its_corners_are_projected() -> None:
    box = box_at(0.5, 0.2, 6.0)
    (outline,) = seen(box)
    pixels = (box @ intrinsics().T)[:, :2] / box[:, 2:]
    np.testing.assert_array_equal(outline, np.rint(pixels * 16))


def test_given_a_box_around_the_camera_when_outlined_then_it_is_cut_at_the_nearest_depth() -> None:
    (outline,) = seen(BOX)
    hull = ConvexHull(outline / 16)
    # At 0.2 m the box is ten times as wide as the depth: it fills the picture and more.
    assert hull.points[:, 0].min() < 0
    assert hull.points[:, 0].max() > IMAGE_WIDTH
    assert np.abs(outline).max() <= 16 * FARTHEST_PX


@pytest.mark.parametrize('place', [(0, 0, -5), (60, 0, 5), (-60, 0, 5), (0, 40, 5), (0, -40, 5)])
def test_given_a_box_out_of_view_when_outlined_then_there_is_none(place: tuple[int, ...]) -> None:
    assert seen(box_at(*place)) == []


def test_given_parts_when_outlined_then_each_in_view_is_told_in_their_order() -> None:
    near, aside, far = box_at(0, 0, 5), box_at(60, 0, 5), box_at(0, 0, 9)[:5]
    found = seen(near, aside, far)
    assert [len(outline) for outline in found] == [8, 5]
    np.testing.assert_array_equal(found[0], seen(near)[0])


@given(arrays.arrays(np.float64, (6, 3), elements=st.floats(-20, 20)))
def test_given_any_corners_when_outlined_then_nothing_is_beyond_the_farthest_pixel(
    corners: np.ndarray,
) -> None:
    for outline in seen(corners):
        assert np.abs(outline).max() <= 16 * FARTHEST_PX


@pytest.mark.parametrize(('corners', 'starts', 'matrix', 'reason'), [
    (BOX[:, :2], [0], np.eye(3), r'corners are \(N, 3\)'),
    (BOX, [0], np.eye(2), r'\(3, 3\)'),
    (BOX, [4, 0], np.eye(3), 'one after the other'),
    (BOX, [0, 9], np.eye(3), 'within the corners'),
    (BOX, [-1, 4], np.eye(3), 'within the corners'),
])  # fmt: skip
def test_given_what_does_not_fit_when_outlined_then_it_says_which(
    corners: np.ndarray, starts: list[int], matrix: np.ndarray, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        outlines(corners, starts, matrix, SIZE, NEAREST_M, FARTHEST_PX)
