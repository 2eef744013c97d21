"""Haze, water and glare by row and column are what numpy makes of the written formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from view_samples import rays_of

from taxinet_ros.core.pixels import Air

HEIGHT, WIDTH = 60, 90
LOW, HIGH = np.array([190.0, 200.0, 215.0]), np.array([120.0, 150.0, 200.0])
YAWS, PITCHES = st.floats(-math.pi, math.pi), st.floats(-0.1, 0.5)
SHARES = st.one_of(st.just(0.0), st.floats(0, 1))


def air(
    visibility_m: float = 2000.0, film: float = 0.0, spray: float = 0.0, glare: float = 0.0,
    sun_yaw_rad: float = 0.0, glare_width_rad: float = 0.3,
) -> Air:
    return Air(
        visibility_m=visibility_m, film=film, spray=spray, sky_low=LOW, sky_high=HIGH, glare=glare,
        sun_yaw_rad=sun_yaw_rad, glare_width_rad=glare_width_rad,
    )


def sines(rays: np.ndarray) -> np.ndarray:
    """Of the angle at which the middle of each row goes down, (HEIGHT,)."""
    rows = np.arange(HEIGHT, dtype=np.float64)
    middle = rays @ np.stack([np.full(HEIGHT, (WIDTH - 1) / 2), rows, np.ones(HEIGHT)])
    return np.clip(-middle[2] / np.linalg.norm(middle, axis=0), 1e-4, 1)


@given(YAWS, PITCHES, st.floats(50, 30e3), SHARES, SHARES, st.floats(0.5, 5))
def test_given_any_air_when_a_view_is_veiled_then_haze_and_mirror_follow_their_laws(
    yaw: float, pitch: float, visibility_m: float, film: float, spray: float, height_m: float
) -> None:
    rays = rays_of(yaw, pitch)
    sine = sines(rays)
    haze = 1 - np.exp(-height_m / sine / visibility_m)
    mirror = film * (0.02 + 0.98 * (1 - sine) ** 5) + spray
    share = 1 - (1 - haze) * (1 - mirror)
    rise = np.sqrt(np.clip(sine / math.sin(math.radians(15)), 0, 1))[:, None]
    mirrored = 0.92 * (LOW + (HIGH - LOW) * rise)
    wanted = haze[:, None] * LOW + ((1 - haze) * mirror)[:, None] * mirrored

    kept, added = air(visibility_m, film, spray).veil(rays, height_m, HEIGHT, WIDTH)
    rows = len(kept)
    assert added.shape == (rows, 3)
    np.testing.assert_allclose(kept, 255 * (1 - share[:rows]), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(added, wanted[:rows], rtol=1e-9, atol=1e-9)
    # What is left out would not be seen: less than a code of 255.
    assert (share[rows:] <= 1 / 400 + 1e-12).all()
    assert rows == 0 or share[rows - 1] > 1 / 400 - 1e-12


@given(YAWS, PITCHES, YAWS, st.floats(0.1, 1.0))
def test_given_a_low_sun_when_it_shines_then_it_falls_off_aside_and_downwards(
    yaw: float, pitch: float, sun_yaw: float, width_rad: float
) -> None:
    rays = rays_of(yaw, pitch)
    columns = np.arange(WIDTH, dtype=np.float64)
    x, y, _ = rays @ np.stack([columns, np.full(WIDTH, 60.0), np.ones(WIDTH)])
    turn = np.angle(np.exp(1j * (np.arctan2(y, x) - sun_yaw)))
    away = np.abs(turn) / width_rad

    found = air(glare=80.0, sun_yaw_rad=sun_yaw, glare_width_rad=width_rad).shine(
        rays, HEIGHT, WIDTH
    )
    if found is None:
        assert away.min() > 3 - 1e-9
        return
    by_row, by_column = found
    assert by_row.dtype == by_column.dtype == np.float32
    np.testing.assert_allclose(by_row, 80 * (np.exp(-sines(rays) / 0.10) + 0.12), rtol=1e-6)
    np.testing.assert_allclose(by_column, np.exp(-0.5 * away * away), rtol=1e-6, atol=1e-30)


def test_given_a_sun_behind_the_camera_when_it_shines_then_there_is_no_glare() -> None:
    assert air(glare=80.0, sun_yaw_rad=math.pi).shine(rays_of(0.0, 0.2), HEIGHT, WIDTH) is None
    assert air(glare=80.0, sun_yaw_rad=0.0).shine(rays_of(0.0, 0.2), HEIGHT, WIDTH) is not None


@pytest.mark.parametrize('rays', [np.eye(2), np.zeros(9), np.zeros((3, 4))])
def test_given_what_are_no_rays_when_looked_along_then_it_says_so(rays: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r'rays are \(3, 3\)'):
        air().veil(rays, 2.0, HEIGHT, WIDTH)
    with pytest.raises(ValueError, match=r'rays are \(3, 3\)'):
        air().shine(rays, HEIGHT, WIDTH)
