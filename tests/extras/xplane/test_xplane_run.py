"""X-Plane as camera and as world: the protocol of a run, against a fake one."""

from __future__ import annotations

import dataclasses
import json
import math
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fake_xplane import FakeScreen, FakeXPlane, setup_of
from waiting import wait_for

from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.rig.catalogue import find_camera
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.core.world import close_world, find_world
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.extras.xplane.camera import (
    ViewFromXPlane,
    XPlaneCamera,
    check_picture,
    developed,
    field_of_view_deg,
)
from taxinet_ros.extras.xplane.setup import XPlaneSetup, chosen_setup, read_setup
from taxinet_ros.extras.xplane.simulator import XPlane, pose_of
from taxinet_ros.extras.xplane.sky import time_settings, weather_settings, zulu
from taxinet_ros.extras.xplane.world import XPlaneWorld

POSITION = 'sim/flightmodel/position/'
REGION = 'sim/weather/region/'
HELD = 'sim/operation/override/override_planepath'
SCENE = scenario_from_human({
    'cross_track_m': 2.5, 'distance_m': 600, 'heading_deg': 6, 'clouds': 'broken',
    'rain_percent': 40, 'time_of_day_h': 16.5, 'duration_s': 2,
})
PLAIN = Scenario(duration_s=2.0)
AHEAD = TaxiCommand(steering_rad=0.0, speed_mps=5.0)


def camera(sim: FakeXPlane, scenario: Scenario = SCENE, **more: object) -> XPlaneCamera:
    return sim.client(XPlaneCamera(scenario, setup_of(sim, **more), lambda *_: FakeScreen(sim)))


def world(sim: FakeXPlane, scenario: Scenario = PLAIN, **more: object) -> XPlaneWorld:
    return sim.client(XPlaneWorld(
        scenario, setup=setup_of(sim, **more), open_screen=lambda *_: FakeScreen(sim)
    ))


def impatient(xplane: XPlane) -> XPlane:
    """Shortens the limit of what the simulator does, not that of its answers."""
    xplane.setup = dataclasses.replace(xplane.setup, timeout_s=0.2)
    return xplane


@pytest.mark.parametrize('wire', ['web', 'connect'])
def test_the_aircraft_is_where_the_state_is(sim, wire):
    state = Aircraft(SCENE).state
    camera(sim, wire=wire).render(state, 0)
    wanted = pose_of(SCENE, state)
    value = {name: sim.values[POSITION + name] for name in
             ('latitude', 'longitude', 'y_agl', 'true_psi', 'theta', 'phi')}
    north_m = (value['latitude'] - wanted.latitude_deg) * 111_132
    east_m = (value['longitude'] - wanted.longitude_deg) * 75_500
    assert math.hypot(north_m, east_m) < 0.02
    assert value['y_agl'] == pytest.approx(state.z_m, abs=0.02)
    assert value['true_psi'] == pytest.approx(wanted.heading_deg, abs=0.05)
    assert value['theta'] == pytest.approx(-math.degrees(state.pitch_rad), abs=0.05)
    assert value['phi'] == pytest.approx(math.degrees(state.roll_rad), abs=0.05)
    assert sim.values['sim/time/paused'] == 1
    assert sim.values[HELD][0] == 1


def test_a_state_goes_to_x_plane_and_back():
    state = dataclasses.replace(Aircraft(SCENE).state, speed_mps=4.0, yaw_rate_radps=0.1)
    back = pose_of(SCENE, state).state(SCENE, 4.0, -math.degrees(0.1))
    assert dataclasses.astuple(back) == pytest.approx(dataclasses.astuple(state), abs=1e-6)


def test_time_and_weather_of_x_plane_12(sim):
    camera(sim)
    value = sim.values
    assert value['sim/time/local_date_days'] == 79  # 20 March
    # 16:30 at KMWH, without daylight saving as in the paper, is 0:30 GMT.
    assert value['sim/time/zulu_time_sec'] == 1800.0
    assert value[REGION + 'cloud_coverage_percent'] == [0.75, 0.0, 0.0]
    assert value[REGION + 'cloud_type'][0] == 2.0
    assert value[REGION + 'rain_percent'] == pytest.approx(0.4)
    assert value[REGION + 'runway_friction'] == 0.0
    assert value[REGION + 'change_mode'] == 3
    assert 'sim/operation/regen_weather' in sim.commands
    assert value['sim/time/total_flight_time_sec'] >= 10.1


