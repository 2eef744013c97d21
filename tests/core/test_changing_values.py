"""Values that change within a run: what is between control points, and what a run makes of them."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

import taxinet_ros as tx
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.faults import loop_delay_ns
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    EXPOSURE_JUMP,
    GUST,
    HUMAN_KEYS,
    LOOP_DELAY,
    RUNWAY_STATE,
    STEERING_BIAS,
    WIND_DIRECTION,
    WIND_SPEED,
)
from taxinet_ros.core.signals import VARYING, Signal
from taxinet_ros.core.types import NS_PER_S, TaxiCommand
from taxinet_ros.core.world import SimulatedWorld, _PluginWorld
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.record.row import RunRow, scene_attributes
from taxinet_ros.trials.record.table import table

FORMS = ('constant', 'linear', 'cubic')
VALUES = st.floats(-0.5, 0.5).map(lambda value: round(value, 6))
POINTS = st.lists(
    st.tuples(st.integers(1, 600), VALUES), min_size=1, max_size=6,
    unique_by=lambda point: point[0],
).map(sorted)


def signal(points, form, period=0.0):
    return Signal(
        times_ns=tuple(step * CONTROL_PERIOD_NS for step, _ in points),
        values=tuple(value for _, value in points), form=form, period=period,
    )


@given(POINTS, VALUES, st.sampled_from(FORMS), st.integers(0, 700))
def test_given_points_then_a_signal_goes_through_them_and_leaves_no_range_of_two(
    points, start, form, step
):
    found = signal(points, form)
    every = [(0, start), *points]
    for at, value in every:
        assert found.at(start, at * CONTROL_PERIOD_NS) == value
    value = found.at(start, step * CONTROL_PERIOD_NS)
    before = [one for one in every if one[0] <= step][-1]
    after = next((one for one in every if one[0] > step), before)
    low, high = sorted((before[1], after[1]))
    assert low <= value <= high
    if form == 'constant' or after is before:
        assert value == before[1]


@given(POINTS, VALUES)
def test_given_a_cubic_signal_then_it_is_scipys_monotone_one(points, start):
    found = signal(points, 'cubic')
    times = np.array([0, *(step for step, _ in points)]) / 10
    theirs = PchipInterpolator(times, [start, *(value for _, value in points)])
    for time_s in np.linspace(0, times[-1], 40):
        assert found.at(start, round(time_s * NS_PER_S)) == pytest.approx(
            float(theirs(round(time_s * NS_PER_S) / NS_PER_S)), abs=1e-9)


@given(st.floats(0, 30), st.sampled_from(FORMS), st.integers(0, 400))
def test_given_a_signal_that_stays_then_it_is_the_value_to_the_bit(value, form, step):
    found = signal([(7, value), (100, value), (333, value)], form)
    assert found.at(value, step * CONTROL_PERIOD_NS) == value


def test_given_a_wind_from_350_to_10_degrees_then_it_turns_by_north():
    scene = scenario_from_human({
        'wind_speed': 5, 'wind_direction': 350, 'wind_direction@10': 10, 'wind_direction@20': 300,
    })
    found = [math.degrees(scene.at(WIND_DIRECTION, at_s * NS_PER_S)) for at_s in (0, 5, 10, 15, 25)]
    assert found == pytest.approx([350, 0, 10, 335, 300])


def test_given_the_keys_then_those_of_disturbances_may_change():
    assert VARYING == (
        WIND_SPEED, WIND_DIRECTION, GUST, RUNWAY_STATE, EXPOSURE_JUMP, LOOP_DELAY, STEERING_BIAS)


SCENE = {
    'wind_speed': 3, 'wind_speed@10': 8.25, 'wind_speed@form': 'cubic', 'runway_state@2.5': 'icy',
    'steering_bias@0.1': -1.7, 'datarefs': '{"sim/a/b": 2}',
}


def test_given_control_points_then_message_record_and_digest_have_them():
    scene = scenario_from_human(SCENE)
    assert Scenario(**scene.recorded()) == scene
    assert scenario_from_human(scene.to_human()) == scene
    assert eval(repr(scene), {'Scenario': Scenario}) == scene
    assert scene.dataref_values == {'sim/a/b': 2.0}
    assert dict(scene.points) == {
        'wind_speed_mps@form': 'cubic', 'wind_speed_mps@10': 8.25, 'runway_state@2.5': 'icy',
        'steering_bias_deg@0.1': -1.7,
    }
    plain = dataclasses.replace(scene, signals='')
    assert plain.digest != scene.digest
    assert '@' not in plain.recorded_text
    assert plain.recorded().keys() == scene.recorded().keys()
    # However they are said, it is one scene.
    other = {'wind_speed_mps@10.0': '8.25 m/s', 'wind_speed@ 10 s'.replace(' ', ''): 8.25}
    for name, value in other.items():
        said = {key: one for key, one in SCENE.items() if key != 'wind_speed@10'} | {name: value}
        assert scenario_from_human(said).digest == scene.digest
    assert dataclasses.replace(plain, **{
        key: value for key, value in SCENE.items() if '@' in key}) == scene


def test_given_control_points_then_a_row_and_its_table_have_a_column_of_each():
    scenes = [scenario_from_human(SCENE), scenario_from_human({'wind_speed': 3})]
    rows = [
        RunRow(run_id=f'a-{index}', index=index, program='a', seed=1, perception='truth',
               outcome=tx.Outcome.INTERRUPTED, **scene_attributes(scene))
        for index, scene in enumerate(scenes)
    ]
    for row, scene in zip(rows, scenes, strict=True):
        assert scenario_from_human(row.scene) == scene
        assert RunRow.from_json(json.loads(json.dumps(row.to_json()))) == row
    assert 'signals' not in rows[1].to_json()
    frame = table(rows)
    assert frame['wind_speed_mps@10'].tolist()[0] == 8.25
    assert frame['runway_state@2.5'].tolist()[0] == 'icy'
    assert not [name for name in table(rows[1:]).columns if '@' in name]
    with pytest.raises(ValueError, match='after the end of the run'):
        RunRow.from_json({**rows[0].to_json(), 'signals': {'wind_speed_mps@99': 1.0}})


@pytest.mark.parametrize(('values', 'said'), [
    ({'place@3': 'bikf_10'}, 'place cannot change within a run; what can: wind_speed_mps, wind'),
    ({'time_of_day@3': 9}, 'time_of_day_h cannot change within a run; what can: wind_speed_mps'),
    ({'rain@3': 9}, 'rain_percent cannot change within a run'),
    ({'fog@3': 9}, "unknown key 'fog@3'"),
    ({'wind_speed@0': 1}, 'the value at 0 s is wind_speed_mps itself'),
    ({'wind_speed@31': 1}, 'wind_speed_mps@31 is after the end of the run at 30 s'),
    ({'wind_speed@601': 1}, r'expected wind_speed_mps@SECONDS up to 600, as in wind_speed_mps@10'),
    ({'wind_speed@-1': 1}, r'expected wind_speed_mps@SECONDS'),
    ({'wind_speed@nan': 1}, r'expected wind_speed_mps@SECONDS'),
    ({'wind_speed@': 1}, r'expected wind_speed_mps@SECONDS'),
    ({'wind_speed@ten': 1}, r'expected wind_speed_mps@SECONDS'),
    ({'wind_speed@10 km': 1}, r'expected wind_speed_mps@SECONDS'),
    ({'wind_speed@9': 31}, r'wind_speed_mps@9 is 31, outside 0\.\.30 m/s'),
    ({'wind_speed@9': 'much'}, "wind_speed_mps@9 needs a number, got 'much'"),
    ({'wind_speed@9': 1, 'wind_speed_mps@9.0': 2}, 'are the same; leave one out'),
    ({'wind_speed@form': 'cubic'}, 'wind_speed_mps@form has no effect without a control point'),
    ({'wind_speed@9': 1, 'wind_speed@form': 'smooth'}, "'smooth', not one of constant, linear"),
    ({'runway_state@9': 'mud'}, "'mud', not one of dry, auto, wet, icy"),
    ({'runway_state@9': 'icy', 'runway_state@form': 'linear'}, 'not one of constant'),
    ({'wind_direction@9': 10}, 'wind_direction_deg has no effect without wind_speed_mps'),
    ({'aircraft': 'c172p', 'wind_speed@9': 2, 'gust@9': 1.2}, 'is 5.6, more than 5'),
])
def test_given_what_cannot_be_then_one_line_says_so(values, said):
    with pytest.raises(UsageError, match=said) as error:
        scenario_from_human(values)
    assert '\n' not in str(error.value)


@pytest.mark.parametrize('text', ['x', '[]', '{"fog@3": 1}', '{"wind_speed_mps": 1}', '{', '3'])
def test_given_damaged_signals_then_one_line_says_so(text):
    with pytest.raises(UsageError, match='signals'):
        Scenario(signals=text)


def test_given_a_wind_and_gusts_that_are_never_strong_at_once_then_a_light_aircraft_takes_them():
    scene = scenario_from_human({
        'aircraft': 'c172p', 'wind_speed': 4, 'wind_speed@5': 0, 'gust@5': 0, 'gust@9': 1.5})
    assert scene.windy


def test_given_the_keys_then_no_name_of_a_control_point_is_listed_and_each_is_found():
    assert not [key for key in HUMAN_KEYS if '@' in key]
    field = BY_KEY['wind_speed_mps@10']
    assert (field.key, field.title, field.unit) == ('wind_speed_mps@10', 'wind at 10 s', 'm/s')
    assert BY_KEY.get('place@10') is None
    assert 'place@10' not in BY_KEY


CALM = Scenario(cross_track_m=2.0, duration_s=3.0)
ROUGH = {
    'cross_track': 2, 'wind_speed': 6, 'wind_direction': 310, 'gust': 2, 'gust_seed': 3,
    'exposure_jump': 1, 'loop_delay': 0.2, 'steering_bias': 3, 'runway_state': 'wet', 'duration': 2,
}


def test_given_signals_that_stay_then_the_run_is_that_of_the_values_to_the_bit():
    plain = scenario_from_human(ROUGH)
    stays = {
        f'{field.key}@{at_s}': plain.to_human()[field.key] for field in VARYING
        for at_s in (0.5, 1.3)
    }
    forms = {f'{field.key}@form': form for field, form in zip(VARYING, FORMS * 3, strict=False)
             if field is not RUNWAY_STATE}
    steady = scenario_from_human({**ROUGH, **stays, **forms})
    assert len(steady.points) > 16
    one, other = (tx.run(scene, perception='taxinet') for scene in (plain, steady))
    assert one.trace.equals(other.trace)


@pytest.mark.parametrize(('start', 'key', 'value'), [
    ({}, 'steering_bias_deg', 3.0),
    ({'wind_speed_mps': 9.0}, 'wind_direction_deg', 90.0),
    *(pytest.param(*case, marks=pytest.mark.nightly) for case in [
        ({'wind_speed_mps': 3.0}, 'wind_speed_mps', 14.0),
        ({}, 'runway_state', 'icy'),
        ({}, 'exposure_jump_ev', 2.0),
    ]),
])
def test_given_a_step_then_the_run_is_that_of_a_fork_at_its_time_to_the_bit(start, key, value):
    scene = scenario_from_human({'cross_track': 2, 'heading': -15, 'duration': 3, **start})
    step = dataclasses.replace(scene, **{
        f'{key}@1.5': value, **({} if key == 'runway_state' else {f'{key}@form': 'constant'})})
    before, after = (tx.run(one, perception='taxinet') for one in (scene, step))
    assert after.trace.equals(before.fork(1.5, settings={key: value}).trace)
    assert not after.trace.equals(before.trace)
    assert after.trace[:15].equals(before.trace[:15])


def test_given_a_ramp_of_wind_then_the_run_is_that_of_a_world_changed_by_hand_at_each_step():
    ramp = scenario_from_human({
        'duration': 2, 'wind_speed': 2, 'wind_direction': 90, 'wind_speed@1.5': 12,
        'wind_direction@1': 40, 'wind_direction@form': 'cubic'})
    steady = dataclasses.replace(ramp, signals='')
    here, by_hand = SimulatedWorld(ramp, pictures=False), SimulatedWorld(steady, pictures=False)
    for step in range(20):
        now = step * CONTROL_PERIOD_NS
        by_hand.change(dataclasses.replace(
            steady, wind_speed_mps=ramp.at(WIND_SPEED, now),
            wind_direction_rad=ramp.at(WIND_DIRECTION, now)))
        for world in (here, by_hand):
            world.advance(TaxiCommand(steering_rad=0.02, speed_mps=5.0))
        assert here.observe().state == by_hand.observe().state
    assert ramp.at(WIND_SPEED, now) == 12.0


def test_given_gusts_that_come_up_then_they_are_one_and_the_same_turbulence_grown():
    windy = {'duration': 4, 'wind_speed': 1, 'gust_seed': 5}
    grown = scenario_from_human({**windy, 'gust@2': 4})
    other = scenario_from_human({**windy, 'gust': 4})
    rises = scenario_from_human({**windy, 'gust': 4, 'gust@form': 'constant', 'gust@0.1': 4})
    runs = [tx.run(scene) for scene in (grown, other, rises)]
    assert runs[1].trace.equals(runs[2].trace)
    assert not runs[0].trace.equals(runs[1].trace)
    calm = tx.run(scenario_from_human({'duration': 4, 'wind_speed': 1}))
    early, late = (
        (runs[0].trace['y_m'] - calm.trace['y_m'])[steps].abs().max()
        for steps in (slice(0, 10), slice(30, 40))
    )
    assert 0 < early < late / 10


def test_given_a_delay_that_comes_up_then_answers_are_late_from_then_on():
    scene = scenario_from_human({'loop_delay@1': 0, 'loop_delay@2': 0.4, 'fault_onset': 0.5})
    found = [loop_delay_ns(scene, round(at_s * NS_PER_S)) for at_s in (0, 1, 1.5, 2, 9)]
    assert found == pytest.approx([0, 0, 200_000_000, 400_000_000, 400_000_000], abs=1)


def test_given_an_exposure_that_comes_up_then_a_picture_is_that_of_its_value_then():
    scene = scenario_from_human({'exposure_jump@10': 2})
    state = SimulatedWorld(scene, pictures=False).observe().state
    for stamp_ns, value in ((0, 0.0), (5 * NS_PER_S, 1.0), (20 * NS_PER_S, 2.0)):
        there = Camera(Scenario(exposure_jump_ev=value)).render(state, stamp_ns)
        assert np.array_equal(Camera(scene).render(state, stamp_ns), there)


@settings(max_examples=5, deadline=None)
@given(st.floats(1, 20), st.floats(0, 20), st.sampled_from(FORMS))
def test_given_a_bag_then_it_repeats_the_run_to_the_bit(tmp_path_factory, middle, end, form):
    folder = tmp_path_factory.mktemp('bag')
    run = tx.run(scenario_from_human({
        'wind_speed@0.7': middle, 'wind_speed@1.5': end, 'wind_speed@form': form,
        'wind_direction': 80, 'steering_bias@1': 2, 'duration': 2,
    }))
    run.save_bag(folder / 'one')
    scene = open_recording(folder / 'one').scenario
    assert scene == run.scenario
    assert tx.run(scene).trace.equals(run.trace)


def test_given_another_world_then_what_it_would_not_change_is_refused_by_name():
    class Extension:
        words, failure = 'world still of package', str

    scene = scenario_from_human({'wind_speed@5': 3, 'steering_bias@5': 3})
    with pytest.raises(UsageError, match='of package: wind_speed_mps@5 would have no effect'):
        _PluginWorld(Extension(), lambda scenario, pictures: None, scene)
