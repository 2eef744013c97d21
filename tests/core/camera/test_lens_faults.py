"""What dirt, drops, ghosts and the exposure do to the light of a picture."""

from __future__ import annotations

import numpy as np
import pytest
from picture_samples import at

from taxinet_ros.core.camera.camera import Camera, intrinsics, project
from taxinet_ros.core.camera.lens_faults import LensFaults
from taxinet_ros.core.camera.light import display_code, scenario_light
from taxinet_ros.core.scenario import scenario_from_human

STATE = at(y=1.0, heading_deg=-3.0)
MORNING = {'time_of_day': 7.0}
AHEAD = np.eye(3)


def shot(**values) -> np.ndarray:
    return Camera(scenario_from_human(values)).render(STATE, 0).astype(int)


def faults(**values) -> LensFaults:
    scenario = scenario_from_human(values)
    return LensFaults(scenario, scenario_light(scenario), intrinsics(), (200, 360))


def touched(**values) -> np.ndarray:
    """Where a picture of black and white dots changes, (200, 360)."""
    dots = np.random.default_rng(0).choice(np.array([0, 235], np.uint8), (200, 360, 1))
    picture = np.repeat(dots, 3, axis=2)
    seen = faults(**values).apply(picture.copy(), AHEAD, 0).astype(int)
    return np.abs(seen - picture).max(axis=2) > 40


@pytest.mark.parametrize('key', ['lens_dirt', 'lens_drops'])
def test_given_more_spots_of_a_seed_then_as_much_is_covered_as_asked_and_what_was_before(key):
    covered = {
        percent: touched(**{key: percent, 'fault_seed': 3}, time_of_day=16)
        for percent in (5, 20, 50, 100)
    }
    for percent, mask in covered.items():
        # Edges are soft.
        assert 100 * mask.mean() == pytest.approx(percent, abs=3 + percent / 8), percent
    for less, more in ((5, 20), (20, 50), (50, 100)):
        assert (covered[less] & ~covered[more]).mean() < 0.003
    assert not touched(lens_dirt=1e-4, time_of_day=16).any()


def test_given_a_drop_then_it_shows_a_blurred_view_upside_down():
    well, wet = shot(time_of_day=10), shot(time_of_day=10, lens_drops=50, fault_seed=3)
    apart = np.abs(well - wet).max(axis=2) > 8
    assert 0.1 < apart.mean() < 0.6
    rough = [np.abs(np.diff(image[:, :, 1], axis=1))[apart[:, 1:]].mean() for image in (well, wet)]
    assert rough[1] < 0.6 * rough[0]


@pytest.mark.parametrize('stops', [-3.0, -1.0, 1.0])
def test_given_another_exposure_then_linear_light_is_that_many_stops_away(stops):
    grey = np.full((200, 360, 3), 90, np.uint8)
    (code,) = np.unique(faults(exposure_jump=stops).apply(grey, AHEAD, 0))
    linear = np.interp(90, display_code(np.linspace(0, 1, 10**6)), np.linspace(0, 1, 10**6))
    assert code == np.rint(display_code(np.array(linear * 2**stops)))


def test_given_every_code_when_nothing_changes_its_light_then_it_is_the_same():
    codes = np.arange(256, dtype=np.uint8).reshape(16, 16)
    ramp = np.zeros((200, 360, 3), np.uint8)
    ramp[:16, :16] = codes[:, :, None]
    nearly = faults(exposure_jump=1e-6).apply(ramp.copy(), AHEAD, 0)
    assert np.array_equal(nearly, ramp)


def test_given_the_sun_ahead_then_its_ghosts_are_on_the_line_through_the_principal_point():
    added = (shot(**MORNING, glare_ghost=100) - shot(**MORNING)).sum(axis=2)[:, 70:]
    assert added.min() > 0, 'a veil lies over the whole picture'
    light = scenario_light(scenario_from_human(MORNING))
    (sun,), _ = project(STATE, 1e7 * light.sun[None])
    centre = intrinsics()[:2, 2]
    way = (sun - centre) / np.linalg.norm(sun - centre)
    smooth = added > np.quantile(added, 0.995)
    rows, columns = np.nonzero(smooth)
    points = np.column_stack([columns + 70, rows]) - centre
    beside = np.abs(points @ np.array([-way[1], way[0]]))
    assert np.median(beside) < 20 < np.abs(points @ way).max()


@pytest.mark.parametrize('values', [
    {'time_of_day': 16.5}, {'time_of_day': 7.0, 'clouds': 'overcast'}, {'time_of_day': 3.0},
])
def test_given_no_sun_before_the_lens_then_there_are_no_ghosts(values):
    assert np.array_equal(shot(**values, glare_ghost=100), shot(**values))
