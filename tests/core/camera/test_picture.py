"""The ground's textures neither shimmer nor show moire or the borders of their levels.

The reference is the mean of sixteen pictures whose optical axis is turned by parts of a pixel: what
a picture with four times the samples each way would be.

The aircraft's own motion moves the picture: it nods when it brakes, and the runway with it.

What time of day and weather do to the picture, measured in the picture.
"""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from itertools import combinations, pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from picture_samples import FOCAL, OPEN, Picture, at, ground_points, luminance, pixels, shot

from taxinet_ros.core.camera.camera import Camera, project
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.place.markings import edge_stripe_y_m
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CLOUDS
from taxinet_ros.core.types import AircraftState, TaxiCommand

Numbers = NDArray[np.float64]
FAR = slice(1, 16)
"""Rows of ground between 500 and 40 m away, where a pixel covers metres of runway."""
OFFSETS_PX = (-0.375, -0.125, 0.125, 0.375)
POSES = [(400.0, 0.0), (700.0, 0.0), (1000.0, 15.0), (1330.0, -10.0)]
"""Place [m] and heading [deg]: thick rubber, touchdown bars, plain stripes, the crossing ahead."""


@cache
def plain(state: AircraftState) -> Numbers:
    return luminance(shot(state))[:130, OPEN]


def supersampled(state: AircraftState) -> Numbers:
    pictures = [
        plain(dataclasses.replace(
            state, yaw_rad=state.yaw_rad + u / FOCAL[0], pitch_rad=state.pitch_rad + v / FOCAL[1],
        ))
        for u in OFFSETS_PX
        for v in OFFSETS_PX
    ]
    return np.asarray(np.mean(pictures, axis=0))


def rms(values: Numbers) -> float:
    return float(np.sqrt(np.square(values).mean()))


@pytest.mark.parametrize(('x', 'heading_deg'), POSES)
def test_given_the_far_runway_when_compared_with_four_times_the_samples_then_there_is_no_moire(
    x: float, heading_deg: float
) -> None:
    state = at(x, heading_deg=heading_deg)
    wanted = supersampled(state)
    difference = plain(state) - wanted
    for rows, most in ((FAR, 3.0), (slice(16, 60), 2.5)):
        assert wanted[rows].std() > 10, 'there is something to alias'
        assert rms(difference[rows]) < most


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('x', 'heading_deg'), POSES[1:])
@pytest.mark.parametrize(('step_m', 'most'), [(0.05, 0.12), (0.5, 0.5)])
def test_given_an_aircraft_that_rolls_on_when_photographed_then_the_far_runway_does_not_shimmer(
    x: float, heading_deg: float, step_m: float, most: float
) -> None:
    # A pixel's departure from the mean of its past and its future, over 2 m by hair's breadths and
    # over 10 m as a run has it.
    count = 21 if step_m > 0.1 else 41
    states = [at(x + step_m * k, heading_deg=heading_deg) for k in range(count)]
    film = np.array([plain(state)[FAR] for state in states])
    steady = np.array([supersampled(state)[FAR] for state in states[:9]])
    flicker, reference = (f[1:-1] - (f[:-2] + f[2:]) / 2 for f in (film, steady))
    assert np.abs(np.diff(film, axis=0)).max() > 0, 'it moves'
    assert rms(flicker) < rms(reference) + most


def test_given_plain_asphalt_when_rows_are_compared_then_no_level_begins_with_a_step() -> None:
    # Asphalt between centreline and edge stripes, where a ruler along the runway has nothing but
    # its mottle: many places together leave what belongs to the picture and not to the ground.
    places = [*np.arange(1700.0, 2300.0, 9.7), *np.arange(1030.0, 1150.0, 9.7)]
    asphalt = np.abs(np.abs(ground_points(at(0.0))[:, OPEN, 1]) - 8) < 5.5
    rows = np.arange(10, 200)
    assert asphalt[rows].sum(axis=1).min() > 80
    light, texture = np.zeros(200), np.zeros(200)
    for x in places:
        picture = luminance(shot(at(x), clouds='overcast'))[:, OPEN]
        light += np.where(asphalt, picture, 0).sum(axis=1)
        grain = np.abs(np.diff(picture, axis=1))
        texture += np.where(asphalt[:, 1:], grain, 0).sum(axis=1)
    shots = len(places) * asphalt[rows].sum(axis=1)
    # In display codes, a row against the one before it.
    steps = [np.abs(np.diff(sums[rows] / shots)).max() for sums in (light, texture)]
    assert steps[0] < 1.3
    assert steps[1] < 0.5


