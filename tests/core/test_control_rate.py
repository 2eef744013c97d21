"""The control rate of a run: the same motion, seen and steered more or less often."""

from __future__ import annotations

import itertools
import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import taxinet_ros as tx
from taxinet_ros.analysis.report.viewer import read_frames
from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.assurance.switch import Alarm, make_controller
from taxinet_ros.core.control_step import last_step, signals
from taxinet_ros.core.faults import begun, check_free, shown_step
from taxinet_ros.core.loop import LateCommands
from taxinet_ros.core.motion.aircraft import PHYSICS_HZ
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.pacing.timing import AT_ONCE
from taxinet_ros.core.perception.perception import GroundTruth
from taxinet_ros.core.perception.substituted import parse_substitution, substituted
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import CONSTANT, CONTROL_RATES_HZ
from taxinet_ros.core.sensing import Schedule
from taxinet_ros.core.sensors import load_sensors
from taxinet_ros.core.signals import Signal
from taxinet_ros.core.traffic.traffic import GroundObject, Size
from taxinet_ros.core.types import (
    NS_PER_S,
    TaxiCommand,
    TrackingError,
    step_stamp_ns,
    steps_in,
    time_words,
)
from taxinet_ros.core.verdict.judge import Judge, check_specs
from taxinet_ros.core.world import SimulatedWorld, _PluginWorld
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.forecast.forecast import samples_of
from taxinet_ros.registry import WORLDS, Extension
from taxinet_ros.scenes.overrides import apply_overrides, check_overrides
from taxinet_ros.scenes.source import SceneSource, first_scene
from taxinet_ros.trials.options import make_options

OTHERS = Extension(
    kind=WORLDS, name='others', target='others:Others', distribution='others', version='1',
)
WINDY = {
    'cross_track_m': 2.0, 'heading_deg': 4.0, 'duration_s': 2.0, 'wind_speed_mps': 8.0,
    'wind_direction_deg': 90.0, 'clouds': 'overcast', 'rain_percent': 40, 'sensors': 'standard',
}
NEAR = {'cross_track_m': 1.0, 'duration_s': 3.0}


def scene(rate_hz: float, **human: object) -> Scenario:
    return scenario_from_human({'control_rate_hz': rate_hz, **human})


