from __future__ import annotations

import dataclasses
import hashlib
import math
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from picture_samples import at

from taxinet_ros.core import world
from taxinet_ros.core.camera.airframe import drawing
from taxinet_ros.core.camera.camera import (
    IMAGE_HEIGHT,
    IMAGE_WIDTH,
    STAGES,
    Camera,
    intrinsics,
    pose,
    project,
    shared_curve,
)
from taxinet_ros.core.camera.light import ground_table, scenario_light
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.place.markings import markings
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import RAIN_CLOUDS
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.types import AircraftState

Picture = NDArray[np.uint8]
OPEN = slice(70, None)  # columns right of the aircraft's own parts
STRIPE_M = min(
    x for marking in markings(default_runway()) if marking.kind == 'centreline'
    for x, _ in marking.polygon if x > 1005
)
"""Where the stripe of the centreline begins that is photographed."""


def shot(
    state: AircraftState, hour: float = 10.0, stamp_ns: int = 0, **scenario: object
) -> Picture:
    camera = Camera(Scenario(time_of_day_s=hour * 3600, **scenario))
    return camera.render(state, stamp_ns)


def brightness(picture: Picture) -> float:
    return float(picture[:, OPEN].mean())


def line_column(state: AircraftState, y_m: float, row: int) -> tuple[float, float]:
    """Column at which the ground line y = y_m crosses a picture row, and the depth there."""
    points = np.array([(state.x_m + d, y_m, 0.0) for d in np.linspace(3, 60, 400)])
    pixels, depth = project(state, points)
    order = np.argsort(pixels[:, 1])
    column = np.interp(row, pixels[order, 1], pixels[order, 0])
    return float(column), float(np.interp(row, pixels[order, 1], depth[order]))


@given(
    st.floats(-8, 8), st.floats(-30, 30), st.floats(20, IMAGE_HEIGHT - 1), st.floats(0, IMAGE_WIDTH)
)
def test_given_a_pixel_when_its_ray_meets_the_ground_then_projecting_gives_the_pixel_back(
    y: float, heading_deg: float, v: float, u: float
) -> None:
    state = at(500.0, y, heading_deg)
    _, to_optical, place = pose(state)
    ray = to_optical.T @ np.linalg.inv(intrinsics()) @ np.array([u, v, 1.0])
    pixels, depth = project(state, (place - ray * place[2] / ray[2])[None])
    assert pixels[0] == pytest.approx([u, v], abs=1e-6)
    assert depth[0] > 0


@pytest.mark.parametrize(('y', 'heading_deg'), [(0.0, 0.0), (4.0, 8.0), (-5.0, 10.0), (7.0, -14.0)])
def test_given_a_centreline_stripe_when_photographed_then_it_lies_where_k_projects_it(
    y: float, heading_deg: float
) -> None:
    # The stripe from 1009.5 to 1046 m, photographed from 6 m before it.
    state = at(STRIPE_M - 6, y, heading_deg)
    picture = shot(state, shadows=False).mean(axis=2)
    errors_m = []
    for row in range(24, 56):
        column, depth = line_column(state, 0.0, row)
        edges = [line_column(state, side, row)[0] for side in (-1.2, 1.2)]
        first, last = math.floor(min(edges)), math.ceil(max(edges))
        if depth < 9 or depth > 25 or first < 60 or last > 355:
            continue
        profile = picture[row, first : last + 1]
        weight = np.clip(profile - 0.5 * (profile.min() + profile.max()), 0, None)
        found = first + (weight @ np.arange(len(weight))) / weight.sum()
        errors_m.append((found - column) * depth / 235.5)
    assert len(errors_m) > 8
    assert abs(np.mean(errors_m)) < 0.04
    assert np.max(np.abs(errors_m)) < 0.25


def test_given_a_stripes_end_when_photographed_then_its_row_is_the_projected_one() -> None:
    errors = []
    for ahead in (8.0, 10.0, 12.0):
        state = at(STRIPE_M - ahead)
        (pixel,), _ = project(state, np.array([[STRIPE_M, 0.0, 0.0]]))
        picture = shot(state, shadows=False).mean(axis=2)
        column, row = round(pixel[0]), pixel[1]
        profile = picture[round(row) - 9 : round(row) + 10, column - 2 : column + 3].mean(axis=1)
        half = (profile[:4].mean() + profile[-4:].mean()) / 2
        found = round(row) - 9 + int(np.argmax(profile < half)) - 0.5
        errors.append(found - row)
        assert profile[:4].mean() > profile[-4:].mean() + 25
    assert np.abs(errors).max() < 3


