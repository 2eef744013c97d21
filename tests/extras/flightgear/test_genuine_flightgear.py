"""The camera flightgear against the genuine program, where it is installed (Debian: 1.9 GB)."""

from __future__ import annotations

import dataclasses
import math
import socket
from collections.abc import Iterator

import numpy as np
import pytest
from flightgear_opinion import compare_light, compare_scene, light_scenes, scenes

from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.renderer import find_renderer
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.flightgear import client, process
from taxinet_ros.extras.flightgear.camera import FlightGearCamera
from taxinet_ros.testing import check_camera

pytestmark = [pytest.mark.nightly, pytest.mark.flightgear, pytest.mark.timeout(3600)]

NOON = Scenario(place='bikf_10', time_of_day_s=13 * 3600.0, cross_track_m=0.0, distance_m=700.0)
STRIPES_M = (28.33, -28.85)
"""Where FlightGear's runway texture has its side stripes, as seen from above."""


@pytest.fixture(scope='module')
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    try:
        for name in ('fgfs', 'Xvfb'):
            process.find_program(name)
    except UsageError as error:
        pytest.skip(f'{error}')
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        port = free.getsockname()[1]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('XDG_CACHE_HOME', str(tmp_path_factory.mktemp('cache')))
        patch.setenv(client.ADDRESS, f'127.0.0.1:{port}')
        with process.started('127.0.0.1', port) as started:
            yield
            assert not started.dead


def test_given_the_program_when_the_contract_is_checked_then_it_is_kept(running):
    check_camera('flightgear', NOON)


@pytest.mark.parametrize(('y_m', 'heading_deg', 'stripe'), [
    (-8.0, 0.0, 1), (10.0, 14.0, 0), (-12.0, -25.0, 1), (12.0, 25.0, 0),
])
def test_given_a_pose_when_photographed_then_the_side_stripe_is_where_our_camera_projects_it(
    y_m, heading_deg, stripe, running
):
    from taxinet_ros.core.camera.camera import project

    scene = dataclasses.replace(
        NOON, cross_track_m=y_m, heading_rad=math.radians(heading_deg), distance_m=1500.0
    )
    state, found = Aircraft(scene).state, find_renderer('flightgear')
    assert found is not None
    light = found.make(scene).render(state, 0).astype(float).min(axis=2)
    along = state.x_m + np.linspace(2.0, 60.0, 600)
    points = np.stack(
        [along, np.full_like(along, STRIPES_M[stripe]), np.zeros_like(along)], axis=1
    )
    pixels, depth = project(state, points, scene.camera_model)
    inside = (depth > 1) & np.all((pixels > 8) & (pixels < [351, 191]), axis=1)
    away = []
    for u, v in pixels[inside]:
        column, row = round(u), round(v)
        paint = np.clip(light[row - 6:row + 7, column] - 110, 0, None)
        if paint.sum() > 30:
            away.append(float((np.arange(row - 6, row + 7) * paint).sum() / paint.sum() - v))
    assert len(away) > 20
    assert abs(np.median(away)) < 1.0


@pytest.mark.parametrize('number', [0, 2, 4], ids=['wing', 'rolled', 'tail'])
def test_given_a_pose_then_its_paint_is_where_our_camera_projects_what_is_seen_from_above(
    number, running
):
    found = compare_scene(scenes({})[number])
    figures = found.markings.summary()
    assert (figures['measured'] or 0) > 200
    assert (figures['median_px'] or 9) < 0.3
    assert found.meets_aim


def test_given_noon_and_morning_then_its_light_is_measured(running):
    curves = compare_light(light_scenes({})[1:6:4])
    for surface in ('pavement', 'paint', 'ground', 'sky'):
        ours, theirs = curves.relative(surface)
        assert ours[0] < ours[1]
        assert theirs[0] < theirs[1]
    ours, theirs = curves.contrast()
    assert theirs.min() > 3 * ours.max(), 'its asphalt is nearly black beside its paint'


def test_given_a_moving_eye_when_it_is_back_then_the_picture_is_the_first(running):
    camera, state = FlightGearCamera(NOON), Aircraft(NOON).state
    first = camera.render(state, 0)
    camera.render(dataclasses.replace(state, x_m=state.x_m + 400.0), 0)
    again = camera.render(state, 0)
    changed = np.abs(first.astype(np.int16) - again).max(axis=2) > 5
    assert changed.mean() < 0.01


def test_given_a_place_without_terrain_when_a_run_begins_then_it_is_refused(running):
    with pytest.raises(UsageError, match='no terrain at kmwh_04'):
        FlightGearCamera(Scenario())


def test_given_a_port_that_is_taken_when_started_then_the_line_names_it(running, tmp_path):
    host, port = client.flightgear_address()
    with pytest.raises(UsageError, match=f'{port}: Address already in use; choose another'), \
            process.started(host, port):
        pass
