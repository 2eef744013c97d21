from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taxinet_ros.core.ground_style import STANDARD, GroundStyle, varied_style
from taxinet_ros.core.pavement import Grid, runway_surface

STRIP = Grid(rows=1640, columns=320, x0_m=-100.0, dx_m=2.0, y0_m=-19.2, dy_m=0.12)
"""The whole runway, coarser along it than the camera's."""

PATCH = slice(round(STRIP.row(620)), round(STRIP.row(780)))
"""160 m with centreline and some rubber, away from the crossing."""


def mean_at(surface: np.ndarray, y_m: float, half_m: float) -> float:
    left, right = round(STRIP.column(y_m - half_m)), round(STRIP.column(y_m + half_m))
    return float(surface[PATCH, left:right].mean())


def test_given_a_style_when_laid_twice_then_the_surface_is_the_same() -> None:
    style = varied_style(np.random.default_rng(3))
    assert np.array_equal(runway_surface(STRIP, style), runway_surface(STRIP, style))


def test_given_two_draws_when_laid_then_the_surfaces_differ() -> None:
    rng = np.random.default_rng(3)
    first, second = (runway_surface(STRIP, varied_style(rng)) for _ in range(2))
    assert np.abs(first.astype(float) - second).mean() > 5


@pytest.mark.parametrize('seed', range(8))
def test_given_any_varied_style_when_laid_then_the_edge_stripes_stay_in_their_place(
    seed: int,
) -> None:
    style = varied_style(np.random.default_rng(seed))
    surface = runway_surface(STRIP, style)
    for side in (-1, 1):
        stripe = mean_at(surface, side * 14.7, 0.3)
        beside = mean_at(surface, side * 13.2, 0.3)
        assert stripe > beside + 10, side


def test_given_more_rubber_when_laid_then_the_middle_is_darker() -> None:
    shades = [
        mean_at(runway_surface(STRIP, replace(STANDARD, rubber_amount=amount)), 0, 4)
        for amount in (0.0, 1.0, 1.8)
    ]
    assert shades[0] > shades[1] + 3 > shades[2] + 5


def test_given_rubber_off_the_centreline_when_laid_then_that_side_is_darker() -> None:
    surface = runway_surface(STRIP, replace(STANDARD, rubber_amount=1.8, rubber_shift_m=3.0))
    assert mean_at(surface, 5, 2) < mean_at(surface, -5, 2) - 3


def test_given_a_kind_left_out_when_laid_then_its_paint_is_gone() -> None:
    clean = GroundStyle(rubber_amount=0)
    with_it = mean_at(runway_surface(STRIP, clean), 0, 0.3)
    without = mean_at(runway_surface(STRIP, replace(clean, without=('centreline',))), 0, 0.3)
    assert with_it > without + 15


def test_given_worn_paint_when_laid_then_less_of_it_is_left() -> None:
    shades = [
        mean_at(runway_surface(STRIP, GroundStyle(rubber_amount=0, wear=wear)), 0, 0.3)
        for wear in (0.0, 1.0, 2.0)
    ]
    assert shades[0] > shades[1] + 3 > shades[2] + 6