SCENE = Scenario(distance_m=1000.0, cross_track_m=-6.0, shadows=False)
COLUMN = 300


def braking_run() -> list[AircraftState]:
    """States every 0.1 s: half a second of rolling, then the brakes until it has swung back."""
    aircraft = Aircraft(SCENE)
    return [
        aircraft.advance(TaxiCommand(steering_rad=0.0, speed_mps=5.0 if step < 5 else 0.0))
        for step in range(25)
    ]


def stripe_row(state: AircraftState) -> float:
    """Row at which the right edge stripe should cross the column."""
    edge = -edge_stripe_y_m(default_runway())
    points = np.array([(state.x_m + d, edge, 0.0) for d in np.linspace(4, 60, 600)])
    found = pixels(state, points)
    order = np.argsort(found[:, 0])
    return float(np.interp(COLUMN, found[order, 0], found[order, 1]))


def bright_row(state: AircraftState) -> float:
    """Row of the middle of the brightest band, nine rows wide, in the column."""
    picture = luminance(Camera(SCENE).render(state, 0).astype(np.float64))
    profile = picture[:, COLUMN - 2 : COLUMN + 3].mean(axis=1)
    wide = np.convolve(profile, np.ones(9) / 9, 'same')
    rows = np.arange(20, 180)
    beside = np.maximum(wide[rows - 12], wide[rows + 12])
    peak = int(rows[np.argmax(wide[rows] - beside)])
    window = np.arange(peak - 10, peak + 11)
    weight = np.clip(profile[window] - np.median(profile[window]) - 10, 0, None)
    return float(weight @ window / weight.sum())


def test_given_the_brakes_when_the_nose_dips_and_rises_then_the_edge_stripe_moves_as_projected():
    states = braking_run()
    pitches = [state.pitch_rad for state in states]
    level, dipped, raised = states[4], states[int(np.argmax(pitches))], states[
        int(np.argmin(pitches))
    ]
    assert math.degrees(dipped.pitch_rad - level.pitch_rad) > 2
    assert math.degrees(raised.pitch_rad - level.pitch_rad) < -0.5
    expected = [stripe_row(state) for state in (level, dipped, raised)]
    found = [bright_row(state) for state in (level, dipped, raised)]
    assert expected[1] < expected[0] - 10, 'nose down: what is ahead goes up in the picture'
    assert expected[2] > expected[0] + 3
    assert found == pytest.approx(expected, abs=1.5)


def test_given_the_nose_up_when_it_swings_back_then_the_horizon_comes_into_the_picture():
    states = braking_run()
    raised = min(states, key=lambda state: state.pitch_rad)
    far = raised.x_m + 1e6
    horizon = pixels(raised, np.array([[far, -4e5, 0.0]]))[0, 1]
    level = pixels(states[0], np.array([[far, -4e5, 0.0]]))[0, 1]
    assert level < 0.5 < 2 < horizon
    picture = Camera(SCENE).render(raised, 0).astype(np.float64)[:, OPEN]
    sky, ground = picture[: int(horizon) - 1], picture[int(horizon) + 8 : 60]
    assert sky[..., 2].mean() > sky[..., 0].mean() - 5, 'not the colour of the ground'
    assert luminance(sky).mean() > luminance(ground).mean() + 20