@pytest.mark.nightly
def test_given_equal_inputs_when_rendered_in_two_processes_then_the_bytes_are_equal() -> None:
    code = (
        'import hashlib, cv2; cv2.setNumThreads(1)\n'
        'from test_camera import golden_shots\n'
        'print(hashlib.sha256(b"".join(p.tobytes() for p in golden_shots())).hexdigest())\n'
    )
    other = subprocess.run(
        [sys.executable, '-c', code],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parent,
    )
    here = hashlib.sha256(b''.join(p.tobytes() for p in golden_shots())).hexdigest()
    assert other.stdout.strip() == here


def golden_shots() -> list[Picture]:
    return [
        shot(at(333.25, 1.5, 7.0), 15.0),
        shot(at(900.0, -4.0, -20.0), 7.0, clouds='scattered'),
        shot(at(1400.0, 3.0, 0.0), 16.0, 300_000_000, clouds='broken', rain_fraction=0.7),
    ]


def test_given_one_camera_when_used_again_then_old_pictures_stay_and_equal_states_match() -> None:
    camera = Camera(Scenario())
    first = camera.render(at(), 0)
    kept = first.copy()
    camera.render(at(1200.0, 3.0, 5.0), 100)

    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(camera.render(at(), 999), kept)
    assert first.shape == (IMAGE_HEIGHT, IMAGE_WIDTH, 3)
    assert first.dtype == np.uint8
    assert first.flags.c_contiguous
    assert first.flags.owndata