def test_weather_of_x_plane_11_has_the_numbers_of_the_paper():
    found = {one.name: one.value for one in weather_settings(SCENE, '115501', moves=True)}
    assert found['sim/weather/cloud_type[0]'] == 3.0
    assert found['sim/weather/rain_percent'] == pytest.approx(0.4)
    assert found['sim/weather/use_real_weather_bool'] == 0.0
    assert not any('region' in name for name in found)


def test_wind_only_where_x_plane_moves_the_aircraft():
    windy = dataclasses.replace(PLAIN, wind_speed_mps=7.0, wind_direction_rad=math.pi / 2)
    for version, speed, direction in (
        ('12.4.0', REGION + 'wind_speed_msc', REGION + 'wind_direction_degt'),
        ('115501', 'sim/weather/wind_speed_kt[0]', 'sim/weather/wind_direction_degt[0]'),
    ):
        found = {one.name: one.value for one in weather_settings(windy, version, moves=True)}
        twelve = version.startswith('12.')
        assert found[speed] == ((7.0,) * 13 if twelve else pytest.approx(7.0 * 3600 / 1852))
        assert found[direction] == pytest.approx((90.0,) * 13 if twelve else 90.0)
        still = weather_settings(windy, version, moves=False)
        assert not any('wind' in one.name for one in still)


@pytest.mark.parametrize(('hours', 'seconds'), [(6, 14 * 3600), (20, 4 * 3600)])
def test_time_is_gmt(hours, seconds):
    scene = scenario_from_human({'time_of_day_h': hours})
    assert zulu(scene) == (79.0, float(seconds))
    assert time_settings(scene, 5.0)[2].value == seconds


def test_the_view_is_where_the_camera_is_mounted(sim):
    made = camera(sim)
    model, value = find_camera('wing'), sim.values
    view = 'sim/graphics/view/'
    assert value[view + 'pilots_head_x'] == pytest.approx(-model.offset_m[1])
    assert value[view + 'pilots_head_y'] == pytest.approx(model.offset_m[2])
    assert value[view + 'pilots_head_z'] == pytest.approx(-model.offset_m[0])
    assert value[view + 'pilots_head_psi'] == pytest.approx(-math.degrees(model.yaw_rad))
    assert value[view + 'pilots_head_the'] == pytest.approx(-math.degrees(model.pitch_rad))
    assert value[view + 'field_of_view_deg'] == pytest.approx(made._view.fov_deg)
    assert sim.commands[-1] == 'sim/view/forward_with_nothing'


def test_pictures_have_the_camera_s_shape_and_follow_the_aircraft(sim):
    made, state = camera(sim), Aircraft(SCENE).state
    first = made.render(state, 0)
    there = dataclasses.replace(state, x_m=state.x_m + 5.0)
    assert first.shape == SCENE.camera_model.shape
    assert first.dtype == np.uint8
    assert not np.array_equal(first, made.render(there, 100_000_000))


def test_a_covered_window():
    with pytest.raises(InfraError, match='sim: x-plane: the picture has one colour'):
        check_picture(np.full((720, 1280, 3), 30, np.uint8), (1280, 720))


def deaf(sim: FakeXPlane, words: str) -> None:
    """Nothing whose name has these words can be set."""
    plain = sim.set
    sim.set = lambda name, *more: None if words in name else plain(name, *more)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('spoil', 'words'), [
    (lambda sim: setattr(sim, 'view_off', (0.0, 0.3, 0.0)),
     r'sim: x-plane: the view is 0.30 m and 0.0 deg from wher'),
    (lambda sim: sim.values.update({'sim/aircraft/view/acf_ui_name': b'Cessna 172'}),
     "sim: x-plane: the aircraft is 'Cessna 172', expected '208B'"),
    (lambda sim: (sim.values.update({REGION + 'rain_percent': 0.9}), deaf(sim, 'rain')),
     r'sim: x-plane: .*rain_percent is 0.9 after it was'),
    (lambda sim: deaf(sim, 'local_x'), r'sim: x-plane: the aircraft stays .* m, .* another'),
    (lambda sim: sim.values.update({POSITION + 'local_x': 500_000.0}),
     r'not_ready: x-plane: X-Plane is .* km from the runway'),
    (lambda sim: setattr(sim, 'version', 'twelve'),
     r'protocol: x-plane: .* is of no known version'),
])
def test_a_run_that_cannot_begin(sim, spoil, words):
    spoil(sim)
    with pytest.raises(InfraError, match=f'^{words}'):
        camera(sim, aircraft='208B')


