from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from taxinet_ros.core.camera import IMAGE_HEIGHT, IMAGE_WIDTH, intrinsics, pose
from taxinet_ros.core.ground_sight import Sight
from taxinet_ros.core.types import AircraftState

ROWS = np.arange(IMAGE_HEIGHT, dtype=np.float64)[:, None]
COLUMNS = np.arange(IMAGE_WIDTH, dtype=np.float64)[None, :]


def sight(heading_deg: float, roll_deg: float = 0.0, pitch_deg: float = 0.0) -> Sight:
    state = AircraftState(
        x_m=900.0, y_m=-3.0, z_m=1.55, roll_rad=math.radians(roll_deg),
        pitch_rad=math.radians(pitch_deg), yaw_rad=math.radians(heading_deg), speed_mps=5.0,
        yaw_rate_radps=0.0,
    )  # fmt: skip
    _, to_optical, camera = pose(state)
    rays = to_optical.T @ np.linalg.inv(intrinsics())
    return Sight(rays=rays.tolist(), camera=camera.tolist(), rows=ROWS, columns=COLUMNS)


SIGHTS = st.builds(sight, st.floats(-180, 180), st.floats(-4, 4), st.floats(-4, 4))
PIXELS = st.tuples(st.floats(0, IMAGE_WIDTH - 1), st.floats(60, IMAGE_HEIGHT - 1))


def ground_point(seen: Sight, u: float, v: float) -> np.ndarray:
    """Where the ray of a pixel meets the ground, in map [m]."""
    ray = np.array(seen.rays) @ (u, v, 1.0)
    return np.array(seen.camera) - ray * (seen.camera[2] / ray[2])


def fall(seen: Sight) -> np.ndarray:
    by_column, by_row = seen.fall()
    return by_column + by_row


@given(SIGHTS, PIXELS, st.sampled_from([0, 1]), st.floats(0.01, 10), st.floats(-1e3, 1e3))
def test_given_a_pixel_when_its_coordinate_is_evaluated_then_it_is_the_ground_points(
    seen: Sight, pixel: tuple[float, float], axis: int, unit_m: float, origin: float
) -> None:
    u, v = pixel
    w = -1 / (np.array(seen.rays[2]) @ (u, v, 1.0))
    by_uw, by_w, constant = seen.coordinate(axis, unit_m, origin)
    truth = ground_point(seen, u, v)[axis] / unit_m + origin
    assert by_uw * u * w + by_w * w + constant == pytest.approx(truth, rel=1e-9, abs=1e-6)


@given(SIGHTS, st.integers(1, IMAGE_WIDTH - 2), st.integers(60, IMAGE_HEIGHT - 2),
       st.sampled_from([0, 1]))  # fmt: skip
def test_given_a_pixel_when_its_density_is_measured_then_it_is_that_of_its_larger_step(
    seen: Sight, u: int, v: int, axis: int
) -> None:
    step = 1e-3
    sides = [
        abs(ground_point(seen, u + du, v + dv)[axis] - ground_point(seen, u - du, v - dv)[axis])
        for du, dv in ((step, 0), (0, step))
    ]
    assume(max(sides) > 1e-6)
    by_column, by_row = seen.density(axis, 0.1)
    density = min(by_column[0, u], by_row[v, 0]) * fall(seen)[v, u] ** 2
    assert density == pytest.approx(0.1 / (max(sides) / (2 * step)), rel=2e-3)


@given(SIGHTS, st.floats(1e-3, 0.5))
def test_given_a_fall_when_rows_below_it_are_counted_then_the_others_have_none_and_the_last_has(
    seen: Sight, least: float
) -> None:
    count = seen.rows_below(least)
    steep = fall(seen)
    assert (steep[count:] > least * (1 - 1e-5)).all()
    if count:
        assert steep[count - 1].min() < least * (1 + 1e-5)


@given(SIGHTS, st.sampled_from([0, 1]), st.floats(0.1, 3), st.floats(5, 800))
def test_given_limits_when_rows_beyond_them_are_counted_then_the_others_keep_both(
    seen: Sight, axis: int, density: float, limit_m: float
) -> None:
    count = seen.rows_beyond(axis, density, 0.12, limit_m)
    by_column, by_row = seen.density(axis, 0.12)
    found = np.minimum(by_column, by_row) * fall(seen) ** 2
    assert (found[count:] > density * (1 - 1e-4)).all()
    for v in range(count, IMAGE_HEIGHT, 20):
        for u in (0, IMAGE_WIDTH - 1):
            assert abs(ground_point(seen, u, v)[axis] - seen.camera[axis]) <= limit_m


def test_given_a_camera_off_the_strip_when_rows_beyond_it_are_counted_then_it_is_all() -> None:
    assert sight(0.0).rows_beyond(0, 0.1, 0.4, -1.0) == IMAGE_HEIGHT
