"""Sensors beside the camera: files and keys, and what they measure against known answers."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pymap3d
import pytest
from scipy import stats

import taxinet_ros as tx
from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.run.message_values import scenario_of, scenario_values
from taxinet_ros.bag.run.messages import header_values, message_cdr
from taxinet_ros.bag.run.run_bag import bag_topics
from taxinet_ros.core import topics
from taxinet_ros.core.control_step import Observation
from taxinet_ros.core.faults import check_free
from taxinet_ros.core.place.runway_frame import GeodeticPose, MapPose, runway_frame
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.sensing import Schedule
from taxinet_ros.core.sensors import NO_SENSORS, RATES_HZ, Sensor, load_sensors
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.core.world import SimulatedWorld, _PluginWorld
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import WORLDS, Extension

STANDARD = {'sensors': 'standard', 'duration_s': 6.0}
EXACT = {'gnss': {'rate_hz': 100}, 'imu': {'rate_hz': 100}, 'wheel': {'rate_hz': 100}}
OTHERS = Extension(
    kind=WORLDS, name='others', target='others:Others', distribution='others', version='1',
)


def scene(sensors: dict[str, Any] | str = NO_SENSORS, **human: Any) -> Scenario:
    text = sensors if isinstance(sensors, str) else load_sensors(sensors)
    return scenario_from_human({
        'cross_track_m': 3.0, 'heading_deg': 5.0, 'duration_s': 20.0, 'sensors': text, **human,
    })


def driven(scenario: Scenario, make: Callable[..., Any] = SimulatedWorld) -> list[Observation]:
    """A run in bends, faster and slower."""
    world, seen = make(scenario, pictures=False), []
    for seq in range(world.last_seq + 1):
        assert repr(world.observe(picture=False)) == repr(world.observe(picture=False))
        seen.append(world.observe(picture=False))
        if seq < world.last_seq:
            world.advance(TaxiCommand(
                steering_rad=0.1 * math.sin(seq / 9), speed_mps=5.0 + 2.0 * math.sin(seq / 20),
            ))
    return seen


def all_of(seen: Sequence[Observation], name: str) -> list[Any]:
    return [one for now in seen for one in getattr(now.measured, name)]


def test_given_sensors_then_the_aircraft_moves_as_without_and_without_there_is_nothing():
    without, standard = driven(scene()), driven(scene('standard'))
    assert len(without) == 201
    assert [repr(now.state) for now in without] == [repr(now.state) for now in standard]
    assert {now.measured for now in without} == {None}
    assert not hasattr(SimulatedWorld(scene(), pictures=False)._aircraft, 'states')
    assert [len(all_of(standard, name)) for name in ('gnss', 'imu', 'wheel')] == [100, 2001, 401]


def test_given_a_gnss_without_noise_then_the_geometry_of_recordings_gives_the_way_back_to_1_mm():
    for place in ('kmwh_04', 'nzqn_05'):
        seen = driven(scene({'gnss': {'rate_hz': 10}}, place=place))
        fixes = all_of(seen, 'gnss')
        assert [fix.stamp_ns for fix in fixes] == [now.stamp_ns for now in seen]
        frame = runway_frame(seen and scene(place=place).runway)
        for now, fix in zip(seen, fixes, strict=True):
            # As recordings/truth.py reads a NavSatFix: at the height of the runway.
            there = frame.to_map(GeodeticPose(
                latitude_rad=math.radians(fix.latitude_deg), heading_rad=0.0,
                longitude_rad=math.radians(fix.longitude_deg), altitude_m=frame.elevation_m,
            ))
            assert math.hypot(there.x_m - now.state.x_m, there.y_m - now.state.y_m) < 1e-3
            assert abs(fix.cte_m - now.truth.cte_m) < 1e-6
            assert abs(fix.altitude_m - frame.elevation_m - now.state.z_m) < 1e-6


def test_given_a_track_then_a_fix_is_beside_that():
    seen = driven(scene({'gnss': {'rate_hz': 2}}, track='exit_left', distance_m=240))
    fixes = all_of(seen, 'gnss')
    assert len(fixes) == 41
    for fix, now in zip(fixes, seen[::5], strict=True):
        assert fix.cte_m == pytest.approx(now.truth.cte_m, abs=1e-6)
    assert abs(seen[0].truth.cte_m - seen[0].state.y_m) > 1


def test_given_an_imu_then_its_rate_adds_up_to_the_heading_and_its_orientation_is_east_north_up():
    seen = driven(scene(EXACT))
    turned = all_of(seen, 'imu')
    assert len(turned) == 2001
    rates = [one.yaw_rate_radps for one in turned]
    yaw_rad = seen[0].state.yaw_rad + np.concatenate([[0.0], np.cumsum(
        [(one + other) / 200 for one, other in itertools.pairwise(rates)])])
    truth = np.array([now.state.yaw_rad for now in seen])
    assert np.ptp(truth) > math.radians(10)
    assert np.abs(yaw_rad[::10] - truth).max() < math.radians(0.05), 'JSBSim: half a step of 8 ms'
    frame = runway_frame(scene().runway)
    for now, one in zip(seen, turned[::10], strict=True):
        assert one.stamp_ns == now.stamp_ns
        state = now.state
        here, ahead = (frame.to_geodetic(MapPose(
            x_m=state.x_m + metres * math.cos(state.yaw_rad),
            y_m=state.y_m + metres * math.sin(state.yaw_rad), z_m=0.0, yaw_rad=0.0,
        )) for metres in (0, 10))
        east, north, _ = pymap3d.geodetic2enu(
            ahead.latitude_rad, ahead.longitude_rad, ahead.altitude_m,
            here.latitude_rad, here.longitude_rad, here.altitude_m, deg=False)
        off = one.yaw_rad - math.atan2(north, east)
        assert abs(math.remainder(off, math.tau)) < math.radians(0.001)


def test_given_an_imu_then_its_force_adds_up_to_the_speed_and_weighs_the_aircraft():
    seen = driven(scene(EXACT))
    force = np.array([one.acceleration_mps2 for one in all_of(seen, 'imu')])
    assert force.shape == (2001, 3)
    pitch = np.array([now.state.pitch_rad for now in seen])
    gained = np.cumsum(force[1:, 0] + 9.80665 * np.sin(np.interp(
        np.arange(1, 2001) / 10, np.arange(201), pitch))) / 100
    speeds = np.array([now.state.speed_mps for now in seen])
    assert np.ptp(speeds) > 1
    assert np.abs(gained[9::10] - (speeds[1:] - speeds[0])).max() < 0.05
    assert force[:, 2] == pytest.approx(9.80665, abs=0.01)
    bends = [(now.state.speed_mps * now.state.yaw_rate_radps + 9.80665 * math.sin(
        now.state.roll_rad)) for now in seen]
    assert force[::10, 1] == pytest.approx(bends, abs=1e-9)


def test_given_wheels_then_they_tell_the_speed_and_a_bias_is_a_share_of_it():
    seen = driven(scene({'wheel': {'rate_hz': 10, 'bias_percent': 2}}))
    speeds = [one.speed_mps for one in all_of(seen, 'wheel')]
    assert speeds == pytest.approx([1.02 * now.state.speed_mps for now in seen])


NOISY = {
    'gnss': {'rate_hz': 100, 'noise_m': 1.5, 'bias_m': -0.4},
    'imu': {'rate_hz': 100, 'yaw_rate_noise_degps': 0.5, 'yaw_rate_bias_degps': 0.1,
            'acceleration_noise_mps2': 0.2, 'heading_noise_deg': 1.0, 'heading_bias_deg': 0.3},
    'wheel': {'rate_hz': 100, 'noise_mps': 0.1},
}


def errors() -> dict[str, tuple[np.ndarray, float, float]]:
    """Errors of 2,000 measurements, with the mean and standard deviation that they should have."""
    noisy, exact = (driven(scene(one)) for one in (NOISY, EXACT))
    off = {
        name: [(one, other) for one, other in zip(
            all_of(noisy, name), all_of(exact, name), strict=True)][1:]
        for name in EXACT
    }
    degree = math.radians(1)
    return {
        'cte': (np.array([a.cte_m - b.cte_m for a, b in off['gnss']]), -0.4, 1.5),
        'along': (np.array([a.position_m[0] - b.position_m[0] for a, b in off['gnss']]), 0.0, 1.5),
        'altitude': (np.array([a.altitude_m - b.altitude_m for a, b in off['gnss']]), 0.0, 1.5),
        'rate': (np.array([a.yaw_rate_radps - b.yaw_rate_radps for a, b in off['imu']]),
                 0.1 * degree, 0.5 * degree),
        'force': (np.array([a.acceleration_mps2[0] - b.acceleration_mps2[0]
                            for a, b in off['imu']]), 0.0, 0.2),
        'yaw': (np.array([a.yaw_rad - b.yaw_rad for a, b in off['imu']]), 0.3 * degree, degree),
        'speed': (np.array([a.speed_mps - b.speed_mps for a, b in off['wheel']]), 0.0, 0.1),
    }


def test_given_2000_measurements_then_their_noise_has_the_stated_mean_and_deviation_and_is_white():
    found = errors()
    assert len(found) == 7
    low, high = (math.sqrt(stats.chi2.ppf(p, 1999) / 1999) for p in (5e-4, 1 - 5e-4))
    for name, (off, mean, sigma) in found.items():
        assert len(off) == 2000
        assert abs(off.mean() - mean) < 3.3 * sigma / math.sqrt(2000), name
        assert low < off.std(ddof=1) / sigma < high, name
        assert abs(np.corrcoef(off[1:], off[:-1])[0, 1]) < 3.3 / math.sqrt(2000), name
        assert stats.kstest((off - mean) / sigma, 'norm').pvalue > 1e-3, name


@pytest.mark.nightly
def test_given_a_correlation_then_the_noise_keeps_its_value_that_long_and_its_deviation():
    sensors = {'gnss': {'rate_hz': 10, 'noise_m': 2.0, 'correlation_s': 0.5}}
    off = np.concatenate([
        [fix.cte_m - now.truth.cte_m for fix, now in zip(all_of(seen, 'gnss'), seen, strict=True)]
        for seed in range(10) for seen in [driven(scene(sensors, fault_seed=seed))]
    ])
    assert len(off) == 2010
    effective = 2010 * (1 - math.exp(-0.2)) / (1 + math.exp(-0.2))
    assert abs(off.mean()) < 3.3 * 2.0 / math.sqrt(effective)
    assert off.std() == pytest.approx(2.0, rel=3.3 / math.sqrt(effective))
    assert np.corrcoef(off[1:], off[:-1])[0, 1] == pytest.approx(math.exp(-0.2), abs=0.06)


def test_given_a_drop_out_then_it_is_silent_in_exactly_that_time_and_all_else_is_the_same():
    usual = all_of(driven(scene('standard')), 'gnss')
    silent = all_of(driven(scene('standard', gnss_dropout_start_s=4.0, gnss_dropout_s=2.2)), 'gnss')
    gone = [fix.stamp_ns for fix in usual if fix not in silent]
    assert gone == list(range(4_000_000_000, 6_200_000_000, 200_000_000))
    assert [fix for fix in usual if fix.stamp_ns not in gone] == silent
    first = {'imu': {'rate_hz': 2, 'dropouts': [{'start_s': 0, 'length_s': 0.5},
                                                {'start_s': 1, 'length_s': 0.5}]}}
    stamps = [one.stamp_ns for one in all_of(driven(scene(first, duration_s=3)), 'imu')]
    assert stamps == [500_000_000, 1_500_000_000, 2_000_000_000, 2_500_000_000, 3_000_000_000]


@pytest.mark.one_in(2)
@pytest.mark.parametrize(('delay_s', 'steps'), [(0, 0), (0.05, 1), (0.1, 1), (0.25, 3), (2.0, 20)])
def test_given_a_delay_then_each_measurement_arrives_with_the_first_frame_after_it(delay_s, steps):
    sensors = {'gnss': {'rate_hz': 5, 'delay_s': delay_s}}
    seen = driven(scene(sensors, duration_s=4))
    arrived = [(fix.stamp_ns, now.seq) for now in seen for fix in now.measured.gnss]
    assert arrived == [
        (200_000_000 * number, 2 * number + steps) for number in range(21) if
        2 * number + steps <= 40
    ]
    exact = {fix.stamp_ns: fix for fix in all_of(driven(scene({'gnss': {'rate_hz': 5}})), 'gnss')}
    assert all(fix == exact[fix.stamp_ns] for fix in all_of(seen, 'gnss')), 'of when it was'


def test_given_losses_by_chance_then_their_share_is_as_stated_and_the_rest_is_the_same():
    usual, some = (
        all_of(driven(scene({'wheel': {'rate_hz': 100, 'noise_mps': 0.1, 'loss_percent': loss}})),
               'wheel') for loss in (0, 30)
    )
    assert len(usual) == 2001
    assert stats.binomtest(len(usual) - len(some), 2001, 0.3).pvalue > 1e-3
    assert set(some) < set(usual)
    assert all_of(driven(scene({'wheel': {'rate_hz': 100, 'loss_percent': 100}})), 'wheel') == []


@pytest.mark.parametrize('control_hz', [10, 30])
@pytest.mark.parametrize('rate_hz', RATES_HZ)
def test_given_a_rate_then_the_schedule_has_each_measurement_once(rate_hz, control_hz):
    period_ns = 1_000_000_000 // control_hz
    schedule = Schedule(scene({'imu': {'rate_hz': rate_hz, 'delay_s': 0.17}}), period_ns)
    due = [
        (number, seq) for seq in range(20 * control_hz + 3) for _, number in schedule.due(seq)
    ]
    last_ns = (20 * control_hz + 2) * 1_000_000_000 // control_hz - 170_000_000
    assert [number for number, _ in due] == list(range(last_ns * rate_hz // 1_000_000_000 + 1))
    for number, seq in due:
        stamp_ns = number * 1_000_000_000 // rate_hz
        assert schedule.step_of('imu/data', stamp_ns) == seq
        late_ns = seq * 1_000_000_000 // control_hz - stamp_ns - 170_000_000
        assert 0 <= late_ns <= period_ns
    assert sum(schedule.counts(seq)['imu/data'] for seq in range(20 * control_hz + 3)) == len(due)


def test_given_the_seed_or_the_start_then_the_noise_is_another_and_else_the_same():
    first, again, seed, start = (
        all_of(driven(scene('standard', duration_s=2, **more)), 'wheel')
        for more in ({}, {'gnss_noise_m': 3}, {'fault_seed': 1}, {'heading_deg': 5.1})
    )
    assert first == again
    # A program that has no heading faces -0.0 degrees, and what is written of its run 0.0.
    zeros = [all_of(driven(scene('standard', duration_s=2, heading_deg=zero)), 'wheel')
             for zero in (0.0, -0.0)]
    assert zeros[0] == zeros[1]
    for other in (seed, start):
        assert len(other) == 41
        assert not {one.speed_mps for one in other} & {one.speed_mps for one in first}


def test_given_keys_of_the_scenario_then_they_stand_in_place_of_the_files():
    found = scene('standard', gnss_noise_m=2.5, gnss_bias_m=-1, gnss_dropout_start_s=3,
                  gnss_dropout_s=4).sensor_set.gnss
    assert (found.noise_m, found.bias_m, found.dropouts) == (2.5, -1.0, ((3.0, 4.0),))
    assert (found.rate_hz, found.correlation_s) == (5, 20.0)
    assert scene('standard').sensor_set.gnss.noise_m == 1.0


@pytest.mark.parametrize('sensors', ['standard', NOISY])
@pytest.mark.parametrize('more', [
    {}, {'gnss_noise_m': 2.5, 'gnss_dropout_s': 4.0, 'fault_seed': 3},
    {'camera': 'tail', 'camera_dpitch_deg': 2.0},
])
def test_given_a_scene_with_sensors_then_message_and_human_values_give_it_back(sensors, more):
    asked = scene(sensors, **more)
    request = RunRequest(
        run_id='run', index=0, program='p', seed=0, scenario=asked,
        judging=Judging(specs=('phi_always',)), participants=(),
    )
    cdr = message_cdr(topics.SCENARIO, {'header': header_values(0), **scenario_values(request)})
    message = decode(bag_topics()[0], cdr)
    assert scenario_of(message) == asked
    assert message.camera.startswith('{"camera":')
    assert scenario_from_human(asked.to_human()) == asked
    assert asked.digest != asked.without_sensors().digest
    assert asked.without_sensors().recorded()['camera'] == asked.camera_model.text


@pytest.mark.parametrize(('sensors', 'words'), [
    ({}, 'expected one of gnss, imu, wheel'),
    ({'gps': {}}, 'gps: unknown key; known: gnss, imu, wheel'),
    ({'gnss': {}}, "gnss: the key 'rate_hz' is missing"),
    ({'gnss': {'rate_hz': 3}}, 'gnss.rate_hz: expected one of 1, 2, 5, 6, 8, 10'),
    ({'gnss': {'rate_hz': 200}}, 'gnss.rate_hz: expected a number, 1 to 100'),
    ({'gnss': {'rate_hz': 5, 'noise': 1}}, 'gnss.noise: unknown key.*did you mean noise_m'),
    ({'wheel': {'rate_hz': 5, 'noise_mps': -1}}, 'wheel.noise_mps: expected a number, 0 to 50'),
    ({'imu': {'rate_hz': 5, 'dropouts': [{'start_s': 1}]}}, "imu.dropouts.0.: the key 'length_s'"),
])
def test_given_a_file_that_is_wrong_then_the_key_is_named(sensors, words):
    with pytest.raises(UsageError, match=words):
        load_sensors(sensors)


@pytest.mark.parametrize(('human', 'words'), [
    ({'gnss_noise_m': 2}, 'gnss_noise_m has no effect without a gnss among the sensors'),
    ({'sensors': load_sensors({'imu': {'rate_hz': 10}}), 'gnss_bias_m': 2}, 'gnss_bias_m has no'),
    (STANDARD | {'gnss_dropout_start_s': 2}, 'gnss_dropout_start_s has no effect without gnss_dr'),
    ({'fault_seed': 2}, 'fault_seed has no effect without a fault that is drawn'),
    ({'sensors': 'gps'}, "sensors is 'gps', not one of none, standard, nor a YAML file"),
])
def test_given_keys_that_contradict_then_they_are_refused_by_name(human, words):
    with pytest.raises(UsageError, match=words):
        scenario_from_human(human)


def test_given_a_text_that_is_no_camera_with_sensors_then_it_is_refused():
    with pytest.raises(UsageError, match='not a camera with sensors'):
        Scenario(camera='{"camera":"wing"}')


def test_given_a_free_run_then_sensors_are_refused():
    with pytest.raises(UsageError, match='sensors: not in a free run'):
        check_free(scene('standard'))


def test_given_a_world_of_a_package_then_slow_sensors_are_there_and_fast_ones_refused_by_name():
    given = []

    def others(scenario, *, pictures=True):
        given.append(scenario)
        return SimulatedWorld(scenario, pictures=pictures)

    def theirs(scenario, *, pictures=True):
        return _PluginWorld(OTHERS, others, scenario, pictures=pictures)

    slow = {'gnss': {'rate_hz': 10, 'noise_m': 1.0, 'delay_s': 0.2}, 'wheel': {'rate_hz': 5}}
    found = driven(scene(slow), theirs)
    assert [now.measured for now in found] == [now.measured for now in driven(scene(slow))]
    assert len(all_of(found, 'gnss')) == 199
    assert given == [scene()], 'the world itself has none'
    with pytest.raises(UsageError, match=r'imu\.rate_hz is 100, but world others of others 1 giv'):
        theirs(scene('standard'))


def test_given_a_run_then_functions_with_a_parameter_sensors_get_what_has_arrived():
    got: list[Any] = []

    def look(image, sensors):
        got.append(sensors)
        return 0.0, 0.0

    def steer(estimate, sensors):
        got.append(sensors)
        return 0.0, 5.0

    asked = scene('standard', duration_s=1)
    run = tx.run(asked, perception=look, controller=steer, specs='phi_always')
    assert run.outcome.judged
    seen = [step.observation.measured for step in run.steps]
    assert [len(one.imu) for one in seen] == [1, *[10] * 10]
    assert got == [one for one in seen for _ in range(2)]


@pytest.mark.parametrize('part', ['perception', 'controller'])
def test_given_a_function_that_asks_for_sensors_in_a_run_without_then_it_is_refused_by_name(
    part, tmp_path
):
    text = 'def mine(seen, sensors):\n    return 0.0, 5.0\n'
    (tmp_path / 'mine.py').write_text(text)
    with pytest.raises(UsageError, match='mine has a parameter sensors, which it gets only in'):
        tx.run(scene(), **{part: f'{tmp_path}/mine.py:mine'}, specs='phi_always')
    perception = tx.load_perception(f'{tmp_path}/mine.py:mine')
    with pytest.raises(UsageError, match='mine has a parameter sensors, which it gets only in'):
        perception.estimate(np.zeros((200, 360, 3), np.uint8), None)


def test_given_a_fork_then_sensors_go_on_and_a_new_place_is_refused():
    run = tx.run(scene('standard', duration_s=2), perception='truth', specs='phi_always')
    forked = run.fork(1.0, settings={'steering_bias_deg': 3.0})
    measured = [[step.observation.measured for step in one.steps] for one in (run, forked)]
    assert len(measured[1]) == 21
    assert measured[0][:11] == measured[1][:11]
    assert measured[0][11:] != measured[1][11:]
    for more in ({'moved': {'cte_m': 1.0}}, {'settings': {'fault_seed': 3}}):
        with pytest.raises(UsageError, match='in a run with sensors the aircraft cannot be placed'):
            run.fork(1.0, **more)


def test_given_a_sensor_then_it_is_silent_from_the_start_of_a_drop_out_until_before_its_end():
    sensor = Sensor(name='x', rate_hz=10, dropouts=((1.0, 0.3),))
    assert [one for one in range(0, 20) if sensor.silent(one * 100_000_000)] == [10, 11, 12]
    assert dataclasses.replace(sensor, dropouts=()).silent(1_000_000_000) is False
