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
import pytest
import second_opinion

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
