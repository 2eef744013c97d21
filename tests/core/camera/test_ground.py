"""The crossing runway, which a scene may leave out."""

from __future__ import annotations

from dataclasses import replace
from threading import Event, Thread

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.camera.ground import atlas as ground
from taxinet_ros.core.camera.ground.pavement import (
    STANDARD,
    Grid,
    GroundStyle,
    coverage,
    runway_surface,
    varied_style,
)
from taxinet_ros.core.camera.texture import build_ripmap
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.place.markings import markings
from taxinet_ros.core.scenario import Scenario

KMWH = default_runway()
ROWS, COLUMNS = 8192, 640


def base() -> np.ndarray:
    return ground.ground_atlas(KMWH)[:ROWS, :COLUMNS].mean(axis=2)


def patch(x0: float, x1: float, y0: float, y1: float) -> float:
    rows = slice(*(round((x - ground.START_X_M) / ground.ROW_M) for x in (x0, x1)))
    columns = slice(*(round(y / ground.FINE_M + COLUMNS / 2) for y in (y0, y1)))
    return float(base()[rows, columns].mean())


def test_given_the_atlas_when_built_then_it_fits_in_memory_and_is_shared() -> None:
    atlas = ground.ground_atlas(KMWH)
    assert atlas.shape == (2 * ROWS, 2 * COLUMNS, 3)
    assert atlas.nbytes < 100e6
    assert ground.ground_atlas(KMWH) is atlas
    assert ground.ground_atlas(KMWH, None, airport=None, crossing=True) is atlas
    assert not atlas.flags.writeable


def test_given_an_atlas_that_a_thread_makes_when_another_needs_it_then_it_is_made_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun, again, made = Event(), Event(), []

    def make(*_: object) -> np.ndarray:
        made.append(np.zeros(1))
        if len(made) == 1:
            begun.set()
            again.wait(0.2)  # which another would end that made its own
        again.set()
        return made[-1]

    monkeypatch.setattr(ground, 'make_ground_atlas', make)
    runway, found = replace(KMWH, length_m=KMWH.length_m + 1), []
    thread = Thread(target=lambda: found.append(ground.ground_atlas(runway)))
    thread.start()
    begun.wait()
    found.append(ground.ground_atlas(runway))
    thread.join()
    assert len(made) == 1
    assert found[0] is found[1]


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
    dashes = [m.polygon for m in markings(KMWH) if m.kind == 'centreline']
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


STRIP = Grid(rows=1640, columns=320, x0_m=-100.0, dx_m=2.0, y0_m=-19.2, dy_m=0.12)
"""The whole runway, coarser along it than the camera's."""
PATCH = slice(round(STRIP.row(620)), round(STRIP.row(780)))
"""160 m with centreline and some rubber, away from the crossing."""


def mean_at(surface: np.ndarray, y_m: float, half_m: float) -> float:
    left, right = round(STRIP.column(y_m - half_m)), round(STRIP.column(y_m + half_m))
    return float(surface[PATCH, left:right].mean())


def test_given_a_style_when_laid_twice_then_the_surface_is_the_same_and_another_draws_differs(
) -> None:
    rng = np.random.default_rng(3)
    first, other = varied_style(rng), varied_style(rng)
    surface = runway_surface(STRIP, first, KMWH)
    assert np.array_equal(surface, runway_surface(STRIP, first, KMWH))
    assert np.abs(surface.astype(float) - runway_surface(STRIP, other, KMWH)).mean() > 5


@pytest.mark.parametrize('seed', range(8))
def test_given_any_varied_style_when_laid_then_the_edge_stripes_stay_in_their_place(
    seed: int,
) -> None:
    style = varied_style(np.random.default_rng(seed))
    surface = runway_surface(STRIP, style, KMWH)
    for side in (-1, 1):
        stripe = mean_at(surface, side * 14.7, 0.3)
        beside = mean_at(surface, side * 13.2, 0.3)
        assert stripe > beside + 10, side


def test_given_more_rubber_when_laid_then_the_middle_is_darker() -> None:
    shades = [
        mean_at(runway_surface(STRIP, replace(STANDARD, rubber_amount=amount), KMWH), 0, 4)
        for amount in (0.0, 1.0, 1.8)
    ]
    assert shades[0] > shades[1] + 3 > shades[2] + 5


def test_given_rubber_off_the_centreline_when_laid_then_that_side_is_darker() -> None:
    surface = runway_surface(STRIP, replace(STANDARD, rubber_amount=1.8, rubber_shift_m=3.0), KMWH)
    assert mean_at(surface, 5, 2) < mean_at(surface, -5, 2) - 3


