from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.camera import intrinsics, rotation
from taxinet_ros.core.pixels import on_panorama

MEASURES = (100.0, -0.05, 0.01, 40.0)
"""Columns per radian, elevation of row 0 and step [rad], rows."""
COLUMNS = np.array([0.0, 90.0, 180.0, 270.0, 359.0])


def rays_of(yaw: float, pitch: float) -> np.ndarray:
    """Pixel to map of a camera that looks ahead (x forward, y left, z up), then is turned."""
    to_optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return rotation(0.0, pitch, yaw) @ to_optical @ np.linalg.inv(intrinsics())


@given(st.floats(-math.pi, math.pi), st.floats(-0.3, 0.3))
def test_given_a_view_when_looked_up_then_columns_are_yaw_and_rows_are_elevation(
    yaw: float, pitch: float
) -> None:
    rays = rays_of(yaw, pitch)
    across, up = on_panorama(rays, COLUMNS, 3, MEASURES)
    assert across.shape == up.shape == (3, len(COLUMNS))
    for v in range(3):
        for i, u in enumerate(COLUMNS):
            x, y, z = rays @ (u, v, 1.0)
            per_radian, lowest, step, rows = MEASURES
            turn = (across[v, i] / per_radian - math.pi - math.atan2(y, x)) / (2 * math.pi)
            assert turn == pytest.approx(round(turn), abs=1e-5)
            row = (math.atan2(z, math.hypot(x, y)) - lowest) / step
            assert up[v, i] == pytest.approx(min(max(row, 0), rows - 1), abs=1e-4)


@given(st.floats(-math.pi, math.pi))
def test_given_a_view_when_looked_up_then_its_columns_have_no_jump(yaw: float) -> None:
    across, _ = on_panorama(rays_of(yaw, 0.0), COLUMNS, 1, MEASURES)
    assert (np.diff(across[0]) < 0).all()  # yaw grows to the left
    assert np.abs(np.diff(across[0])).max() < 60


@pytest.mark.parametrize(('rays', 'columns', 'rows'), [
    (np.eye(2), COLUMNS, 1), (np.eye(3), np.zeros(0), 1), (np.eye(3), COLUMNS, 0),
])  # fmt: skip
def test_given_no_directions_when_looked_up_then_it_says_so(
    rays: np.ndarray, columns: np.ndarray, rows: int
) -> None:
    with pytest.raises(ValueError, match='directions are of'):
        on_panorama(rays, columns, rows, MEASURES)
