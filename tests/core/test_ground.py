from __future__ import annotations

import numpy as np
import pytest

from taxinet_ros.core import ground, runway
from taxinet_ros.core.ground_style import STANDARD
from taxinet_ros.core.pavement import Grid, coverage


def base() -> np.ndarray:
    return ground.ground_atlas()[: ground.ROWS, : ground.COLUMNS].mean(axis=2)


def patch(x0: float, x1: float, y0: float, y1: float) -> float:
    rows = slice(*(round((x - ground.START_X_M) / ground.ROW_M) for x in (x0, x1)))
    columns = slice(*(round(y / ground.FINE_M + ground.COLUMNS / 2) for y in (y0, y1)))
    return float(base()[rows, columns].mean())


def test_given_the_atlas_when_built_then_it_fits_in_memory_and_is_shared() -> None:
    atlas = ground.ground_atlas()
    assert atlas.shape == (2 * ground.ROWS, 2 * ground.COLUMNS, 3)
    assert atlas.nbytes < 100e6
    assert ground.ground_atlas() is atlas
    assert not atlas.flags.writeable


def test_given_a_clean_stretch_when_measured_then_paint_asphalt_and_field_have_their_tones() -> (
    None
):
    for side in (-1, 1):
        low, high = sorted((side * 14.4, side * 15.0))
        assert patch(1000, 1100, low, high) == pytest.approx(STANDARD.paint, abs=10)
        low, high = sorted((side * 9, side * 13))
        assert patch(1000, 1100, low, high) == pytest.approx(STANDARD.asphalt, abs=10)
        low, high = sorted((side * 16, side * 19))
        assert patch(1000, 1100, low, high) == pytest.approx(152, abs=8)


def test_given_the_touchdown_zone_when_measured_then_rubber_makes_the_middle_dark() -> None:
    zone, clean = patch(150, 500, -4, 4), patch(1000, 1200, -4, 4)
    assert zone < 0.65 * clean
    assert patch(150, 500, 9, 13) > 0.8 * clean


def test_given_the_crossing_when_measured_then_our_stripes_are_gone() -> None:
    for side in (-1, 1):
        low, high = sorted((side * 14.4, side * 15.0))
        assert patch(1425, 1465, low, high) < STANDARD.asphalt
    dashes = [m.polygon for m in runway.markings() if m.kind == 'centreline']
    assert not any(1400 < x < 1490 for polygon in dashes for x, _ in polygon)


def test_given_the_grain_when_averaged_then_it_leaves_the_colour_alone() -> None:
    tile = ground.grain_atlas()[: ground.GRAIN_TEXELS, : ground.GRAIN_TEXELS]
    assert tile.mean() == pytest.approx(ground.GRAIN_NEUTRAL, abs=0.7)
    assert 3 < tile.std() < 15


def test_given_a_rectangle_off_the_grid_when_covered_then_the_shares_are_the_overlaps() -> None:
    grid = Grid(rows=10, columns=10, x0_m=0.0, dx_m=1.0, y0_m=0.0, dy_m=1.0)
    rows, columns, cover = coverage(((2.5, 3.25), (5.0, 3.25), (5.0, 6.0), (2.5, 6.0)), grid)

    assert (rows, columns) == (slice(2, 5), slice(3, 6))
    assert float(cover.sum()) == pytest.approx(2.5 * 2.75, abs=0.8)
    assert cover[0, 1] == pytest.approx(0.5, abs=0.26)
    assert cover[1, 1] == 1