def test_given_a_kind_left_out_when_laid_then_its_paint_is_gone() -> None:
    clean = GroundStyle(rubber_amount=0)
    with_it = mean_at(runway_surface(STRIP, clean, KMWH), 0, 0.3)
    without = mean_at(runway_surface(STRIP, replace(clean, without=('centreline',)), KMWH), 0, 0.3)
    assert with_it > without + 15


def test_given_worn_paint_when_laid_then_less_of_it_is_left() -> None:
    shades = [
        mean_at(runway_surface(STRIP, GroundStyle(rubber_amount=0, wear=wear), KMWH), 0, 0.3)
        for wear in (0.0, 1.0, 2.0)
    ]
    assert shades[0] > shades[1] + 3 > shades[2] + 6


def picture(distance_m: float, *, crossing: bool) -> np.ndarray:
    scene = Scenario(distance_m=distance_m, crossing=crossing, shadows=False)
    return Camera(scene).render(Aircraft(scene).state, 0)


def test_given_no_crossing_then_our_stripes_go_through_and_nothing_else_is_painted_otherwise():
    with_it, without = (markings(KMWH, crossing=there) for there in (True, False))
    def length(markings, kind):
        return sum(m.polygon[1][0] - m.polygon[0][0] for m in markings if m.kind == kind)

    assert length(without, 'edge') == 2 * KMWH.length_m
    clear_m = 4 * KMWH.crossings[0].clear_half_m
    assert length(with_it, 'edge') < length(without, 'edge') - clear_m + 1
    kinds = {m.kind for m in with_it} - {'edge', 'centreline'}
    assert len(kinds) == 4
    for kind in kinds:
        assert [m for m in with_it if m.kind == kind] == [m for m in without if m.kind == kind]


def test_given_no_crossing_then_the_ground_differs_there_and_nowhere_else():
    with_it, without = (
        atlas[:ROWS, :COLUMNS]
        for atlas in (ground.ground_atlas(KMWH), ground.ground_atlas(KMWH, crossing=False))
    )
    x = ground.START_X_M + (np.arange(ROWS) + 0.5) * ground.ROW_M
    differs = (with_it != without).any(axis=(1, 2))
    assert differs[(x > 1420) & (x < 1470)].all()
    assert not differs[(x < 1150) | (x > 1750)].any()


def test_given_a_scene_without_it_then_the_camera_sees_the_centreline_go_on():
    there, gone = (picture(1420.0, crossing=crossing) for crossing in (True, False))
    assert (there != gone).mean() > 0.3
    # The nearest dash is the brightest thing on the pavement; at the crossing there is none.
    middle = slice(100, 260)
    assert gone[20:60, middle].max() > there[60:150, middle].max() + 20
    assert np.array_equal(picture(400.0, crossing=True)[60:], picture(400.0, crossing=False)[60:])


BASE = np.random.default_rng(3).integers(0, 256, (64, 32, 3), dtype=np.uint8)


def test_given_a_texture_when_built_then_each_level_holds_its_block_means() -> None:
    atlas = build_ripmap(BASE, 5, 4)

    np.testing.assert_array_equal(atlas[:64, :32], BASE)
    for i, j in ((1, 0), (0, 1), (2, 1), (4, 3)):
        rows, columns = 64 >> i, 32 >> j
        blocks = BASE.reshape(rows, 1 << i, columns, 1 << j, 3).mean(axis=(1, 3))
        row, column = 128 - 2 * rows, 64 - 2 * columns
        level = atlas[row : row + rows, column : column + columns]
        # Every halving rounds once.
        assert np.abs(level - blocks).max() <= 0.5 * (i + j) + 0.5


@given(st.integers(0, 4), st.integers(0, 3))
def test_given_a_level_when_the_layouts_law_is_applied_then_a_texels_middle_is_where_it_lies(
    level: int, place: int
) -> None:
    ramp = np.repeat(np.arange(0, 256, 4, dtype=np.uint8), 32 * 3).reshape(64, 32, 3)
    scale = 2.0**-level
    middle = (place + 0.5) / scale
    row = 2 * 64 + scale * (middle - 2 * 64) - 0.5

    found = build_ripmap(ramp, 5, 1)[round(row), 0, 0]
    assert row == round(row)
    assert found == pytest.approx(4 * (middle - 0.5), abs=0.5 * level)