@pytest.mark.parametrize('heading_deg', [-20.0, 0.0, 20.0])
def test_given_points_when_projected_then_the_core_agrees_with_the_published_calibration(
    heading_deg: float,
):
    state = at(300.0, 2.0, heading_deg, pitch_deg=1.5)
    points = np.array([(x, y, z) for x in (310, 350, 900) for y in (-9, 3) for z in (0.0, 1.0)])
    np.testing.assert_allclose(project(state, points)[0], pixels(state, points), atol=1e-6)


PLACES_M = (600, 800, 1000, 1200, 1800, 2000, 2200, 2400)


def pictures(clouds: str) -> list[Picture]:
    return [shot(at(x), clouds=clouds)[:, OPEN] for x in PLACES_M]


def test_given_the_six_kinds_of_cloud_at_noon_then_each_has_a_light_of_its_own() -> None:
    # Mean luminance and contrast in display codes, and redness in per cent of blue.
    light, contrast, redness = {}, {}, {}
    for clouds in CLOUDS:
        shots = pictures(clouds)
        light[clouds] = float(np.mean([luminance(p).mean() for p in shots]))
        contrast[clouds] = float(np.mean([luminance(p).std() for p in shots]))
        redness[clouds] = float(np.mean([100 * p[..., 0].mean() / p[..., 2].mean() for p in shots]))
    falling = ('clear', 'cirrus', 'scattered', 'broken', 'overcast', 'stratus')
    assert min(light[a] - light[b] for a, b in pairwise(falling)) > 2.5
    assert light['stratus'] < 0.7 * light['clear']
    apart = [
        (a, b)
        for a, b in combinations(CLOUDS, 2)
        if abs(contrast[a] - contrast[b]) > 0.5 or abs(redness[a] - redness[b]) > 0.8
    ]
    assert apart == list(combinations(CLOUDS, 2))


def test_given_single_clouds_then_light_and_shade_lie_along_the_runway_and_else_they_do_not() -> (
    None
):
    clear = [luminance(p).mean() for p in pictures('clear')]
    patches = {}
    for clouds in CLOUDS[1:]:
        shares = np.array([luminance(p).mean() for p in pictures(clouds)]) / clear
        patches[clouds] = float(shares.std())
    for clouds in ('scattered', 'broken'):
        assert patches[clouds] > 0.02
    for clouds in ('cirrus', 'overcast', 'stratus'):
        assert patches[clouds] < 0.01

EARLY, LATE = 6.5, 17 + 38 / 60
"""Hours of the same low sun, nearly 5 degrees high, in the east and in the west."""


def far_and_near(hour: float, clouds: str = 'clear') -> tuple[Picture, Picture]:
    """The far and the near runway, seen eastwards."""
    picture = shot(at(900.0, heading_deg=-37.0), hour, clouds)[:, OPEN]
    return picture[3:25], picture[120:]


def test_given_a_low_sun_ahead_then_the_far_runway_is_veiled_and_warmer_than_with_it_behind() -> (
    None
):
    (ahead, near), (behind, as_near) = far_and_near(EARLY), far_and_near(LATE)
    veil = luminance(ahead) - luminance(behind)
    assert veil.mean() > 0.05 * luminance(behind).mean()
    assert veil.min() > -1.5, 'it takes nothing away'
    red, _, blue = (ahead - behind).mean(axis=(0, 1))
    assert red > 1.3 * blue
    assert luminance(near).mean() == pytest.approx(luminance(as_near).mean(), rel=0.02)


def test_given_a_high_or_hidden_sun_then_there_is_no_glare_to_speak_of() -> None:
    low = luminance(far_and_near(EARLY)[0]).mean() / luminance(far_and_near(LATE)[0]).mean() - 1
    # 28 degrees high in the south-east and in the south-west.
    high = luminance(far_and_near(9.0)[0]).mean() / luminance(far_and_near(15.13)[0]).mean() - 1
    assert abs(high) < low / 3
    hidden = [luminance(far_and_near(hour, 'overcast')[0]).mean() for hour in (EARLY, LATE)]
    assert hidden[0] <= hidden[1]
