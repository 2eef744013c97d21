"""Haze, water and glare by row and column are what numpy makes of the written formulas.

What stands at the horizon is looked up where the rays of a picture's pixels meet it.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from view_samples import rays_of

from taxinet_ros.core.camera.pixels import Air, Panorama

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


VIEW_WIDTH, VIEW_HEIGHT, SPACING = 45, 50, 15
LOWEST, STEP, END_TAN = math.radians(-0.5), math.radians(0.1), 0.0022
CODES = np.random.default_rng(3).integers(1, 256, (160, 1440, 3), dtype=np.uint8)
VIEW_YAWS, VIEW_PITCHES = st.floats(-math.pi, math.pi), st.floats(-0.05, 0.3)


def panorama(codes: np.ndarray = CODES, spacing_px: int = SPACING) -> Panorama:
    return Panorama(
        codes, lowest_rad=LOWEST, step_rad=STEP, end_tan=END_TAN, spacing_px=spacing_px
    )


def laid(rays: np.ndarray, codes: np.ndarray = CODES, spacing_px: int = SPACING) -> np.ndarray:
    picture = np.zeros((VIEW_HEIGHT, VIEW_WIDTH, 3), np.uint8)
    panorama(codes, spacing_px).lay_over(picture, rays)
    return picture


def directions(rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Yaw and elevation [rad] of every pixel, (HEIGHT, WIDTH) each."""
    v, u = np.mgrid[:VIEW_HEIGHT, :VIEW_WIDTH].astype(np.float64)
    x, y, z = np.einsum('ij,jvu->ivu', rays, np.stack([u, v, np.ones_like(u)]))
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


@given(VIEW_YAWS, VIEW_PITCHES, st.floats(-0.05, 0.05))
def test_given_a_view_when_laid_over_then_the_panorama_ends_where_the_ground_does(
    yaw: float, pitch: float, roll: float
) -> None:
    rays = rays_of(yaw, pitch, roll)
    _, elevation = directions(rays)
    replaced = laid(rays).any(axis=2)
    above = elevation + math.atan(END_TAN)
    # At the picture's edges a ray is longer than the depth by which its fall is measured.
    sure = np.abs(above) > 0.25 * END_TAN
    np.testing.assert_array_equal(replaced[sure], (above > 0)[sure])


