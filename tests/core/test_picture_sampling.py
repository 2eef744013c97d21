"""The ground's textures neither shimmer nor show moire or the borders of their levels.

The reference is the mean of sixteen pictures whose optical axis is turned by parts of a pixel: what
a picture with four times the samples each way would be.
"""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from picture_samples import FOCAL, OPEN, at, ground_points, luminance, shot

from taxinet_ros.core.types import AircraftState

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
