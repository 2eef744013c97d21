"""Our camera against FlightGear's: its paint is surveyed from above, and found where we project it.

Against the independent stand-in of the camera's tests; tests/extras/flightgear has the genuine
program.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace

import flightgear_opinion
import numpy as np
import pytest
import second_opinion

from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.extras.flightgear import camera as flightgear_camera
from taxinet_ros.extras.flightgear import client
from taxinet_ros.extras.flightgear.scene import weather_of
from tests.extras.flightgear.flightgear_peer import FlightGearPeer, serving

pytestmark = pytest.mark.nightly
SCENES = flightgear_opinion.SCENES
WING, ROLLED = SCENES[0], SCENES[2]


@pytest.fixture
def peer(monkeypatch: pytest.MonkeyPatch) -> Iterator[FlightGearPeer]:
    peer = FlightGearPeer()
    peer.properties['/sun'] = weather_of(flightgear_opinion.scenes({})[0]).sun_angle_rad
    with serving(peer) as (host, port):
        monkeypatch.setenv(client.ADDRESS, f'{host}:{port}')
        yield peer
        flightgear_camera._connection((host, port)).close()


@pytest.mark.parametrize('scene', [WING, ROLLED], ids=['wing', 'rolled'])
def test_given_a_pose_then_paint_is_where_our_camera_projects_what_is_seen_from_above(
    scene, peer, monkeypatch,
):
    monkeypatch.setattr(flightgear_opinion, 'SCENES', (scene,))
    (scenario,) = flightgear_opinion.scenes({'cross_track_m': 3})
    found = flightgear_opinion.compare_scene(scenario)
    figures = found.markings.summary()
    assert figures['measured'] > 50
    assert figures['median_px'] < 0.1
    assert figures['p95_beyond_8_m_px'] < 0.3
    assert found.meets_aim
    assert found.sun_apart_deg < 0.01
    assert found.shadow is found.theirs is None


def test_given_a_camera_that_looks_aside_by_a_pixel_then_it_is_told(peer, monkeypatch):
    monkeypatch.setattr(flightgear_opinion, 'SCENES', (ROLLED,))
    (scenario,) = flightgear_opinion.scenes({'cross_track_m': 3})
    ground, turn_rad = flightgear_opinion._Ground, math.atan(1 / scenario.camera_model.focal_px[0])
    monkeypatch.setattr(
        flightgear_opinion, '_Ground',
        lambda model, state: ground(replace(model, yaw_rad=model.yaw_rad + turn_rad), state),
    )
    figures = flightgear_opinion.compare_scene(scenario).markings.summary()
    # Across the lines, which are not upright in the picture.
    assert 0.6 < figures['median_px'] < 1.0
    assert figures['p95_beyond_8_m_px'] == pytest.approx(1.0, abs=0.15)


def test_given_a_runway_without_paint_then_nothing_is_told_of_it(peer, monkeypatch):
    monkeypatch.setattr(flightgear_opinion, 'SCENES', (WING,))
    draw = peer.picture
    peer.picture = lambda: np.minimum(draw(), 90)  # type: ignore[method-assign]
    (scenario,) = flightgear_opinion.scenes({})
    found = flightgear_opinion.compare_scene(scenario)
    assert found.markings.found == 0
    assert found.meets_aim is None


def test_given_a_day_then_light_is_that_of_each_surface_in_its_picture(peer, monkeypatch):
    monkeypatch.setattr(flightgear_opinion, 'HOURS', (3.0, 13.5))
    curves = flightgear_opinion.compare_light(flightgear_opinion.light_scenes({'cross_track_m': 1}))
    (noon,) = curves.hours
    grey = {'pavement': 70, 'paint': 240}
    for surface, code in grey.items():
        assert noon.theirs[surface] == pytest.approx((code / 255) ** 2.2, rel=0.03), surface
    assert noon.theirs['sky'] > noon.theirs['ground'] > noon.theirs['pavement']
    assert noon.ours['sky'] > noon.ours['paint'] > noon.ours['pavement']
    assert noon.shade_theirs is None
    json.dumps(curves.to_dict(), allow_nan=False)


@pytest.mark.parametrize(('settings', 'words'), [
    ({'crossing': 'off'}, 'crossing is False'), ({'speed_mps': 3}, 'speed_mps is 3'),
    ({'clouds': 'overcast', 'rain_percent': 20}, 'rain_percent is 20'),
])
def test_given_what_is_not_compared_then_it_is_refused_by_name(settings, words):
    with pytest.raises(UsageError, match=f'^flightgear: {words}'):
        flightgear_opinion.scenes(settings)


def test_given_nobody_there_then_it_is_said_how_to_start_it_and_nothing_is_written(
    monkeypatch, tmp_path,
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(client.ADDRESS, '127.0.0.1:1')
    with pytest.raises(InfraError, match='start it with: taxinet flightgear start'):
        second_opinion.main(['flightgear'])
    assert list(tmp_path.iterdir()) == []


def test_given_it_runs_then_there_are_values_and_a_figure(peer, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(flightgear_opinion, 'HOURS', (13.5,))
    monkeypatch.setattr(flightgear_opinion, 'SCENES', (WING,))
    assert second_opinion.main(['flightgear', '--json', '--out', 'f.png']) == 0
    values = json.loads(capsys.readouterr().out)
    assert (values['against'], values['missed_aim'], values['unclear']) == ('flightgear', 0, 0)
    assert values['scenes'][0]['markings']['p95_beyond_8_m_px'] < 1
    assert values['light']['hours'][0]['theirs']['paint'] > 0.5
    assert (tmp_path / 'f.png').stat().st_size > 20_000


def test_given_the_default_scenes_then_they_have_several_cameras_and_stretches():
    found = flightgear_opinion.scenes({})
    assert len({one.camera_model.name for one in found}) == 4
    assert len(flightgear_opinion.light_scenes({})) > 8
    assert all(one == scenario_from_human(one.to_human()) for one in found)
