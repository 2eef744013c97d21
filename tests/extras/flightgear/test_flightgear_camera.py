"""The camera flightgear against an independent stand-in: geometry, freshness, every failure."""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from taxinet_ros.core.camera.camera import project
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.renderer import ChosenRenderer, find_renderer
from taxinet_ros.core.rig.catalogue import find_camera
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.extras.flightgear import camera as flightgear_camera
from taxinet_ros.extras.flightgear import client
from taxinet_ros.extras.flightgear.scene import eye_of, lens_of, weather_of
from taxinet_ros.testing import check_camera
from tests.extras.flightgear.flightgear_peer import LINES_M, FlightGearPeer, serving

pytestmark = pytest.mark.nightly

SCENE = Scenario(place='bikf_10', time_of_day_s=13 * 3600.0, cross_track_m=2.0, distance_m=600.0)


@pytest.fixture(scope='module')
def served() -> Iterator[tuple[FlightGearPeer, str]]:
    """One stand-in for the file, so that its ground is asked for once."""
    peer = FlightGearPeer()
    with serving(peer) as (host, port):
        yield peer, f'{host}:{port}'


@pytest.fixture
def peer(
    served: tuple[FlightGearPeer, str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[FlightGearPeer]:
    peer, where = served
    peer.__init__()
    peer.properties['/sun'] = weather_of(SCENE).sun_angle_rad
    monkeypatch.setattr(flightgear_camera, '_POLLS', 4)
    monkeypatch.setenv(client.ADDRESS, where)
    yield peer
    flightgear_camera._connection(client.flightgear_address()).close()


@pytest.fixture
def renderer(peer: FlightGearPeer) -> ChosenRenderer:
    found = find_renderer('flightgear')
    assert found is not None
    return found


@pytest.mark.parametrize(('mount', 'heading_rad'), [('wing', 0.3), ('strut', 0.0), ('tail', -0.4)])
def test_given_a_pose_when_photographed_then_lines_are_where_the_camera_model_projects_them(
    mount, heading_rad, renderer
):
    scene = dataclasses.replace(SCENE, camera=mount, heading_rad=heading_rad)
    state = Aircraft(scene).state
    image = renderer.make(scene).render(state, 0)
    model = scene.camera_model
    found = 0
    # In the strut's wide lens, the lines aside are thinner than a pixel.
    for line_m in LINES_M if mount != 'strut' else (0.0,):
        along = state.x_m + np.linspace(4.0, 40.0, 300)
        points = np.stack([along, np.full_like(along, line_m), np.zeros_like(along)], axis=1)
        pixels, depth = project(state, points, model)
        inside = (depth > 2) & np.all((pixels > 3) & (pixels < [
            model.width_px - 4, model.height_px - 4
        ]), axis=1)
        for u, v in np.rint(pixels[inside]).astype(int):
            # Within a pixel of where it has to be, the line's white is there.
            assert image[v - 1:v + 2, u - 1:u + 2].min(axis=2).max() > 110, (line_m, u, v)
            found += 1
    assert found > 50


def test_given_a_moving_aircraft_when_photographed_then_each_frame_shows_its_own_state(
    peer, renderer
):
    world = find_world('kmwh+flightgear').make(SCENE)
    image = world.observe().image
    assert image is not None
    away = dataclasses.replace(Aircraft(SCENE).state, y_m=-4.0, yaw_rad=0.3)
    camera = renderer.make(SCENE)
    other = camera.render(away, 0)
    assert not np.array_equal(other, image)
    assert np.array_equal(camera.render(Aircraft(SCENE).state, 0), image)


def test_given_the_stand_in_when_the_contract_is_checked_then_it_is_kept(peer):
    check_camera('flightgear', SCENE)


def test_given_weather_when_photographed_then_it_has_been_set_and_read_back(peer, renderer):
    rainy = dataclasses.replace(
        SCENE, clouds='stratus', rain_fraction=0.5, date='2020-06-21', time_of_day_s=9.5 * 3600
    )
    weather = weather_of(rainy)
    peer.properties['/sun'] = weather.sun_angle_rad
    renderer.make(rainy).render(Aircraft(rainy).state, 0)
    shown = peer.shown
    assert shown['/environment/clouds/layer[0]/coverage'] == 'overcast'
    assert shown['/environment/rain-norm'] == shown['/environment/metar/rain-norm'] == 0.5
    assert shown['/sim/time/cur-time-override'] == weather.time_s == 1592731800
    assert shown['/environment/visibility-m'] == pytest.approx(weather.visibility_m)
    assert shown['/sim/freeze/master'] == 1


@pytest.mark.parametrize(('path', 'said'), [
    ('/position/latitude-deg', r'the eye is \d+\.\d+ m away'),
    ('/orientation/heading-deg', 'the eye is turned otherwise'),
    ('/sim/current-view/field-of-view', 'the field of view is 55 degrees'),
    ('/sim/time/cur-time-override', 'its clock is at 1970-01-01T00:00:00'),
    ('/environment/visibility-m', 'its visibility is 5000 m'),
    ('/environment/clouds/layer[0]/coverage', 'its clouds are few'),
    ('/taxinet/request', 'it does not take up what was set'),
])
def test_given_a_property_that_does_not_take_effect_when_photographed_then_the_line_names_it(
    path, said, peer, renderer
):
    peer.stuck.add(path)
    camera = renderer.make(SCENE)
    with pytest.raises(InfraError, match=f'^sim: .*step 3.*{said}'):
        camera.render(Aircraft(SCENE).state, 300_000_000)


def test_given_a_sun_elsewhere_when_photographed_then_the_line_names_both(peer, renderer):
    peer.properties['/sun'] = weather_of(SCENE).sun_angle_rad + math.radians(5)
    camera = renderer.make(SCENE)
    with pytest.raises(InfraError, match=r'its sun is \d+\.\d degrees from the zenith, ours'):
        camera.render(Aircraft(SCENE).state, 0)


def broken() -> tuple[int, bytes]:
    raise ConnectionAbortedError


PICTURE, TOLD = '/screenshot', '/json/taxinet'


@pytest.mark.parametrize(('change', 'said'), [
    ({'answers': {PICTURE: broken}}, r'^died: .*answers no more'),
    ({'answers': {'/run.cgi': lambda: (200, b'what?')}}, r"^protocol: .*refused a script: b'what"),
    ({'answers': {PICTURE: lambda: (500, b'')}}, r'^protocol: .*answered 500'),
    ({'answers': {PICTURE: lambda: (200, b'P6\n9 9\n255\nxx')}}, r'^protocol: .*no whole picture'),
    ({'answers': {PICTURE: lambda: (200, b'<html>')}}, r'^protocol: .*no whole picture'),
    ({'answers': {PICTURE: lambda: (200, b'P6\n480 288\n255\n' + bytes(480 * 288 * 3))}},
     r'^sim: .*its picture has one colour'),
    ({'answers': {TOLD: lambda: (200, b'<html>')}}, r'^protocol: .*not answer like FlightGear'),
    ({'answers': {TOLD: lambda: (200, b'{"value": "a b c"}')}},
     r"^protocol: .*frame loop told 'a b c'"),
    ({'frozen': True}, r'^sim: .*it draws no frames'),
    ({'flicker': True}, r'^sim: .*goes on changing'),
    ({'size_px': (400, 240)}, r'^sim: .*resized to 400 x 240'),
], ids=['crash', 'refused', 'error', 'torn picture', 'no picture', 'black', 'page', 'nonsense',
        'frozen', 'flicker', 'resized'])
def test_given_a_failure_during_a_run_when_photographed_then_one_line_names_its_kind(
    change: dict[str, Any], said: str, peer: FlightGearPeer, renderer: ChosenRenderer
):
    state, camera = Aircraft(SCENE).state, renderer.make(SCENE)
    for name, value in change.items():
        setattr(peer, name, value)
    with pytest.raises(InfraError, match=said) as caught:
        camera.render(state, 100_000_000)
    assert caught.value.step == 1
    assert '\n' not in str(caught.value)
    peer.answers, peer.flicker, peer.frozen, peer.size_px = {}, False, False, (480, 288)
    assert renderer.make(SCENE).render(state, 0).shape == (200, 360, 3), 'the next run goes on'


def test_given_somebody_who_sets_it_meanwhile_when_photographed_then_the_picture_is_refused(
    peer, renderer, monkeypatch
):
    camera = renderer.make(SCENE)
    draw = peer.picture

    def meddle() -> Any:
        # A turned eye is in the next picture, whichever of view and picture is told first.
        picture = draw()
        peer.properties |= {'/taxinet/request': 'mine', '/orientation/heading-deg': 40.0}
        return picture

    monkeypatch.setattr(peer, 'picture', meddle)
    with pytest.raises(InfraError, match=r'^intruder: .*somebody has set it'):
        camera.render(Aircraft(SCENE).state, 0)


def test_given_a_silent_peer_when_asked_then_it_is_a_timeout(peer, monkeypatch):
    monkeypatch.setattr(client, '_ANSWER_S', 0.2)
    peer.silent_s = 0.5
    with pytest.raises(InfraError, match=r'^timeout: .* has not answered for 0.2 s'):
        client.FlightGear().value('/sim/version/flightgear')
    peer.silent_s = 0.0


def test_given_nobody_when_asked_then_the_line_says_how_to_start_it(monkeypatch):
    monkeypatch.setenv(client.ADDRESS, '127.0.0.1:1')
    found = find_renderer('flightgear')
    assert found is not None
    with pytest.raises(InfraError, match=r'^not_ready: .*nobody answers at 127\.0\.0\.1:1: Connec'
                                         r'tion refused; start it with: taxinet flightgear start'):
        found.make(SCENE)
    monkeypatch.setenv(client.ADDRESS, 'somewhere')
    with pytest.raises(UsageError, match='expected HOST:PORT, such as 127'):
        found.make(SCENE)


@pytest.mark.parametrize(('path', 'value', 'said'), [
    ('/sim/version/flightgear', '2024.1.1', r'^protocol: .*is FlightGear 2024.1.1; known is 2020'),
    ('/sim/aircraft', 'c172p', r'^protocol: .*has the aircraft c172p'),
    ('/sim/flight-model', 'yasim', r'^protocol: .*has the flight model yasim'),
    ('/sim/sceneryloaded', False, r'^not_ready: .*still loading'),
])
def test_given_another_flightgear_when_a_run_begins_then_the_line_says_which(
    path, value, said, peer, renderer
):
    peer.properties[path] = value
    with pytest.raises(InfraError, match=said):
        renderer.make(SCENE)


@pytest.mark.parametrize(('change', 'said'), [
    ({'place': 'kmwh_04', 'distance_m': 400.0}, r'its nearest runway .* is \d+ m away'),
    ({'crossing': False}, 'does not show crossing'),
])
def test_given_a_scene_that_it_does_not_show_when_a_run_begins_then_it_is_refused(
    change: dict[str, Any], said: str, peer: FlightGearPeer, renderer: ChosenRenderer
):
    with pytest.raises(UsageError, match=said):
        renderer.make(dataclasses.replace(SCENE, **change))


def test_given_no_runway_or_terrain_when_a_run_begins_then_the_line_says_which(
    peer, renderer, monkeypatch
):
    monkeypatch.setattr(flightgear_camera, '_GROUNDS', {})
    peer.runways = False
    with pytest.raises(UsageError, match='it has no runway of BIKF; take a place that it has'):
        renderer.make(SCENE)
    peer.runways, peer.terrain = True, False
    with pytest.raises(UsageError, match='it has no terrain at bikf_10; start it there'):
        renderer.make(SCENE)


def test_given_a_lens_too_sharp_for_the_window_when_a_run_begins_then_the_line_tells_a_size():
    wing = find_camera('wing')
    lens = lens_of(wing, 480, 288)
    assert 1.0 <= lens.focal_px / max(wing.focal_px) < 1.05
    with pytest.raises(UsageError, match=r'for camera wing; start it with a size of 3\d\dx2\d\d'):
        lens_of(wing, 240, 144)


def test_given_two_runs_at_once_when_photographed_then_each_gets_its_own_pictures(peer, renderer):
    states = [dataclasses.replace(Aircraft(SCENE).state, y_m=y_m) for y_m in (-5.0, 5.0)]
    alone = [renderer.make(SCENE).render(state, 0) for state in states]
    found: list[list[bool]] = [[], []]

    def drive(number: int) -> None:
        # Each process has a connection of its own.
        camera = flightgear_camera.FlightGearCamera(SCENE)
        camera._flightgear = client.FlightGear()
        for _ in range(2):
            image = camera.render(states[number], 0)
            found[number].append(bool(np.array_equal(image, alone[number])))
        camera._flightgear.close()

    threads = [threading.Thread(target=drive, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [[True] * 2] * 2


def test_given_level_ground_when_seen_from_above_then_the_eye_looks_down_and_north_is_up(
    peer, renderer
):
    camera = flightgear_camera.FlightGearCamera(SCENE)
    model = dataclasses.replace(
        SCENE.camera_model, offset_m=(0.0, 0.0, 60.0), roll_rad=0.0, pitch_rad=math.pi / 2,
        yaw_rad=math.pi / 2,
    )
    eye = eye_of(dataclasses.replace(Aircraft(SCENE).state, roll_rad=0.0, pitch_rad=0.0,
                                     yaw_rad=0.0), model, camera.ground)
    assert eye.pitch_deg == pytest.approx(-90.0, abs=0.6)  # the ground rises by 0.8 %
