"""Faults hold from their onset on, and are the same wherever a run is driven."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.faults import (
    SteeringFaults,
    check_free,
    frame_lost,
    loop_delay_ns,
    shown_step,
    unseen_faults,
)
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import FAULTS, LENS_DIRT, PICTURE_FAULTS, STEERING_BIAS
from taxinet_ros.core.types import NS_PER_S, TaxiCommand
from taxinet_ros.core.world import SimulatedWorld, _PluginWorld
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import WORLDS, Extension
from taxinet_ros.trials.options import make_options

SCENE = {'duration': 2.0, 'time_of_day': 7.0, 'cross_track': 2.0, 'heading': -6.0}
ONSET_STEP = 10
SEVERE = {
    'camera_dropout_percent': 60, 'camera_freeze_s': 0.5, 'lens_dirt_percent': 20,
    'lens_drops_percent': 20, 'glare_ghost_percent': 100, 'exposure_jump_ev': -2,
}


def scene(**changes) -> Scenario:
    return scenario_from_human({**SCENE, **changes})


def frames(scenario: Scenario, make=SimulatedWorld) -> list[np.ndarray]:
    """What the camera delivers at each step of a run that rolls straight on."""
    world, seen = make(scenario), []
    while True:
        seen.append(world.observe().image)
        if len(seen) > world.last_seq:
            return seen
        world.advance(TaxiCommand(steering_rad=0.05, speed_mps=5.0))


@functools.cache
def well() -> list[np.ndarray]:
    return frames(scene())


def same(left: list[np.ndarray], right: list[np.ndarray]) -> list[bool]:
    assert len(left) == len(right) == len(well()) == 21
    return [one.tobytes() == other.tobytes() for one, other in zip(left, right, strict=True)]


def test_given_all_faults_of_pictures_then_the_tests_below_have_each():
    assert list(SEVERE) == [field.key for field in PICTURE_FAULTS]


@pytest.mark.parametrize('key', SEVERE)
def test_given_a_fault_of_the_camera_then_frames_differ_from_its_onset_on_as_its_seed_says(key):
    drawn = key in ('camera_dropout_percent', 'lens_dirt_percent', 'lens_drops_percent')
    failing = {key: SEVERE[key], 'fault_onset': 1.0}
    seeded = failing | ({'fault_seed': 4} if drawn else {})
    seen = frames(scene(**seeded))
    assert all(same(seen, frames(scene(**seeded))))
    if drawn:
        assert not all(same(seen, frames(scene(**failing, fault_seed=5))))
    alike = same(seen, well())
    assert all(alike[:ONSET_STEP])
    now = alike[ONSET_STEP:]
    if key == 'camera_freeze_s':
        # The picture of the onset itself is right; five more repeat it.
        assert now == [True] + [False] * 5 + [True] * 5
    elif key == 'camera_dropout_percent':
        assert 2 <= sum(now) <= 8
    else:
        assert not any(now)


def test_given_a_lost_frame_then_it_is_black_and_the_share_is_the_one_asked_for():
    lost = [not frame.any() for frame in frames(scene(camera_dropout=60))]
    assert lost == [frame_lost(scene(camera_dropout=60), k * CONTROL_PERIOD_NS) for k in range(21)]
    long = [frame_lost(scene(camera_dropout=30), k * CONTROL_PERIOD_NS) for k in range(4000)]
    assert np.mean(long) == pytest.approx(0.3, abs=0.03)
    assert all(frame_lost(scene(camera_dropout=100), k) for k in range(50))


def test_given_a_frozen_camera_then_the_picture_of_the_onset_repeats_also_where_it_was_not_seen():
    failing = scene(camera_freeze=0.5, fault_onset=1.0)
    assert [shown_step(failing, seq, CONTROL_PERIOD_NS) for seq in range(9, 18)] == [
        9, 10, 10, 10, 10, 10, 10, 16, 17,
    ]
    late = scene(camera_freeze=0.25, fault_onset=0.95)
    assert [shown_step(late, seq, CONTROL_PERIOD_NS) for seq in range(9, 15)] == [
        9, 10, 10, 10, 10, 14,
    ], 'whole steps, rounded up'
    world = SimulatedWorld(failing)
    for seq in range(13):
        assert world.observe(picture=False).image is None
        assert world.observe(picture=False).seq == seq
        world.advance(TaxiCommand(steering_rad=0.05, speed_mps=5.0))
    now = world.observe()
    assert now.image.tobytes() == well()[10].tobytes()
    assert now.state != SimulatedWorld(failing).observe().state


def test_given_a_world_of_a_package_then_the_same_faults_are_in_its_pictures():
    given = []

    class Others(SimulatedWorld):
        def __init__(self, scenario, *, pictures=True):
            given.append(scenario)
            super().__init__(scenario, pictures=pictures)

    failing = scene(**(SEVERE | {'camera_dropout_percent': 20}), fault_onset=1.0, fault_seed=2)
    biased = dataclasses.replace(failing, steering_bias_rad=0.02, steering_rate_limit_radps=0.1)
    extension = Extension(
        kind=WORLDS, name='others', target='others:Others', distribution='others', version='1',
    )
    ours = frames(biased)
    theirs = frames(biased, lambda scenario: _PluginWorld(extension, Others, scenario))
    assert all(same(theirs, ours))
    assert given == [scene()], 'faults are not added twice'


def steered(scenario: Scenario, angles_deg: list[float]) -> list[float]:
    faults = SteeringFaults(scenario, math.radians(15), CONTROL_PERIOD_NS)
    obeyed = [
        faults.apply(
            TaxiCommand(steering_rad=math.radians(angle), speed_mps=4.0), seq * CONTROL_PERIOD_NS
        )
        for seq, angle in enumerate(angles_deg)
    ]
    assert {command.speed_mps for command in obeyed} == {4.0}
    return [round(math.degrees(command.steering_rad), 9) for command in obeyed]


def test_given_a_bias_then_the_wheel_is_beside_the_command_from_the_onset_on_within_its_stops():
    assert steered(scene(), [1.0, 20.0]) == [1.0, 20.0]
    assert steered(scene(steering_bias=2, fault_onset=0.2), [1, 1, 1, -3, 14, -20]) == [
        1, 1, 3, -1, 15, -13,
    ]


def test_given_a_rate_limit_then_the_wheel_follows_at_that_rate_from_where_it_was():
    slow = scene(steering_rate_limit=10, fault_onset=0.2)
    assert steered(slow, [5, -5, 5, 5, -3.5, -3.5, -3.5]) == [5, -5, -4, -3, -3.5, -3.5, -3.5]
    # A command beyond the stops winds nothing up.
    assert steered(slow, [15, 15, 90, 90, 14.5]) == [15, 15, 15, 15, 14.5]
    both = scene(steering_rate_limit=10, steering_bias=2.5)
    assert steered(both, [0, 0, 0, 0]) == [1, 2, 2.5, 2.5]


def test_given_a_biased_wheel_then_the_command_is_the_controllers_and_the_truth_shows_the_bias():
    well, biased = (
        tx.run(scene(cross_track=0, heading=0, duration=10, **bias))
        for bias in ({}, {'steering_bias': 3, 'fault_onset': 1.0})
    )
    columns = ['cte_m', 'steering_rad']
    before = well.trace['t_ns'] <= NS_PER_S
    assert well.trace[before][columns].equals(biased.trace[before][columns])
    last = biased.trace.iloc[-1]
    # The law balances the bias by an offset to the left: it steers right by as much.
    assert last['cte_m'] > 0.3
    assert math.degrees(last['steering_rad']) == pytest.approx(-3, abs=0.5)


def test_given_a_delay_of_the_loop_then_it_is_that_of_the_option_and_adds_to_it():
    turning = {'cross_track': 4.0, 'duration': 6}
    late = tx.run(scene(**turning, loop_delay=0.3))
    assert late.trace.equals(tx.run(scene(**turning), latency='perception=0.3').trace)
    both = tx.run(scene(**turning, loop_delay=0.2), latency='perception=0.1')
    assert late.trace.equals(both.trace)
    assert not late.trace.equals(tx.run(scene(**turning)).trace)


def test_given_jitter_then_delays_are_uniform_by_the_seed_from_the_onset_on():
    jittery = scene(loop_delay=0.1, loop_jitter=0.4, fault_onset=0.5, fault_seed=3)
    delays = [loop_delay_ns(jittery, k * CONTROL_PERIOD_NS) / NS_PER_S for k in range(3000)]
    assert delays[:5] == [0.0] * 5
    assert 0.1 <= min(delays[5:]) < 0.11
    assert 0.49 < max(delays[5:]) <= 0.5
    assert np.mean(delays[5:]) == pytest.approx(0.3, abs=0.01)
    other = dataclasses.replace(jittery, fault_seed=4.0)
    assert loop_delay_ns(other, NS_PER_S) != loop_delay_ns(jittery, NS_PER_S)


def test_given_faults_when_taken_away_then_onset_and_seed_go_with_the_last_that_has_them():
    failing = scene(lens_dirt=20, steering_bias=2, fault_onset=1, fault_seed=3)
    assert failing.faults == (LENS_DIRT, STEERING_BIAS)
    assert failing.without_faults(*FAULTS) == scene()
    assert failing.without_faults(LENS_DIRT) == scene(steering_bias=2, fault_onset=1)
    assert failing.without_faults(STEERING_BIAS) == scene(
        lens_dirt=20, fault_onset=1, fault_seed=3
    )


def test_given_a_run_with_faults_when_recorded_then_its_frames_are_rendered_again_alike(tmp_path):
    failing = scene(
        **(SEVERE | {'camera_dropout_percent': 20}), loop_delay=0.1, loop_jitter=0.3,
        steering_bias=2, steering_rate_limit=8, fault_onset=0.7, fault_seed=9,
    )
    run = tx.run(failing, perception='taxinet')
    run.save_bag(tmp_path / 'with')
    run.save_bag(tmp_path / 'without', images=False)
    there, again = (
        [frame.image for frame in tx.open_recording(tmp_path / name).frames()]
        for name in ('with', 'without')
    )
    assert all(same(there, again))
    assert all(same(there, list(run.frames())))
    assert tx.open_recording(tmp_path / 'with').scenario == failing


def test_given_a_perception_that_needs_no_picture_then_faults_of_the_camera_are_warned_of():
    failing = scene(lens_dirt=20, camera_freeze=1, steering_bias=2)
    words = 'camera_freeze_s, lens_dirt_percent: no effect, as the perception needs no picture'
    with pytest.warns(UserWarning, match=words):
        tx.run(failing, perception='truth')
    assert unseen_faults(scene(steering_bias=2)) == []
    options = make_options(
        program='nominal', runs=1, seed=0, perception='truth', settings=(), specs=(), out=None,
        processes=False,
    )
    assert options.check(failing, set).warnings[-1] == words
    assert options.check(scene(steering_bias=2, duration=30), set).warnings == ()
    seeing = dataclasses.replace(options, perception='taxinet')
    assert not any('no picture' in line for line in seeing.check(failing, set).warnings)


def test_given_a_free_run_then_a_delay_of_the_loop_is_refused_by_name():
    with pytest.raises(UsageError, match='loop_delay_s, loop_jitter_s: no effect in a free run'):
        check_free(scene(loop_jitter=0.1))
    check_free(scene(lens_dirt=10))
    options = make_options(
        program='nominal', runs=1, seed=0, perception='truth', settings=(), specs=(), out=None,
        processes=False, free=True,
    )
    with pytest.raises(UsageError, match='no effect in a free run'):
        options.check(scene(loop_delay=0.1), set)