def braked(scenario: Scenario) -> dict[int, list[object]]:
    """A run with full brakes and a wheel that turns every 0.2 s: what is seen, by its time."""
    world, seen = SimulatedWorld(scenario), {}
    for seq in range(world.last_seq + 1):
        now = world.observe(picture=seq % (scenario.control_rate_hz // 5) == 0)
        seen[now.stamp_ns] = now
        if seq < world.last_seq:
            turned = now.stamp_ns // 200_000_000 % 3 - 1
            world.advance(TaxiCommand(steering_rad=0.1 * turned, speed_mps=0.0))
    return seen


def test_given_the_allowed_rates_then_whole_seconds_are_steps_and_a_stamp_tells_its_step():
    assert [hz for hz in range(5, 61) if not PHYSICS_HZ % hz] == [*CONTROL_RATES_HZ]
    for rate_hz in CONTROL_RATES_HZ:
        longest = scene(rate_hz, duration_s=600)
        period_ns = longest.period_ns
        stamps = [step_stamp_ns(seq, period_ns) for seq in range(last_step(longest) + 1)]
        assert stamps[::rate_hz] == [second * NS_PER_S for second in range(601)]
        assert {after - before for before, after in itertools.pairwise(stamps)} == {
            NS_PER_S // rate_hz, -(-NS_PER_S // rate_hz)}
        for seq, stamp_ns in enumerate(stamps):
            assert stamp_ns // period_ns == steps_in(stamp_ns, period_ns) == seq
            assert steps_in(stamp_ns + 1, period_ns) == seq + 1


def test_given_a_period_that_is_not_whole_then_windows_have_the_samples_at_their_ends():
    scenario = scene(30, duration_s=30.0)
    specs = [parse_spec(text) for text in (
        'whole=always[0:30](cte <= 30)', 'from=always[10:30](cte >= 10)',
        'one=F[10.1:10.1](cte >= 10.1)', 'last=F[10:30](cte >= 30)', 'late=F[30:30](cte >= 29)',
        'frames=always(unusable_share <= 0.25)',
    )]
    check_specs(specs, scenario)
    judge = Judge(specs, scenario.duration_ns, scenario.period_ns)
    for seq in range(last_step(scenario) + 1):
        stamp_ns = step_stamp_ns(seq, scenario.period_ns)
        heard = TrackingError(cte_m=0.0, he_rad=0.0, valid=seq != 0)
        now = judge.push(stamp_ns, signals(
            cte_m=stamp_ns / NS_PER_S, he_rad=0.0, x_m=0.0, speed_mps=5.0, estimate=heard,
            command=TaxiCommand(steering_rad=0.0, speed_mps=5.0),
        ))
    found = [(reading.interval.lower, reading.interval.upper) for reading in now]
    assert found == [
        (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (1.0, 1.0),
        (pytest.approx(0.25 - 1 / 901), pytest.approx(0.25 - 1 / 901)),
    ]


def test_given_a_period_that_is_not_whole_then_a_delay_of_whole_ones_is_whole_steps():
    scenario = scene(30, loop_delay_s=0.1)
    late = LateCommands(AT_ONCE, 0, 0, scenario)
    told = [TaxiCommand(steering_rad=0.0, speed_mps=seq + 1.0) for seq in range(900)]
    obeyed = [late.at(seq, command).speed_mps for seq, command in enumerate(told)]
    assert obeyed == [scenario.speed_mps] * 3 + [seq + 1.0 for seq in range(897)]


@pytest.mark.parametrize('rate_hz', CONTROL_RATES_HZ)
def test_given_times_that_are_those_of_steps_then_they_have_come_at_these_steps(rate_hz):
    for count in range(1, 13):
        time_s = count / rate_hz
        late = scene(rate_hz, loop_delay_s=time_s)
        period_ns, told = late.period_ns, [TaxiCommand(steering_rad=0.0, speed_mps=seq + 1.0)
                                           for seq in range(60)]
        commands = LateCommands(AT_ONCE, 0, 0, late)
        obeyed = [commands.at(seq, command).speed_mps for seq, command in enumerate(told)]
        assert obeyed == [late.speed_mps] * count + [seq + 1.0 for seq in range(60 - count)]
        frozen = scene(rate_hz, camera_freeze_s=time_s, fault_onset_s=time_s)
        assert [seq for seq in range(60) if shown_step(frozen, seq, period_ns) != seq] == [
            *range(count + 1, 2 * count + 1)]
        assert [begun(frozen, step_stamp_ns(seq, period_ns)) for seq in range(60)] == [
            seq >= count for seq in range(60)]
        jump = Signal(times_ns=(round(time_s * 1e9),), values=(1,), form=CONSTANT)
        line = GroundObject(kind='hold_line', x_m=0.0, y_m=0.0, heading_deg=0.0,
                            size=Size(2.1, 22.0, 0.0), colour='yellow', until_s=time_s)
        for seq in range(60):
            stamp_ns = step_stamp_ns(seq, period_ns)
            assert jump.at(0, stamp_ns) == (stamp_ns >= line.until_ns) == (seq >= count)
        sensed = scene(rate_hz, sensors=load_sensors({
            'wheel': {'rate_hz': rate_hz, 'delay_s': time_s}}))
        due = Schedule(sensed, period_ns)
        assert [[number for _, number in due.due(seq)] for seq in range(40)] == [
            [seq - count] if seq >= count else [] for seq in range(40)]


@pytest.mark.one_in(3)
@pytest.mark.parametrize('rate_hz', [5, 20, 40, 30, 60])
def test_given_commands_that_are_held_then_the_states_and_frames_are_those_at_10_hz(rate_hz):
    usual, other = braked(scene(10, **WINDY)), braked(scene(rate_hz, **WINDY))
    assert (len(usual), len(other)) == (21, 2 * rate_hz + 1)
    shared = sorted(usual.keys() & other.keys())
    assert len(shared) == min(21, 2 * rate_hz + 1)
    assert [other[at].state for at in shared] == [usual[at].state for at in shared]
    pictures = [at for at in shared if at % 200_000_000 == 0]
    assert len(pictures) == 11
    for at in pictures:
        assert np.array_equal(other[at].image, usual[at].image)
    fixes = [
        [fix for now in seen.values() for fix in now.measured.gnss] for seen in (usual, other)
    ]
    assert fixes[0] == fixes[1]
    assert len(fixes[0]) > 5


def test_given_gusts_then_they_are_drawn_in_physics_steps_and_hardly_depend_on_the_rate():
    usual, other = (braked(scene(hz, **WINDY, gust_mps=3.0)) for hz in (10, 20))
    still = braked(scene(10, **WINDY))
    off_m = [abs(usual[at].state.y_m - other[at].state.y_m) for at in usual]
    gusts_m = [abs(usual[at].state.y_m - still[at].state.y_m) for at in usual]
    # They blow along the way through the air, whose direction is taken at each control step.
    assert 0 < max(off_m) < 0.05 * max(gusts_m)


@pytest.mark.parametrize('rate_hz', [
    pytest.param(rate, marks=pytest.mark.nightly) if 5 < rate < 60 else rate
    for rate in CONTROL_RATES_HZ
])
def test_given_the_steering_law_then_its_path_is_nearly_that_at_10_hz(rate_hz):
    usual, other = (
        tx.run(scene(hz, cross_track_m=3.0, heading_deg=5.0), perception='truth').trace
        for hz in (10, rate_hz)
    )
    assert len(other) == 30 * rate_hz + 1
    found = np.interp(usual.t_s, other.t_s, other.cte_m)
    # Frames twice as far apart are a tenth of a second later on average: at 5 m/s some centimetres.
    assert np.abs(found - usual.cte_m).max() < 0.1
    assert np.abs(other.speed_mps - 5.0).max() < 0.1


@pytest.mark.parametrize('rate_hz', [20, 30])
def test_given_another_rate_when_recorded_then_bag_and_run_say_the_same(rate_hz, tmp_path):
    specs = ['phi_always', 'late=always[1:3](abs(cte) <= 0.4)', 'seen=always(estimate_gap <= 0.04)']
    run = tx.run(scene(rate_hz, **NEAR), perception='truth', specs=specs)
    recording = open_recording(run.save_bag(tmp_path / 'run', images=False))
    assert recording.run.request.scenario == run.scenario
    assert recording.period_ns == NS_PER_S // rate_hz
    assert [check.findings for check in check_bag(tmp_path / 'run').checks] == [()] * 4
    pd = recording.trace
    stamps_ns = [seq * NS_PER_S // rate_hz for seq in range(3 * rate_hz + 1)]
    assert pd.t_s.tolist() == [stamp_ns / NS_PER_S for stamp_ns in stamps_ns]
    assert pd.seq.tolist() == [*range(3 * rate_hz + 1)]
    for name, text in zip(run.rho, specs, strict=True):
        judged = recording.judge(text)
        assert judged.interval == run.rho[name]
    assert run.rho['seen'].lower == pytest.approx(0.04)
    with pytest.raises(UsageError, match=f'its control_rate_hz is {rate_hz}, a forecast needs'):
        next(samples_of(recording, 'phi_always'))
    frames = list(recording.frames(lambda seq: seq in (0, 7)))
    assert [(one.seq, one.stamp_ns) for one in frames] == [(0, 0), (7, stamps_ns[7])]


@pytest.mark.nightly
def test_given_another_rate_when_shown_then_films_and_pages_go_as_fast_as_the_run(
    tmp_path, taxinet
):
    run = tx.run(scene(20, **NEAR), perception='truth')
    bag = run.save_bag(tmp_path / 'run', images=True)
    assert taxinet('bag', 'export', bag, '--out', tmp_path / 'f.gif')[0] == 0
    with Image.open(tmp_path / 'f.gif') as gif:
        assert (gif.n_frames, gif.info['duration']) == (31, 100)
    assert taxinet('bag', 'export', bag, '--out', tmp_path / 'f.mp4')[0] == 0
    film = cv2.VideoCapture(str(tmp_path / 'f.mp4'))
    assert (film.get(cv2.CAP_PROP_FPS), film.get(cv2.CAP_PROP_FRAME_COUNT)) == (20, 61)
    assert read_frames(open_recording(bag)).steps == tuple(range(0, 61, 10))


def test_given_two_bags_at_another_rate_then_the_first_difference_has_its_time(tmp_path, taxinet):
    for name, turns in (('one', 99), ('two', 7)):
        steps = itertools.count()
        run = tx.run(
            scene(20, **NEAR), perception='truth',
            controller=lambda _, steps=steps, turns=turns: (0.05 * (next(steps) == turns), 5),
        )
        run.save_bag(tmp_path / name, images=False)
    code, out, _ = taxinet('bag', 'compare', tmp_path / 'one', tmp_path / 'two')
    assert code == 1
    assert 'first at step 7 (0.35 s)' in out


def test_given_another_rate_when_forked_then_time_is_counted_in_its_steps():
    run = tx.run(scene(20, **NEAR), perception='truth')
    again = run.fork(0.35, perception='truth')
    assert again.fork_of.step == 7
    assert again.fork_of.at_s == pytest.approx(0.35)
    assert again.trace.equals(run.trace)
    with pytest.raises(UsageError, match=r'between control steps; take 0\.3 or 0\.35 s'):
        run.fork(0.33, perception='truth')
    with pytest.raises(UsageError, match='control_rate_hz cannot change during a run'):
        run.fork(0.35, settings={'control_rate_hz': 10})
    odd = tx.run(scene(30, **NEAR), perception='truth')
    for at_s, step in ((7 / 30, 7), (3.0, 90)):
        assert odd.fork(at_s, perception='truth').fork_of.step == step
    with pytest.raises(UsageError, match=r'between control steps; take 0\.3 or 0\.333333 s'):
        odd.fork(0.32, perception='truth')


def test_given_a_step_between_tenths_of_a_second_then_its_time_is_told_with_all_its_decimals():
    assert [time_words(seq * 0.1) for seq in (0, 3, 299)] == ['0.0 s', '0.3 s', '29.9 s']
    assert [time_words(seq / 40) for seq in (1, 5, 6)] == ['0.025 s', '0.125 s', '0.15 s']
    assert time_words(7 / 20, 6) == '  0.35 s'
    alarm = Alarm(step=7, reason='unfamiliar', score=1.2, period_ns=scene(20).period_ns)
    assert str(alarm) == 'unfamiliar at 0.35 s (1.20 times its threshold)'


def test_given_a_latency_then_a_command_takes_effect_that_much_later_at_every_rate():
    for rate_hz in CONTROL_RATES_HZ:
        run = tx.run(
            scene(rate_hz, duration_s=1.0, loop_delay_s=0.2),
            perception='truth', controller=lambda estimate: (0.1, 5.0),
        )
        yaw = run.trace.he_rad.to_numpy()
        moved = run.trace.t_s[np.abs(yaw) > 1e-4].min()
        from_s = math.ceil(0.2 * rate_hz) / rate_hz
        assert from_s < moved <= from_s + math.ceil(0.1 * rate_hz) / rate_hz + 1e-9, rate_hz


def test_given_a_substitute_then_its_delay_and_its_memory_are_in_seconds():
    def made(word: str, rate_hz: int, seed: tuple[int, int] = (1, 2)):
        return substituted(
            parse_substitution(word), GroundTruth(), seed, scene(rate_hz).period_ns)

    late = made('truth-delayed:0.5', 20)
    seen = [late.estimate(None, TrackingError(cte_m=float(k), he_rad=0.0)).cte_m for k in range(20)]
    assert seen == [0.0] * 10 + [float(k) for k in range(10)]
    long = made('truth-delayed:30', 30)
    seen = [long.estimate(None, TrackingError(cte_m=k / 2, he_rad=0.0)).cte_m for k in range(902)]
    assert seen[-2:] == [0.0, 0.5]
    truth = TrackingError(cte_m=0.0, he_rad=0.0)
    paths = np.array([
        [noisy.estimate(None, truth).cte_m for _ in range(21)]
        for noisy in (made('noisy:1', 20, (3, index)) for index in range(2000))
    ])
    # After 20 steps of 0.05 s, one second.
    assert np.corrcoef(paths[:, 0], paths[:, 20])[0, 1] == pytest.approx(math.exp(-1), abs=0.06)
    with pytest.raises(UsageError, match=r'delayed:0\.1: a delay has to be a multiple of 0\.2 s'):
        made('delayed:0.1', 5)


def test_given_the_usual_rate_then_nothing_of_it_is_recorded():
    assert 'control_rate_hz' not in Scenario().recorded_text
    given = scene(20, sensors='standard', gnss_noise_m=2.0, camera_dz_m=0.1)
    assert Scenario(**given.recorded()) == given
    usual = scenario_from_human({**given.to_human(), 'control_rate_hz': 10})
    assert (given.period_ns, usual.period_ns) == (50_000_000, 100_000_000)
    assert given.digest != usual.digest
    assert 'control_rate_hz' not in usual.recorded_text


@pytest.mark.parametrize(('values', 'words'), [
    ({'control_rate_hz': 25}, 'control_rate_hz is 25, not one of 5, 6, 8, 10, .* 60: a period has'),
    ({'control_rate_hz': 80}, r'control_rate_hz is 80, outside 5\.\.60 Hz'),
    ({'control_rate_hz': 'fast'}, 'control_rate_hz needs a number'),
    ({'control_rate_hz': 5, 'duration_s': 2.1}, r'2\.1 s is not a multiple of the control period'),
])
def test_given_a_rate_that_cannot_be_then_one_line_says_so(values, words):
    with pytest.raises(UsageError, match=words):
        last_step(scenario_from_human(values))


def test_given_a_duration_that_only_another_rate_divides_then_it_is_allowed_with_that_rate():
    check_overrides({'duration_s': '1.25', 'control_rate_hz': '8'})
    assert last_step(apply_overrides({}, {'duration_s': '1.25', 'control_rate_hz': '8'}, '')) == 10
    with pytest.raises(UsageError, match=r'1\.25 s is not a multiple of the control period 0\.1 s'):
        apply_overrides({}, {'duration_s': '1.25'}, 'program')


@given(st.sampled_from(CONTROL_RATES_HZ), st.integers(6, 3000))
def test_given_any_number_of_steps_then_their_time_in_seconds_is_a_duration(rate_hz, steps):
    asked = Scenario(control_rate_hz=rate_hz, duration_s=steps / rate_hz)
    assert last_step(asked) == steps
    assert asked.duration_ns == step_stamp_ns(steps, asked.period_ns)


def test_given_a_duration_of_thirds_of_a_second_then_run_and_bag_are_judged_to_its_end(tmp_path):
    values = {'duration_s': str(2 / 3), 'control_rate_hz': '30'}
    check_overrides(values)
    run = tx.run(apply_overrides({}, values, ''), specs='phi_always')
    assert len(run.steps) == 21
    verdict = tx.open_recording(run.save_bag(tmp_path / 'run', images=False)).judge('phi_always')
    assert verdict.interval == run.rho['phi_always']
    assert verdict.verdict == 'SATISFIED'


def test_given_a_program_with_a_rate_then_overrides_are_checked_against_it(tmp_path):
    program = tmp_path / 'fast.scenic'
    program.write_text(
        'model runway_world\nparam control_rate_hz = 20\nego = new Plane at (2, 800)\n')
    with SceneSource(program, seed=0, overrides={'duration_s': '2.05'}) as source:
        assert last_step(first_scene(source)) == 41
    with SceneSource(program, seed=0, overrides={'control_rate': '8'}) as source:
        assert last_step(first_scene(source)) == 240


def test_given_what_keeps_to_10_hz_then_another_rate_is_refused_by_name():
    other = scene(20, **NEAR)
    with pytest.raises(UsageError, match='control_rate_hz: not in a free run'):
        check_free(other)
    free = make_options(
        program='cruise', runs=2, seed=0, perception='truth', settings=(), free=True,
        controller='steering')
    with pytest.raises(UsageError, match='control_rate_hz: not in a free run'):
        free.check(scene(10, **NEAR), lambda: ['control_rate_hz'], [other])
    with pytest.raises(UsageError, match=r'others.*: control_rate_hz would have no effect'):
        _PluginWorld(OTHERS, lambda scenario, pictures=True: None, other)
    for monitor in ('original', 'sigma:1.5'):
        controller = make_controller(f'steering+{monitor}+stop', SteeringGains())
        with pytest.raises(UsageError, match='not with control_rate_hz=20, as it judges over'):
            tx.run(other, perception='original', controller=controller)
        options = make_options(
            program='cruise', runs=1, seed=0, perception='original', settings=(),
            controller=f'steering+{monitor}+stop',
        )
        with pytest.raises(UsageError, match=f'monitor {monitor}: not with control_rate_hz=20'):
            options.check(other, lambda: [])
