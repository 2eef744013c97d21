"""The aircraft's own motion moves the picture: it nods when it brakes, and the runway with it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from picture_samples import OPEN, at, luminance, pixels

from taxinet_ros.core.aircraft import Aircraft
from taxinet_ros.core.camera import Camera, project
from taxinet_ros.core.runway import EDGE_STRIPE_Y_M
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState, TaxiCommand

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
    points = np.array([(state.x_m + d, -EDGE_STRIPE_Y_M, 0.0) for d in np.linspace(4, 60, 600)])
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