@pytest.mark.parametrize('weather', [
    {'clouds': 'scattered'}, {'clouds': 'stratus', 'rain_fraction': 0.7}, {'hour': 7.0},
], ids=['shadows', 'rain', 'glare'])  # fmt: skip
def test_given_ground_that_the_aircraft_covers_when_left_out_then_the_picture_is_the_same(
    weather: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    states = [at(1200.0, 2.0, 8.0), at(800.0, -4.0, -20.0, 1.0)]
    left_out = [shot(state, **weather) for state in states]
    scene = Scenario()
    parts = drawing(scene.aircraft_model, scene.camera_model, (IMAGE_HEIGHT, IMAGE_WIDTH))
    assert parts is not None
    assert parts.hidden.sum() > 5000
    seen = dataclasses.replace(parts, hidden=np.zeros(IMAGE_HEIGHT, np.int32))
    monkeypatch.setattr('taxinet_ros.core.camera.camera.drawing', lambda *_: seen)
    for state, picture in zip(states, left_out, strict=True):
        np.testing.assert_array_equal(shot(state, **weather), picture)


def test_given_the_hours_when_photographed_then_dawn_is_dark_and_coloured() -> None:
    pictures = [shot(at(), hour) for hour in (6.0, 6.5, 7.0, 9.0, 12.0)]
    levels = [brightness(picture) for picture in pictures]

    assert levels == sorted(levels)
    assert levels[0] < 0.4 * levels[-1]
    red, blue = (float(pictures[2][100:, OPEN, c].mean()) for c in (0, 2))
    noon_red, noon_blue = (float(pictures[4][100:, OPEN, c].mean()) for c in (0, 2))
    assert red / blue > 1.08 * noon_red / noon_blue


@pytest.mark.parametrize('clouds', RAIN_CLOUDS)
def test_given_rain_when_it_grows_then_the_marks_on_the_ground_lose_contrast(clouds: str) -> None:
    state = at(y=-6.0)
    points = np.array([(state.x_m + 20.0, y, 0.0) for y in (-14.7, -13.0)])
    (stripe, asphalt), _ = project(state, points)
    contrasts = []
    for rain in (0.0, 0.3, 0.6, 1.0):
        camera = Camera(Scenario(clouds=clouds, rain_fraction=rain))
        mean = np.mean([camera.render(state, k * 10**8) for k in range(12)], axis=0)
        bright, dark = (float(mean[round(v), round(u)].mean()) for u, v in (stripe, asphalt))
        contrasts.append((bright - dark) / (bright + dark))
    assert contrasts == sorted(contrasts, reverse=True)
    assert contrasts[-1] < 0.6 * contrasts[0]


def test_given_rain_when_the_stamp_changes_then_the_streaks_do_and_repeat_with_it() -> None:
    camera = Camera(Scenario(clouds='stratus', rain_fraction=0.8))
    first, second, again = (camera.render(at(), stamp) for stamp in (0, 100_000_000, 0))
    assert (first != second).mean() > 0.05
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize('name', ['x_m', 'y_m', 'z_m', 'roll_rad', 'pitch_rad', 'yaw_rad'])
def test_given_a_pose_that_is_not_finite_when_rendered_then_it_is_refused(name: str) -> None:
    state = dataclasses.replace(at(), **{name: math.nan})
    with pytest.raises(ValueError, match='not finite'):
        Camera(Scenario()).render(state, 0)


def test_given_a_camera_under_the_ground_when_rendered_then_it_is_refused() -> None:
    with pytest.raises(ValueError, match='above ground'):
        Camera(Scenario()).render(dataclasses.replace(at(), z_m=-1.0), 0)


@pytest.mark.parametrize(
    ('hour', 'clouds', 'rain'),
    [(7.0, 'clear', 0.0), (12.0, 'cirrus', 0.0), (17.0, 'broken', 0.5), (9.0, 'stratus', 1.0)],
)
def test_given_a_light_table_when_split_then_gain_and_curve_give_it_back(
    hour: float, clouds: str, rain: float
) -> None:
    light = scenario_light(Scenario(time_of_day_s=hour * 3600, clouds=clouds, rain_fraction=rain))
    table = ground_table(light)
    curve, gain = shared_curve(table)
    codes = np.arange(256)

    assert gain.max() == 1
    for channel in range(3):
        found = np.interp(codes * gain[channel], codes, curve)
        assert np.abs(found - table[0, :, channel]).max() < 1.2


def test_given_a_listener_when_rendered_then_it_hears_the_stages_and_the_picture_is_the_same() -> (
    None
):
    heard: list[str] = []
    scene = Scenario(
        clouds='broken', rain_fraction=0.3, time_of_day_s=15 * 3600.0, lens_dirt_fraction=0.1,
        traffic=load_traffic([{'kind': 'cone', 'x_m': 420, 'y_m': 0}]),
    )
    wet, state = Camera(scene), at()
    with_marks = wet.render(state, 5, heard.append)
    assert heard == [stage for stage in STAGES if stage != 'distortion and noise'], 'a pinhole'
    np.testing.assert_array_equal(with_marks, wet.render(state, 5))

    heard.clear()
    Camera(Scenario(shadows=False)).render(state, 0, heard.append)
    assert heard == ['ground', 'atmosphere', 'airframe']

    heard.clear()
    Camera(Scenario(camera='nose')).render(state, 0, heard.append)
    assert heard[-1] == 'distortion and noise'


def test_given_a_full_turn_when_photographed_then_the_skyline_has_no_seam() -> None:
    camera = Camera(Scenario(shadows=False))
    up = -4.0
    left, right = (camera.render(at(heading_deg=h, pitch_deg=up), 0) for h in (179.999, -179.999))
    assert np.abs(left.astype(int) - right)[:20].mean() < 1


@pytest.mark.parametrize('threads', [2, 5])
def test_given_any_number_of_threads_when_rendered_then_the_bytes_are_equal(threads: int) -> None:
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        alone = shot(at(700.0, -2.0), 15.5)
        cv2.setNumThreads(threads)
        np.testing.assert_array_equal(shot(at(700.0, -2.0), 15.5), alone)
    finally:
        cv2.setNumThreads(before)


def test_given_a_world_that_nobody_photographs_then_no_camera_is_made() -> None:
    made: list[Scenario] = []
    seen = world.SimulatedWorld(
        Scenario(), camera=lambda scenario: made.append(scenario) or Camera(scenario)
    )
    assert seen.observe(picture=False).image is None
    assert made == []
    assert seen.observe().image is not None
    assert seen.observe().image is not None
    assert made == [Scenario()], 'one for all its pictures'