@pytest.mark.parametrize(('words', 'use', 'complaint'), [
    ('sim_speed', lambda one: one.pause(True), 'it cannot be paused'),
    ('', lambda one: one.frames(1), 'it draws no frames'),
])
def test_a_simulator_that_does_not_do_it_in_time(sim, words, use, complaint):
    xplane = impatient(sim.client(XPlane(setup_of(sim))))
    deaf(sim, words)
    if not words:
        sim.frame = lambda: None
    with pytest.raises(InfraError, match=f'timeout: x-plane: after 0.2 s {complaint}'):
        use(xplane)


def test_frames_are_counted_while_paused_though_no_time_grows(sim):
    sim.up_while_paused = False
    made, state = camera(sim), Aircraft(SCENE).state
    assert made.render(state, 0).shape == SCENE.camera_model.shape


@pytest.mark.nightly
@pytest.mark.parametrize(('spoil', 'words'), [
    (lambda sim: setattr(sim, 'frozen_screen', True),
     'timeout: x-plane: its picture stayed the same'),
    (lambda sim: setattr(sim, 'size', (640, 480)),
     'sim: x-plane: the picture has 640 x 480 pixels, the wi'),
    (lambda sim: sim.restart(), r'died: x-plane: X-Plane has been up .* restarted during'),
    (lambda sim: sim.values.update({'sim/time/sim_speed': 1}),
     r'sim: x-plane: its time went on by .* resume it'),
    (lambda sim: sim.values.update({'sim/graphics/view/pilots_head_z': 3.0}),
     'sim: x-plane: the view is'),
    (lambda sim: sim.values.update({f'{REGION}rain_percent': 0.0}),
     'sim: x-plane: .*rain_percent is 0 after it was set to 0.4'),
    (lambda sim: sim.values.update({'sim/time/zulu_time_sec': 3600.0}),
     'sim: x-plane: .*zulu_time_sec is 3600 after'),
    (lambda sim: sim.values.update({'sim/aircraft/view/acf_ui_name': b'Boeing 737\0'}),
     "sim: x-plane: the aircraft is 'Boeing 737', expected '"),
])
def test_what_happens_in_the_middle_of_a_run(sim, spoil, words):
    made, state = camera(sim, aircraft='208B'), Aircraft(SCENE).state
    made.render(state, 0)
    spoil(sim)
    # One more thing is looked at with each picture.
    states = [dataclasses.replace(state, x_m=state.x_m + step) for step in range(1, 17)]
    with pytest.raises(InfraError, match=f'^{words}'):
        list(map(made.render, states, range(1, 17)))


def with_datarefs(**values: object) -> Scenario:
    return dataclasses.replace(SCENE, datarefs=json.dumps(values))


def test_datarefs_of_the_scenario(sim):
    name = REGION + 'visibility_reported_sm'
    array = REGION + 'cloud_base_msl_m'
    camera(sim, with_datarefs(**{name: 3.0, array: [900, 1000, 2000]}))
    assert sim.values[name] == 3.0
    assert sim.values[array] == [900.0, 1000.0, 2000.0]


@pytest.mark.parametrize(('name', 'words'), [
    ('sim/no/such', 'has no dataref sim/no/such'), ('sim/time/paused', 'is read-only'),
])
def test_datarefs_that_cannot_be_written(sim, name, words):
    with pytest.raises(UsageError, match=f'datarefs: .*{words}'):
        camera(sim, with_datarefs(**{name: 1.0}))


@pytest.mark.nightly
@pytest.mark.parametrize('size', [(1280, 720), (400, 400)])
def test_a_camera_s_picture_out_of_a_window_s(size):
    """A pinhole camera looks at a coloured sphere: each pixel has the colour of its direction."""
    for name in ('wing', 'nose'):
        model = find_camera(name)
        fov_deg = field_of_view_deg(model, size)
        width, height = size
        focal = width / 2 / math.tan(math.radians(fov_deg) / 2)
        rows, columns = np.mgrid[0:height, 0:width]
        window = _coloured((columns + 0.5 - width / 2) / focal, (rows + 0.5 - height / 2) / focal)
        found = developed(window, model, fov_deg).astype(float)
        v, u = np.mgrid[0:model.height_px, 0:model.width_px].astype(float)
        wanted = _coloured(*model.straight_rays(u, v)).astype(float)
        off = np.abs(found - wanted)[2:-2, 2:-2]
        assert off.max() <= 3.0, name


