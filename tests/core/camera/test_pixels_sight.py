from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from picture_samples import at

from taxinet_ros.core.camera.camera import IMAGE_HEIGHT, IMAGE_WIDTH, intrinsics, pose
from taxinet_ros.core.camera.pixels import Sight


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
