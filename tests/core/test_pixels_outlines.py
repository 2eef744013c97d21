from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.spatial import ConvexHull

from taxinet_ros.core.camera import IMAGE_HEIGHT, IMAGE_WIDTH, intrinsics
from taxinet_ros.core.pixels import outlines

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
