"""``tx.run``, ``tx.render``, ``tx.robustness``: the graph's numbers, clear words for bad input."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import taxinet_ros as tx
from taxinet_ros.bag.check.compare import same_stack
from taxinet_ros.bag.run.recording import open_recording

GOLDEN = Path(__file__).resolve().parents[2] / 'bags' / 'golden'
SHORT = tx.Scenario(cross_track_m=2.0, duration_s=2.0)
EVERY = ('phi_always', 'phi_eventually', 'on_runway', 'usable')


class Blinking:
    """Sees the truth in two frames of three."""

    needs_image = False

    def __init__(self):
        self.seen = 0

    def reset(self):
        self.seen = 0

    def __call__(self, truth):
        self.seen += 1
        return None if self.seen % 3 == 0 else (truth.cte_m, truth.he_rad)


@pytest.mark.parametrize('name', ['truth-nominal', 'taxinet-broken-clouds'])
def test_given_a_run_that_the_graph_recorded_when_made_here_then_its_trace_is_the_same(name):
    recording = open_recording(GOLDEN / name)
    recorded, asked = recording.trace, recording.run
    specs = asked.request.judging.specs
    run = tx.run(recording.scenario, perception=asked.perception, specs=specs)
    assert len(run.trace) == 121
    assert list(run.trace.columns) == list(recorded.columns)
    assert run.trace.attrs == recorded.attrs
    assert run.fingerprint == asked.fingerprint
    if same_stack(GOLDEN):
        pd.testing.assert_frame_equal(run.trace, recorded, check_exact=True)
    else:
        np.testing.assert_allclose(run.trace['cte_m'], recorded['cte_m'], atol=0.2)


def test_given_a_whole_run_then_each_formula_has_the_robustness_of_its_trace():
    run = tx.run(SHORT, perception=Blinking(), specs=EVERY)
    assert list(run.rho) == list(EVERY)
    assert run.statistics.unusable_estimates == 7
    for name, (lower, upper) in run.rho.items():
        assert lower == upper == tx.robustness(name, run.trace)
    assert run.outcome == 'FAIL'  # usable: two frames in three


def test_given_a_function_with_reset_then_each_run_finds_it_as_new():
    blinking = Blinking()
    first, second = (tx.run(SHORT, perception=blinking) for _ in range(2))
    assert not first.trace['est_valid'].all()
    pd.testing.assert_frame_equal(first.trace, second.trace, check_exact=True)


def test_given_a_trace_that_is_changed_then_the_run_keeps_its_own():
    run = tx.run(SHORT)
    changed = run.trace
    changed['cte_m'] = 99.0
    assert tx.robustness('phi_eventually', run.trace) == run.rho['phi_eventually'].lower


class Braking:
    """A controller as the protocol has it: told of the scenario before each run."""

    def begin(self, scenario):
        self.speed_mps = scenario.speed_mps / 2

    def command(self, estimate):
        return 0.0, self.speed_mps


class Forgetting(Braking):
    speed_mps = 1.0

    def begin(self):
        """Take no scenario."""


def test_given_an_object_as_controller_then_its_begin_may_take_the_scenario():
    scenario = replace(SHORT, speed_mps=8.0)
    assert set(tx.run(scenario, controller=Braking()).trace['speed_cmd_mps']) == {4.0}
    assert set(tx.run(scenario, controller=Forgetting()).trace['speed_cmd_mps']) == {1.0}


@pytest.mark.parametrize(('options', 'words'), [
    ({'controller': type('Odd', (Braking,), {'begin': lambda self, a, b: None})()},
     'controller: begin of .* cannot be called with the scenario or nothing'),
    ({'perception': type('Odd', (Blinking,), {'begin': lambda self, scenario: None})()},
     'perception: begin of .* cannot be called with no argument'),
    ({'perception': type('Odd', (Blinking,), {'reset': 3})()}, 'perception: reset of '),
])
def test_given_an_object_that_cannot_be_begun_then_it_is_refused_by_name(options, words):
    with pytest.raises(tx.UsageError, match=words):
        tx.run(SHORT, **options)


@pytest.mark.parametrize('scenario', [
    replace(SHORT, speed_mps=10.0), replace(SHORT, runway_state='icy'),
])
def test_given_a_fast_or_slippery_run_then_it_is_not_said_that_none_can_violate(scenario, recwarn):
    tx.run(scenario, specs='fast=always(speed <= 12)')
    assert [str(one.message) for one in recwarn] == []


def test_given_a_formula_on_an_estimate_that_is_missing_then_the_run_has_no_verdict():
    spec = 'always(abs(cte_estimate) <= 9)'
    run = tx.run(SHORT, perception=Blinking(), specs=spec)
    assert run.outcome == 'INFRA_ERROR'
    with pytest.raises(tx.UsageError, match=r'cte_estimate.* is nan at sample 2'):
        tx.robustness(spec, run.trace)


def test_given_a_run_that_is_stopped_then_its_robustness_is_an_interval():
    run = tx.run(SHORT, specs='phi_always', stop_on='violated')
    assert (run.outcome, run.stopped_early, len(run.steps)) == ('FAIL', True, 1)
    assert run.rho['phi_always'].lower < run.rho['phi_always'].upper < 0
    assert len(list(run.frames())) == 1


def test_given_a_run_then_its_frames_are_those_that_the_perception_saw():
    seen = []

    def look(frame):
        seen.append(frame.copy())
        frame[:] = 0  # what it writes is its own affair
        return 0.0, 0.0

    run = tx.run(tx.Scenario(cross_track_m=2.0, clouds='broken', rain_fraction=0.5, duration_s=1.0),
                 perception=look)
    frames = list(run.frames())
    assert len(frames) == len(seen) == 11
    assert all(np.array_equal(*pair) for pair in zip(frames, seen, strict=True))
    assert np.array_equal(run.frame(7), seen[7])
    state = run.steps[7].observation.state
    assert np.array_equal(tx.render(run.scenario, state, t_s=0.7), seen[7])


def test_given_a_pose_then_the_picture_is_that_of_a_run_that_starts_there():
    light = {'time_of_day_s': 16 * 3600.0, 'clouds': 'cirrus'}
    there = tx.Scenario(distance_m=900.0, cross_track_m=-2.0, heading_rad=0.05, **light)
    picture = tx.render(tx.Scenario(**light), (900.0, -2.0, 0.05))
    assert (picture.shape, picture.dtype) == ((200, 360, 3), np.uint8)
    assert np.array_equal(picture, tx.render(there))


def test_given_gains_then_they_steer():
    asked = tx.Scenario(cross_track_m=3.0, duration_s=5.0)
    idle = tx.run(asked, controller=tx.SteeringLaw(tx.SteeringGains(heading_gain=0.0)))
    assert (idle.trace['steering_rad'] == 0).all()
    assert (tx.run(asked).trace['steering_rad'] != 0).all()


def test_given_columns_of_ones_own_then_formulas_read_them():
    mine = pd.DataFrame({'t_s': [0.0, 0.5, 1.0], 'gap_m': [4.0, 2.5, 3.0], 'word': ['a', 'b', 'c']})
    assert tx.robustness('always(gap_m >= 2)', mine) == 0.5
    assert tx.robustness('eventually[0.6:1](gap_m >= 2)', mine) == 1.0
    assert tx.robustness(tx.Spec.parse('on_runway'), mine.assign(cte=1.24)) == 14.0


def answering(answer):
    return lambda seen: answer


@pytest.mark.parametrize(('call', 'words'), [
    (lambda: tx.run(SHORT, perception='nothing'), "perception: 'nothing' is unknown"),
    (lambda: tx.run(SHORT, perception=3), 'perception: 3 is neither'),
    (lambda: tx.run(SHORT, perception=answering('left')), "perception: answered 'left'; expected"),
    (lambda: tx.run(SHORT, controller='nothing'), "controller: 'nothing' is unknown"),
    (lambda: tx.run(SHORT, controller=3), 'controller: 3 is neither'),
    (lambda: tx.run(SHORT, controller=answering((0.1, -1.0))), r'controller: answered \(0.1, -1'),
    (lambda: tx.run(SHORT, controller=answering(None)), 'controller: answered None; expected'),
    (lambda: tx.run(SHORT, specs=[]), 'no requirement'),
    (lambda: tx.run(SHORT, specs='phi_never'), "unknown name 'phi_never'"),
    (lambda: tx.run(SHORT, specs=['usable', 'usable']), 'usable is given twice'),
    (lambda: tx.run(SHORT, specs='always[50:60](cte <= 1)'), 'always'),
    (lambda: tx.run(SHORT, stop_on='tired'), 'tired'),
    (lambda: tx.run(SHORT, world='moon'), "world: 'moon' is unknown; known: kmwh"),
    (lambda: tx.run(SHORT).frame(21), 'no control step 21; it has 0 to 20'),
    (lambda: tx.render(SHORT, (400.0, 99.0, 0.0)), 'cross_track_m is 99, outside'),
    (lambda: tx.render(SHORT, t_s=-1.0), 't_s is -1'),
    (lambda: tx.robustness('always(gap <= 1)', pd.DataFrame({'gap': [1.0]})), 'no column t_ns'),
    (lambda: tx.robustness('phi_always', pd.DataFrame({'t_s': [0.0]})), 'reads cte, which is no'),
    (lambda: tx.robustness('x <= 1', pd.DataFrame({'t_s': [np.nan], 'x': [1.0]})), 't_s is not'),
])
def test_given_what_cannot_be_then_one_line_says_so(call, words):
    with pytest.raises(tx.UsageError, match=words) as caught:
        call()
    assert '\n' not in str(caught.value)


def test_given_a_function_that_raises_then_what_it_raises_comes_through():
    with pytest.raises(ZeroDivisionError):
        tx.run(SHORT, perception=lambda frame: 1 / 0)


@pytest.mark.parametrize(('values', 'words'), [
    ({'shadows': 'False'}, "shadows is 'False', not True or False"),
    ({'crossing': None}, 'crossing is None, not True or False'),
    ({'cross_track_m': None}, 'cross_track_m is None, not a number'),
    ({'cross_track_m': '3'}, "cross_track_m is '3', not a number"),
    ({'cross_track_m': True}, 'cross_track_m is True, not a number'),
    ({'date': 20200320}, 'date is 20200320, not a date, YYYY-MM-DD'),
    ({'clouds': 3}, 'clouds is 3, not a word'),
])
def test_given_a_value_of_another_kind_then_the_scenario_names_it(values, words):
    with pytest.raises(tx.UsageError, match=re.escape(words)):
        tx.Scenario(**values)


@pytest.mark.parametrize('specs', [
    {'phi_always': 'always(speed <= 6)'}, None, 3, ['phi_always', None], [],
])
def test_given_requirements_that_are_none_then_they_are_refused_and_none_is_dropped(specs):
    with pytest.raises(tx.UsageError, match='specs: '):
        tx.run(tx.Scenario(duration_s=0.5), perception='truth', specs=specs)


@pytest.mark.parametrize(('times', 'words'), [
    (pd.to_timedelta([0, 0.5, 2], unit='s'), 'expected seconds as numbers'),
    (pd.to_datetime([0, 1, 2], unit='s'), 'expected seconds as numbers'),
    ([0.0, 1e12, 1e30], 'beyond 1e.09'),
    (['0', '1', '2'], 'expected seconds as numbers'),
])
def test_given_times_that_are_no_seconds_then_no_robustness_is_made_of_them(times, words):
    trace = pd.DataFrame({'t_s': times, 'g': [4.0, 1.0, 3.0]})
    with pytest.raises(tx.UsageError, match=words):
        tx.robustness('always[0:1](g >= 2)', trace)


@pytest.mark.parametrize('kind', ['float32', 'float16', 'Float32'])
def test_times_of_fewer_than_64_bits_are_refused_as_they_move_samples_out_of_windows(kind):
    trace = pd.DataFrame({'t_s': np.arange(60) * 0.1, 'a': np.where(np.arange(60) == 3, -1.0, 1.0)})
    assert tx.robustness('always[0:0.3](a >= 0)', trace) == -1.0
    with pytest.raises(tx.UsageError, match=f't_s holds {kind}; expected seconds as .* float64'):
        tx.robustness('always[0:0.3](a >= 0)', trace.astype({'t_s': kind}))


@pytest.mark.parametrize('name', ['a', 'cte_m', 't_s', 'word'])
def test_columns_of_one_name_are_named(name):
    trace = pd.DataFrame({'t_s': [0.0, 1.0], 'a': [1.0, 2.0], 'cte_m': 0.0, 'word': 'x'})
    with pytest.raises(tx.UsageError, match=f'trace: several columns are named {name}; leave'):
        tx.robustness('always(a >= 0)', pd.concat([trace, trace[[name]]], axis=1))


@pytest.mark.parametrize('name', [*'SRGFUWHO', 'once', 'max'])
def test_a_column_that_is_named_like_a_word_of_formulas_is_said_to_be(name):
    trace = pd.DataFrame({'t_s': [0.0, 1.0], name: [1.0, 2.0], 'a': [1.0, 2.0]})
    with pytest.raises(tx.UsageError, match=f'; column {name} is named like a word of formulas'):
        tx.robustness(f'always({name} >= 0)', trace)
    assert tx.robustness('G(a >= 0)', trace) == 1.0


def test_given_no_number_of_runs_then_a_search_is_refused_before_it_begins(tmp_path):
    for runs in (0, -1, 1.5, '2'):
        with pytest.raises(tx.UsageError, match='runs: got'):
            tx.falsify('s_falsif', runs=runs, out=tmp_path / 'never')
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(('given', 'words'), [
    ({'specs': 'late=always[0:60](cte <= 3)'}, r'late: always\[0:60\] ends at 60 s, after the run'),
    ({'specs': 'turn=always(abs(he) <= 12)'}, 'turn: no run can violate it.*did you mean 12 deg'),
    ({'specs': 'phi_always', 'bounds': 'cte=-1:1'}, 'bounds, rates: broken at 0 s; from there on'),
    ({'specs': 'phi_always', 'rates': 'cte=0.001'}, 'bounds, rates: broken at 0.[1-9] s; from'),
])
def test_given_what_may_not_be_meant_or_does_not_hold_then_the_caller_is_warned(given, words):
    with pytest.warns(UserWarning, match=words) as warned:
        tx.run(SHORT, **given)
    assert {Path(one.filename).name for one in warned} == {'test_run.py'}


def test_given_a_command_of_a_file_that_no_aircraft_can_follow_then_its_line_says_so(tmp_path):
    file = tmp_path / 'mine.py'
    for answer in ('float("nan"), 5.0', '0.0, -1.0', '0.0, float("inf")'):
        file.write_text(f'def steer(estimate): return {answer}\n')
        with pytest.raises(tx.UserCodeError, match=r'mine\.py: steer returned .*, speed not neg'):
            tx.run(SHORT, controller=f'{file}:steer')


@pytest.mark.parametrize(('given', 'words'), [
    ({'t_s': 1e300}, 'render: t_s is 1e.300; expected 0 to 1e.09 seconds'),
    ({'t_s': -1.0}, 'render: t_s is -1; expected'),
    ({'pose': replace(tx.run(SHORT, specs='phi_always').steps[0].observation.state, z_m=-5.0)},
     'render: camera: .* the aircraft is not on its wheels'),
])
def test_given_what_no_camera_can_see_then_one_line_says_so(given, words):
    with pytest.raises(tx.UsageError, match=words):
        tx.render(SHORT, **given)
