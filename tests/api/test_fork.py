"""``tx.fork``: a run repeated to the bit up to a moment, and gone on in a changed world."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest

import taxinet_ros as tx
from taxinet_ros.api.fork import find_rescue, read_past
from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.writer import FORK_METADATA

RAINY = tx.Scenario(
    cross_track_m=2.0, duration_s=3.0, clouds='stratus', rain_fraction=0.5, crossing=False
)
CALM = tx.Scenario(cross_track_m=2.0, duration_s=3.0)


def drifting(truth):
    """Believes to be a metre and a half left of where it is."""
    return truth.cte_m + 1.5, truth.he_rad


drifting.needs_image = False


class Guessing:
    """Answers otherwise in every run."""

    needs_image = False

    def __init__(self):
        self.runs = 0

    def begin(self):
        self.runs += 1

    def __call__(self, truth):
        return truth.cte_m + 0.01 * self.runs, truth.he_rad


def equal(one, other):
    pd.testing.assert_frame_equal(one, other, check_exact=True)


@pytest.fixture(scope='module')
def rainy():
    return tx.run(RAINY, perception='taxinet')


@pytest.mark.parametrize('at_s', [0.0, 1.2, 3.0])
def test_given_no_change_then_the_whole_run_is_repeated(rainy, at_s):
    equal(rainy.fork(at_s).trace, rainy.trace)


SHY = dataclasses.replace(CALM, traffic=tx.load_traffic([
    {'kind': 'vehicle', 'x_m': CALM.distance_m + 30, 'y_m': -9, 'heading_deg': 90,
     'path': [{'x_m': CALM.distance_m + 30, 'y_m': 9, 'speed_mps': 4}], 'stands_within_m': 25},
    {'kind': 'vehicle', 'x_m': CALM.distance_m - 20, 'y_m': 0, 'stands_within_m': 19,
     'path': [{'x_m': 900, 'y_m': 0, 'speed_mps': 9}]},
]))


@pytest.mark.nightly
@pytest.mark.parametrize('at_s', [0.0, 1.7, 3.0])
def test_given_others_that_react_then_they_go_on_as_they_were_in_a_fork(at_s):
    run = tx.run(SHY, perception='taxinet', specs='no_collision')
    forked = run.fork(at_s)
    equal(forked.trace, run.trace)
    held = [step.observation.held for step in run.steps]
    assert [step.observation.held for step in forked.steps] == held
    assert all(0 < one.ns < 3e9 for one in held[-1].values())
    np.testing.assert_array_equal(forked.frame(30), run.frame(30))


def test_given_others_that_react_when_the_aircraft_is_placed_anew_then_they_react_to_its_new_place(
    tmp_path,
):
    run = tx.run(SHY, specs='no_collision')
    step = next(k for k in range(31) if run.steps[k].observation.held[0].stands)
    assert step > 2
    forked = run.fork(step / 10, moved={'distance_m': -12.0})
    assert [one.steps[step].observation.held[0].stands for one in (run, forked)] == [True, False]
    bag = tx.open_recording(forked.save_bag(tmp_path / 'forked', images=False))
    np.testing.assert_array_equal(bag.trace['clearance_m'], forked.trace['clearance_m'])
    assert [now.held for now in bag.observations(lambda seq: False)] == [
        one.observation.held for one in forked.steps
    ]


def test_given_random_latencies_then_they_are_those_of_the_run():
    late = tx.run(CALM, latency='perception=uniform(0.0,0.4)')
    equal(late.fork(1.0).trace, late.trace)
    assert late.fork_of is None
    assert late.fork(1.0).fork_of.step == 10


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('settings', 'there'), [
    ({'rain': 0, 'clouds': 'clear'}, {'rain_fraction': 0.0, 'clouds': 'clear'}),
    ({'time_of_day_h': 7.5, 'shadows': 'off'}, {'time_of_day_s': 27000.0, 'shadows': False}),
    ({'lens_dirt_percent': 40}, {'lens_dirt_fraction': 0.4}),
    ({'runway_state': 'icy'}, {'runway_state': 'icy'}),
    ({'steering_bias_deg': 2}, {'steering_bias_rad': np.deg2rad(2)}),
    ({'wind_speed': 8, 'wind_direction': 90}, {
        'wind_speed_mps': 8.0, 'wind_direction_rad': np.deg2rad(90)}),
    ({'duration_s': 2}, {'duration_s': 2.0}),
])
def test_given_a_change_at_the_start_then_it_is_the_run_of_the_changed_scene(
    rainy, settings, there
):
    changed = tx.run(dataclasses.replace(RAINY, **there), perception='taxinet')
    equal(rainy.fork(0.0, settings=settings).trace, changed.trace)


GUSTY = dataclasses.replace(CALM, wind_speed_mps=2.0, gust_mps=1.0, **{
    'wind_speed_mps@1': 9.0, 'wind_speed_mps@2.5': 4.0, 'steering_bias_deg@2': 3.0,
})


def test_given_a_run_with_signals_then_they_go_on_in_a_fork_and_may_be_changed_there():
    run = tx.run(GUSTY)
    equal(run.fork(1.2).trace, run.trace)
    # What has passed is as it was, to the bit; a later point changes what comes.
    later = dataclasses.replace(GUSTY, **{'steering_bias_deg@2.5': -3.0})
    forked = run.fork(2.0, settings={'steering_bias_deg@2.5': -3})
    equal(forked.trace, tx.run(later).trace)
    assert not forked.trace.equals(run.trace)
    # A value holds from the fork on, in place of the points.
    steady = run.fork(1.2, settings={'steering_bias_deg': 3})
    assert steady.fork_of.changes(GUSTY.to_human()) == {
        'steering_bias_deg': (0.0, 3.0), 'steering_bias_deg@2': (3.0, None)}
    with pytest.raises(tx.UsageError, match='loop_delay_s cannot change during a run'):
        run.fork(1.2, settings={'loop_delay_s@2': 0.5})
    with pytest.raises(tx.UsageError, match=r'wind_speed_mps@1 is 9\.0 m/s in the run already'):
        run.fork(1.2, settings={'wind_speed@1': 9})


def test_given_other_gains_then_they_hold_from_the_fork_on():
    run = tx.run(CALM)
    other = tx.SteeringLaw(tx.SteeringGains(heading_gain=0.4))
    asked = {'steering.heading_gain': 0.4}
    equal(run.fork(0.0, settings=asked).trace, tx.run(CALM, controller=other).trace)
    forked = run.fork(1.0, settings=asked).trace
    equal(forked[:10], run.trace[:10])
    assert forked.steering_rad[10] == pytest.approx(run.trace.steering_rad[10] / 4)


def test_given_another_perception_then_the_recorded_estimates_hold_until_the_fork(rainy):
    forked = rainy.fork(1.5, perception='truth').trace
    equal(forked[:15], rainy.trace[:15])
    np.testing.assert_array_equal(forked.est_cte_m[15:], forked.cte_m[15:])
    assert (rainy.trace.est_cte_m[15:] != rainy.trace.cte_m[15:]).all()


def test_given_an_offset_then_the_aircraft_is_there_at_the_step_and_not_before():
    run = tx.run(CALM)
    forked = run.fork(
        1.0, moved={'cte_m': -0.5, 'distance_m': 2.0, 'heading_deg': 5.0, 'speed_mps': 1.0}
    ).trace
    equal(forked[:10], run.trace[:10])
    before, after = run.trace.iloc[10], forked.iloc[10]
    assert after.cte_m - before.cte_m == pytest.approx(-0.5, abs=1e-6)
    assert after.distance_m - before.distance_m == pytest.approx(2.0, abs=1e-6)
    assert after.he_rad - before.he_rad == pytest.approx(np.deg2rad(5), abs=1e-9)
    assert after.speed_mps - before.speed_mps == pytest.approx(1.0, abs=0.02)


def test_given_wind_that_comes_up_then_the_aircraft_is_placed_anew_where_it_was(rainy):
    forked = rainy.fork(1.0, settings={'wind_speed_mps': 6, 'wind_direction_deg': 90})
    assert forked.fork_of.placed is not None
    assert rainy.fork(1.0, settings={'rain': 0}).fork_of.placed is None
    before, after = rainy.trace.iloc[10], forked.trace.iloc[10]
    assert (after.cte_m, after.x_m) == pytest.approx((before.cte_m, before.x_m), abs=1e-6)


def test_given_wind_that_changes_then_the_aircraft_rolls_on():
    windy = tx.run(dataclasses.replace(CALM, wind_speed_mps=4.0, wind_direction_rad=1.0))
    forked = windy.fork(1.0, settings={'wind_speed_mps': 12, 'gust_mps': 1})
    assert forked.fork_of.placed is None
    equal(forked.trace[:10], windy.trace[:10])
    assert forked.trace.cte_m.iloc[-1] != windy.trace.cte_m.iloc[-1]


def test_given_a_forked_run_when_saved_then_its_bag_is_whole_and_gives_its_frames_again(
    rainy, tmp_path
):
    forked = rainy.fork(1.0, settings={'rain': 0, 'clouds': 'clear'})
    bag = forked.save_bag(tmp_path / 'forked')
    assert check_bag(bag).findings == ()
    bare = open_recording(forked.save_bag(tmp_path / 'bare', images=False))
    recorded = {frame.seq: frame.image for frame in open_recording(bag).frames(render=False)}
    rendered = {frame.seq: frame.image for frame in bare.frames()}
    assert rendered.keys() == recorded.keys() == set(range(31))
    for seq, image in recorded.items():
        np.testing.assert_array_equal(image, rendered[seq])
    np.testing.assert_array_equal(recorded[9], rainy.frame(9))
    assert (recorded[10] != rainy.frame(10)).any()
    with pytest.raises(tx.UsageError, match='is itself a fork'):
        tx.fork(bag, at_s=0.5)


def test_given_a_damaged_record_of_the_fork_then_nothing_is_rendered(rainy, tmp_path):
    bag = rainy.fork(1.0, settings={'rain': 0}).save_bag(tmp_path / 'bare', images=False)
    recording = open_recording(bag)
    words = recording.metadata[FORK_METADATA]
    words['fork'] = words['fork'].replace('"step": 10', '"step": 11')
    with pytest.raises(tx.UsageError, match='record of the fork is not that of the run'):
        next(iter(recording.frames()))


def test_given_a_perception_that_is_not_reproducible_then_the_fork_is_refused():
    guessing = Guessing()
    run = tx.run(CALM, perception=guessing)
    with pytest.raises(tx.UsageError, match=r'step 0.*the run cannot be repeated'):
        run.fork(1.0, perception=guessing)


@pytest.mark.parametrize(('at_s', 'change', 'words'), [
    (1.05, {}, 'between control steps; take 1 or 1.1 s'),
    (3.1, {}, 'not within the run, 0 to 3 s'),
    (float('nan'), {}, 'not within the run'),
    (1.0, {'settings': {'speed_mps': 7}}, 'speed_mps cannot change during a run'),
    (1.0, {'settings': {'traffic': 'nobody'}}, 'traffic is nobody in the run already'),
    (1.0, {'settings': {'rain_percent': 50}}, 'rain is 50 % in the run already|rain_percent is 50'),
    (1.0, {'settings': {'clouds': 'clear'}}, 'rain needs clouds'),
    (1.0, {'settings': {'fog': 1}}, "unknown key 'fog'"),
    (1.0, {'settings': {'steering.p': 1}}, 'unknown gain'),
    (1.0, {'settings': {'duration_s': 0.5}}, 'duration_s is 0.5, before 1 s'),
    (1.0, {'moved': {'y': 1}}, "unknown offset 'y'"),
    (1.0, {'moved': {'speed_mps': -9}}, 'backwards'),
    (1.0, {'moved': {'speed_mps': 90}}, r'speed_mps of 90 leads to 94.*, outside 0\.\.10 m/s'),
    (1.0, {'moved': {'cte_m': 1e6}}, r'cte_m of 1e\+06 leads to .*, outside -15\.\.15 m left of'),
    (1.0, {'moved': {'cte_m': 1e308}}, r'cte_m of 1e\+308 leads to 1e\+308, outside'),
    (1.0, {'moved': {'cte_m': float('nan')}}, 'cte_m of nan leads to nan, outside'),
    (1.0, {'moved': {'heading_deg': 1e9}}, r'heading_deg of .*, outside -90\.\.90 deg'),
    (1.0, {'moved': {'distance_m': -1e9}}, r'outside 0\.\.2600 m past the threshold, at kmwh_04'),
    (1.0, {'moved': {'distance_m': float('inf')}}, 'distance_m of inf leads to inf'),
    (1.0, {'perception': 'nope'}, 'unknown'),
])
def test_given_what_cannot_change_then_one_line_says_so(rainy, at_s, change, words):
    with pytest.raises(tx.UsageError, match=words):
        rainy.fork(at_s, **change)


def test_given_an_aircraft_beyond_a_limit_then_it_may_be_placed_nearer_but_no_farther():
    run = tx.run(
        tx.Scenario(cross_track_m=14.9, heading_rad=1.0, duration_s=3),
        specs='far=always(cte <= 99)', controller=lambda estimate: (0.0, 5.0),
    )
    assert 15 < run.trace.cte_m[20] < 24
    nearer = run.fork(2.0, moved={'cte_m': -0.5}, controller='steering').trace
    assert nearer.cte_m[20] - run.trace.cte_m[20] == pytest.approx(-0.5, abs=1e-6)
    with pytest.raises(tx.UsageError, match=r'outside -15\.\.15 m left of the line'):
        run.fork(2.0, moved={'cte_m': 0.5}, controller='steering')


def test_given_an_offset_when_searched_then_it_has_limits_at_the_start_only(tmp_path):
    run = tx.run(
        tx.Scenario(cross_track_m=13, heading_rad=1.0, duration_s=3), perception=drifting,
        specs='right=always(cte < 14)', controller=lambda estimate: (0.0, 5.0),
    )
    assert run.outcome == 'FAIL'
    past = read_past(open_recording(run.save_bag(tmp_path / 'run', images=False)))
    change = {'settings': {}, 'perception': 'truth', 'controller': lambda estimate: (0.0, 5.0)}
    assert find_rescue(past, moved={'cte_m': 1.0}, **change).saved is None
    with pytest.raises(tx.UsageError, match='cte_m of 5 leads to 18, outside'):
        find_rescue(past, moved={'cte_m': 5.0}, **change)


def test_given_a_violated_run_then_the_point_of_no_return_is_that_of_trying_every_step(tmp_path):
    run = tx.run(CALM, perception=drifting, specs='right=eventually[2:3](cte >= 0.7)')
    assert run.outcome == 'FAIL'
    past = read_past(open_recording(run.save_bag(tmp_path / 'run', images=False)))
    change = {'settings': {}, 'moved': {}, 'perception': 'truth', 'controller': None}
    found = find_rescue(past, **change)
    saved = [run.fork(step / 10, perception='truth').outcome == 'PASS' for step in range(30)]
    last = max(step for step, fine in enumerate(saved) if fine)
    assert saved == [True] * (last + 1) + [False] * (29 - last)  # so there is one such point
    assert 0 < last < 29
    assert found.saved.fork_of.step == last
    assert found.lost_s == pytest.approx((last + 1) / 10)
    assert found.later_s == ()
    assert found.tried <= 14


def test_given_a_satisfied_run_then_there_is_nothing_to_save(rainy, tmp_path):
    past = read_past(open_recording(rainy.save_bag(tmp_path / 'run', images=False)))
    with pytest.raises(tx.UsageError, match='only what is violated can be saved'):
        find_rescue(past, settings={}, moved={}, perception='truth', controller=None)