def _coloured(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack(
        [128 + 60 * x, 128 + 60 * y, 128 + 40 * np.sin(2 * x + y)], axis=-1
    ).clip(0, 255).astype(np.uint8)


def test_what_our_pictures_have_and_x_plane_s_do_not(sim):
    noisy = dataclasses.replace(find_camera('wing'), noise_codes=2.0, name='noisy')
    made = camera(sim)
    with pytest.raises(UsageError, match='exposure_ev and noise_codes have no effect'):
        ViewFromXPlane(made._xplane, noisy, FakeScreen(sim))
    sim.size = 64, 36
    sim.values.update({'sim/graphics/view/window_width': 64, 'sim/graphics/view/window_height': 36})
    with pytest.raises(UsageError, match=r'window of 64 x 36 .* camera wing; make it 379 x 213'):
        ViewFromXPlane(made._xplane, find_camera('wing'), FakeScreen(sim))
    wide = dataclasses.replace(find_camera('wing'), focal_px=(30.0, 30.0), name='wide')
    with pytest.raises(UsageError, match='needs a window of 166 degrees, more than 140'):
        ViewFromXPlane(made._xplane, wide, FakeScreen(sim))


# The whole world


def test_a_step_is_a_tenth_of_a_second_of_the_simulation(sim):
    made = world(sim)
    began = sim.values['sim/time/total_flight_time_sec']
    for step in range(20):
        seen = made.observe(picture=False)
        assert seen.seq == step
        made.advance(AHEAD)
    lasted = sim.values['sim/time/total_flight_time_sec'] - began
    # Late by some frames of the last step, not of all of them.
    assert lasted == pytest.approx(2.0, abs=0.1)
    assert sim.values['sim/time/paused'] == 1
    seen = made.observe(picture=False)
    assert seen.state.x_m == pytest.approx(410.0, abs=0.7)
    assert seen.state.y_m == pytest.approx(0.0, abs=0.1)
    assert seen.state.speed_mps == pytest.approx(5.0, abs=0.3)


def test_steering_left_goes_left(sim):
    made = world(sim)
    for _ in range(15):
        made.advance(TaxiCommand(steering_rad=0.1, speed_mps=5.0))
    state = made.observe(picture=False).state
    assert state.yaw_rad > 0.02
    assert state.y_m > 0.05
    assert state.yaw_rate_radps > 0.0
    assert sim.values['sim/flightmodel2/gear/tire_steer_command_deg'][0] < 0.0


def test_the_world_starts_where_the_scenario_does(sim):
    seen = world(sim, scenario_from_human({
        'cross_track_m': -3, 'distance_m': 700, 'heading_deg': -10, 'duration_s': 1,
    })).observe()
    assert seen.state.x_m == pytest.approx(700.0, abs=0.05)
    assert seen.state.y_m == pytest.approx(-3.0, abs=0.05)
    assert math.degrees(seen.state.yaw_rad) == pytest.approx(-10.0, abs=0.1)
    assert seen.image is not None
    assert seen.image.shape == PLAIN.camera_model.shape


@pytest.mark.parametrize(('by_s', 'words'), [
    (-5.0, r'sim: x-plane: its time went back from .* replay shown'),
    (5.0, r'timeout: x-plane: step 2 ended 4\.\d+ s of its time'),
])
def impossible(sim: FakeXPlane) -> None:
    plain = sim.derive
    sim.derive = lambda: (plain(), sim.values.update({POSITION + 'groundspeed': 1e30}))


def stuck(sim: FakeXPlane) -> None:
    deaf(sim, 'throttle')
    sim.values['sim/cockpit2/engine/actuators/throttle_ratio_all'] = 0.0
    for axis in 'xz':
        sim.values[f'{POSITION}local_v{axis}'] = 0.0


def jumped(by_s: float) -> Callable[[FakeXPlane], None]:
    def jump(sim: FakeXPlane) -> None:
        sim.values['sim/time/total_flight_time_sec'] += by_s

    return jump


@pytest.mark.one_in(2)
@pytest.mark.parametrize(('spoil', 'words'), [
    (jumped(-5.0), r'sim: x-plane: its time went back from .* replay shown'),
    (jumped(5.0), r'timeout: x-plane: step 2 ended 4\.\d+ s of its time'),
    (impossible, r'sim: x-plane: the aircraft is at .* no taxiing'),
    (stuck, 'sim: x-plane: the aircraft has not moved for 5 s'),
    (lambda sim: deaf(sim, 'sim_speed'), r'timeout: x-plane: after \S+ s its time stands still'),
])
def test_a_world_that_does_not_go_on(sim, spoil, words):
    made = world(sim, Scenario(duration_s=10.0))
    made.advance(AHEAD)
    if 'stands still' in words:
        impatient(made._xplane)
    spoil(sim)
    with pytest.raises(InfraError, match=f'^{words}'):
        list(map(made.advance, [AHEAD] * 60))


@pytest.mark.parametrize(('key', 'value'), [
    ('shadows', False), ('crossing', False), ('gust_mps', 1), ('slope_percent', 1),
])
def test_what_x_plane_does_not_get_is_refused(sim, key, value):
    with pytest.raises(UsageError, match=f'world xplane: {key} would have no effect'):
        world(sim, scenario_from_human({key: value}))


# By name


def in_environment(sim: FakeXPlane, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    path = folder / 'xplane.yaml'
    path.write_text(f'port: {sim.web_port}\nsettle_s: 0\ntimeout_s: 30\n')
    monkeypatch.setenv('TAXINET_XPLANE', str(path))
    screen = lambda *_: FakeScreen(sim)  # noqa: E731
    monkeypatch.setattr(XPlaneCamera.__init__, '__defaults__', (None, screen))
    monkeypatch.setitem(XPlaneWorld.__init__.__kwdefaults__, 'open_screen', screen)


@pytest.mark.parametrize('word', ['kmwh+xplane', 'xplane'])
def test_camera_and_world_by_name_name_the_step_of_an_error(sim, monkeypatch, tmp_path, word):
    in_environment(sim, monkeypatch, tmp_path)
    chosen = find_world(word)
    assert 'twice' in chosen.again_words or 'same way' in chosen.again_words
    one = chosen.make(PLAIN)
    assert one.observe().image.shape == PLAIN.camera_model.shape
    one.advance(AHEAD)
    assert one.observe(picture=False).seq == 1
    sim.restart()
    with pytest.raises(InfraError, match=r'x-plane at step 1: .*(restart|back)') as error:
        one.observe() if word != 'xplane' else one.advance(AHEAD)
    assert error.value.who == 'x-plane'
    close_world(one)
    assert (sim.values['sim/time/sim_speed'], sim.values[HELD][0]) == (1, 0)


def test_what_the_camera_does_not_show_is_refused_by_name():
    renderer = find_world('kmwh+xplane').renderer
    with pytest.raises(UsageError, match='camera xplane: does not show shadows, which would have'):
        renderer.check(scenario_from_human({'shadows': False}))


# The setup file


def test_the_setup_file(tmp_path, monkeypatch):
    path = tmp_path / 'xplane.yaml'
    monkeypatch.setenv('TAXINET_XPLANE', str(path))
    with pytest.raises(UsageError, match=r'TAXINET_XPLANE .*xplane.yaml: cannot be read'):
        chosen_setup()
    path.write_text(
        'wire: connect\nhost: 10.0.0.7\ndisplay: ":1"\nregion_px: [0, 0, 1280, 720]\n'
    )
    found = chosen_setup()
    assert (found.wire, found.port, found.region_px) == ('connect', 49009, (0, 0, 1280, 720))
    monkeypatch.delenv('TAXINET_XPLANE')
    assert chosen_setup() == XPlaneSetup()


@pytest.mark.parametrize(('text', 'words'), [
    ('wire: udp', 'wire: expected one of web, connect'), ('hots: a', 'hots: unknown key'),
    ('port: 0', 'port: expected a whole number'), ('region_px: [1, 2]', 'a list of 4 numbers'),
    ('region_px: [0, 0, 0, 10]', 'the last two above 0'),
    ('view: up', "view: 'up' is no name"),
    ('wire: connect\naircraft: 208B', 'has no effect: the plug-in tells no names'),
    ('[1]', 'expected KEY: VALUE pairs'),
])
def test_a_setup_that_cannot_be(tmp_path, text, words):
    path = tmp_path / 'xplane.yaml'
    path.write_text(text)
    with pytest.raises(UsageError, match=words):
        read_setup(path)


def test_runs_take_turns_and_say_so(sim, capfd):
    first = XPlane(setup_of(sim))
    made: list[XPlane] = []
    waiting = threading.Thread(target=lambda: made.append(XPlane(setup_of(sim))))
    waiting.start()
    told = ''

    def says_so() -> bool:
        nonlocal told
        told += capfd.readouterr().err
        return 'another run uses it; waiting' in told

    wait_for(says_so)
    assert made == []
    first.close()
    waiting.join()
    made[0].close()