@given(VIEW_YAWS, VIEW_PITCHES)
def test_given_a_view_when_looked_up_at_every_column_then_it_is_what_opencv_finds_there(
    yaw: float, pitch: float
) -> None:
    rays = rays_of(yaw, pitch)
    found, (yaws, elevation) = laid(rays, spacing_px=1), directions(rays)
    middle = math.atan2(rays[1] @ (VIEW_WIDTH // 2, 0, 1), rays[0] @ (VIEW_WIDTH // 2, 0, 1))
    turned = np.angle(np.exp(1j * (yaws - middle)))  # no jump within the picture
    across = ((middle + turned + math.pi) * CODES.shape[1] / math.tau).astype(np.float32)
    up = np.clip((elevation - LOWEST) / STEP, 0, len(CODES) - 1).astype(np.float32)
    wanted = cv2.remap(CODES, across, up, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    seen = found.any(axis=2)
    # Both round to 1/32 of a pixel; a last bit may decide which way.
    same = (found == wanted).all(axis=2)[seen]
    assert same.mean() > 0.98 if seen.any() else pitch > 0


def by_opencv(rays: np.ndarray, rows: int) -> np.ndarray:
    """The upper rows of a picture by cv2.resize of sparse directions, and cv2.remap."""
    columns = (np.arange(-1, VIEW_WIDTH // SPACING + 1) + 0.5) * SPACING - 0.5
    v, u = np.meshgrid(np.arange(rows, dtype=np.float64), columns, indexing='ij')
    x, y, z = np.einsum('ij,jvu->ivu', rays, np.stack([u, v, np.ones_like(u)]))
    cos, sin, _ = rays @ (columns[len(columns) // 2], 0.0, 1.0)
    aside = np.arctan2(cos * y - sin * x, cos * x + sin * y)
    across = (math.atan2(sin, cos) + math.pi + aside) * CODES.shape[1] / math.tau
    up = np.clip((np.arctan2(z, np.hypot(x, y)) - LOWEST) / STEP, 0, len(CODES) - 1)
    across, up = (
        np.ascontiguousarray(
            cv2.resize(sparse.astype(np.float32), (SPACING * len(columns), rows))
            [:, SPACING:-SPACING]
        )
        for sparse in (across, up)
    )
    found = cv2.remap(CODES, across, up, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    lowest = np.float32((-math.atan(END_TAN) - LOWEST) / STEP)
    return np.where((up > lowest)[..., None], found, 0)


def rows_of(rays: np.ndarray) -> int:
    """Rows of a picture in which some ray falls by less than the end of the ground."""
    (_, _, _), (_, _, _), (f0, f1, f2) = rays
    last = max((-END_TAN - end) / f1 for end in (f2, f0 * (VIEW_WIDTH - 1) + f2))
    return min(max(math.floor(last) + 1, 0), VIEW_HEIGHT)


@given(VIEW_YAWS, st.floats(-0.02, 0.19))
def test_given_a_view_when_laid_over_then_it_is_what_opencv_made_of_it_to_the_byte(
    yaw: float, pitch: float
) -> None:
    rays = rays_of(yaw, pitch)
    rows = rows_of(rays)
    found, wanted = laid(rays), np.zeros((VIEW_HEIGHT, VIEW_WIDTH, 3), np.uint8)
    if rows:
        wanted[:rows] = by_opencv(rays, rows)
    if rows == 1:
        np.testing.assert_array_equal(found, wanted)
    # Several rows OpenCV gives to a library that may round otherwise on another processor.
    assert (found == wanted).mean() > 0.999


def test_given_one_row_above_the_ground_when_laid_over_then_it_is_opencvs_to_the_byte() -> None:
    # It interpolates one row otherwise than several: of 100,000 pixels it decides some.
    pitch = next(p for p in np.arange(0.19, 0.1, -0.0005) if rows_of(rays_of(0.0, p)) == 1)
    for yaw in np.random.default_rng(8).uniform(-math.pi, math.pi, 5000):
        rays = rays_of(yaw, pitch)
        found = laid(rays)[:1]
        assert found.any()
        np.testing.assert_array_equal(found, by_opencv(rays, 1))


@given(VIEW_YAWS, VIEW_PITCHES)
def test_given_a_smooth_panorama_when_directions_lie_apart_then_nobody_sees_it(
    yaw: float, pitch: float
) -> None:
    columns = np.cos(np.arange(1440) * math.tau / 1440)
    smooth = np.rint(128 + 100 * columns[None, :, None] + np.arange(3)).astype(np.uint8)
    codes = np.ascontiguousarray(np.broadcast_to(smooth, CODES.shape))
    rays = rays_of(yaw, pitch)
    apart, each = laid(rays, codes).astype(int), laid(rays, codes, 1).astype(int)
    both = apart.any(axis=2) & each.any(axis=2)
    assert np.abs(apart - each)[both].max(initial=0) <= 1


def test_given_a_panorama_that_goes_round_when_looked_at_its_seam_then_there_is_no_seam() -> None:
    columns = np.abs(np.arange(1440) - 719.5) / 719.5
    codes = np.rint(200 * columns)[None, :, None] + np.zeros((160, 1, 3)) + 20
    picture = laid(rays_of(math.pi, -0.05), codes.astype(np.uint8))
    rows = picture[picture.any(axis=(1, 2))].astype(int)
    assert len(rows) > 10
    assert np.abs(np.diff(rows, axis=1)).max() <= 1


def test_given_a_part_of_a_picture_when_laid_over_then_the_rest_stays() -> None:
    whole = np.zeros((VIEW_HEIGHT, VIEW_WIDTH + 10, 3), np.uint8)
    panorama().lay_over(whole[:, 5:-5], rays_of(0.3, -0.05))
    assert not whole[:, :5].any()
    assert not whole[:, -5:].any()
    np.testing.assert_array_equal(whole[:, 5:-5], laid(rays_of(0.3, -0.05)))


def test_given_a_view_of_the_ground_only_when_laid_over_then_nothing_changes() -> None:
    assert not laid(rays_of(0.0, 0.4)).any()


@pytest.mark.parametrize(('codes', 'spacing', 'reason'), [
    (CODES[..., 0].copy(), 15, r'a panorama is \(rows, columns, 3\)'),
    (CODES[:0], 15, r'a panorama is \(rows, columns, 3\)'),
    (CODES, 0, 'an odd number of columns apart'),
    (CODES, 4, 'an odd number of columns apart'),
])  # fmt: skip
def test_given_what_does_not_fit_when_made_then_it_says_which(
    codes: np.ndarray, spacing: int, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        panorama(codes, spacing)


def test_given_a_picture_of_another_width_when_laid_over_then_it_says_so() -> None:
    with pytest.raises(ValueError, match="divides a picture's width"):
        panorama().lay_over(np.zeros((4, 44, 3), np.uint8), np.eye(3))
    with pytest.raises(ValueError, match=r'rays are \(3, 3\)'):
        panorama().lay_over(np.zeros((4, 45, 3), np.uint8), np.eye(2))
    with pytest.raises(TypeError, match='incompatible function arguments'):
        panorama().lay_over(np.zeros((4, 45, 3), np.float32), np.eye(3))
