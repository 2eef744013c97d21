"""How a monitor is judged: known answers of counts, times, rates and bounds, and a small study."""

import contextlib
import json
import math
import sqlite3
from types import SimpleNamespace

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.core.assurance.monitor import conformal_threshold
from taxinet_ros.core.assurance.switch import make_controller
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.assurance.calibrate import (
    calibrate,
    check_share,
    fit_kinematics,
)
from taxinet_ros.extras.assurance.commands import TEXT, run_judge
from taxinet_ros.extras.assurance.judge import (
    FACTORS,
    REACH_S,
    WANTED_RATIO,
    WITHOUT,
    Judged,
    JudgeOptions,
    Trial,
    due_s,
    judge,
    off_ratio,
    per_hour,
    plain,
    reached,
    summarize,
    trade_of,
)
from taxinet_ros.files.record import RECORD_NAME, read_record
from taxinet_ros.recordings.score import ScoreOptions, score
from taxinet_ros.recordings.truth import TruthSource


def no_progress(stage, done, total):
    pass


@pytest.mark.parametrize(('outside', 'due', 'within'), [
    ([(0, 4)], math.nan, True),          # on the line in time, and stays
    ([(0, 4), (6, 9)], math.nan, True),  # away again, but back before 10 s
    ([(0, 31)], 10.0, False), ([(0, 12)], 10.0, False),  # not on the line in time
    ([(0, 4), (10, 31)], 10.0, True),    # leaves it just when it has to be there
    ([(12, 31)], 12.0, True), ([(0, 4), (8, 11)], 8.0, True), ([(12, 13), (20, 21)], 12.0, True),
])
def test_given_a_run_then_an_alarm_is_due_when_it_leaves_the_line_for_its_violation(
    outside, due, within
):
    times = [k / 10 for k in range(301)]
    cte = [2.0 if any(a <= t < b for a, b in outside) else -1.0 for t in times]
    assert due_s(times, cte) == pytest.approx(due, nan_ok=True)
    assert reached(times, cte) is within


def test_given_counts_then_rates_per_hour_have_the_exact_poisson_interval():
    none = per_hour(0, 2.0)
    assert (none.value, none.low) == (0, 0)
    assert none.high == pytest.approx(3.6889 / 2, abs=1e-4)
    ten = per_hour(10, 1.0)
    assert (ten.low, ten.high) == pytest.approx((4.7954, 18.3904), abs=1e-4)
    assert math.isnan(per_hour(0, 0.0).value)


def test_given_counts_then_the_ratio_has_an_interval_that_covers_at_its_rate():
    assert off_ratio(90, 9, 300).value == pytest.approx(10)
    never = off_ratio(90, 0, 300)
    assert math.isinf(never.value)
    assert math.isinf(never.high)
    assert never.low == pytest.approx(0.2412 / 0.0145, rel=0.02)
    rng = np.random.default_rng(5)
    covered = [
        (found := off_ratio(*rng.binomial(200, (0.3, 0.03)), 200)).low <= 10 <= found.high
        for _ in range(400)
    ]
    assert np.mean(covered) >= 0.95


def trial(scene, fallback=WITHOUT, **values):
    return Trial(**{
        'scene': scene, 'fallback': fallback, 'satisfied': True, 'rho_m': 1.0,
        'left_runway': False, 'duration_s': 30.0, 'due_s': math.nan, 'reached': True,
        'off_s': math.nan, 'alarm_s': math.nan, 'reason': '', **values,
    })


def summarized(trials):
    return summarize(trials, {one.scene: np.full(len(FACTORS), math.nan) for one in trials})


def text(judged: Judged) -> str:
    return macro_text(TEXT, 'judged', j=judged, reach_s=REACH_S, wanted=WANTED_RATIO)


def test_given_trials_then_alarms_are_counted_as_in_time_late_missed_and_false():
    bad = {'satisfied': False, 'rho_m': -9.0, 'due_s': 12.0}
    off = {**bad, 'left_runway': True, 'off_s': 20.0}
    plain = [
        trial(0), trial(1, alarm_s=6.0, reason='unseen'),
        trial(2, **bad, alarm_s=2.0, reason='unseen'), trial(3, **bad, alarm_s=15.0, reason='odd'),
        trial(4, **bad), trial(5, **off, alarm_s=15.0, reason='odd'), trial(6, **off),
    ]
    stopped = [
        trial(one.scene, 'stop', satisfied=one.scene in (0, 2), left_runway=one.scene == 6)
        for one in plain
    ]
    found = summarized([*plain, *stopped])
    assert (found.runs, found.failed) == (7, 5)
    assert (found.in_time, found.late, found.missed, found.false_alarms) == (1, 2, 2, 1)
    assert (found.settled_alarms, found.false_per_h.value) == (0, 0)
    assert found.off_missed == 1
    assert found.off_lead_s == (-math.inf,) * 3
    assert found.lead_s[1] == -3.0
    assert found.reasons == {'odd': 2, 'unseen': 2}
    guarded = found.with_fallback['stop']
    assert (guarded.fixed, guarded.broken) == (1, 1)
    assert guarded.off_ratio.value == 2
    assert '5 failed runs: 1 with an alarm in time, 2 with one too late, 2 with none' in text(found)
    assert 'stop: 1 run leaves the runway, 2 without it; that these are fewer' in text(found)


def test_false_alarms_are_told_by_start_and_by_hour_after_the_aircraft_had_time_to_settle():
    alarms = [0.4, 3.0, 10.0, 22.0, *[math.nan] * 6]
    found = summarized([trial(scene, alarm_s=time_s) for scene, time_s in enumerate(alarms)])
    assert (found.false_alarms, found.settled_alarms) == (4, 1)
    assert found.false_share.rate == pytest.approx(0.4)
    assert found.false_per_h.value == pytest.approx(1 / ((12 + 6 * 20) / 3600))
    # As many alarms and twice as long a drive: as many a start, and half as many an hour.
    longer = summarized([
        trial(scene, alarm_s=time_s, duration_s=42.0) for scene, time_s in enumerate(alarms)
    ])
    assert longer.false_share == found.false_share
    assert longer.false_per_h.value == pytest.approx(1 / ((12 + 6 * 32) / 3600))
    alarms = '4 with a false alarm, 40.0 % (12.2–73.8 %); 1 of these after the first 10 s'
    assert alarms in text(found)


def test_a_run_that_was_never_within_the_line_has_no_lead_before_leaving_it():
    bad = {'satisfied': False, 'rho_m': -9.0}
    found = summarized([
        *(trial(k, **bad, due_s=10.0, reached=False, alarm_s=0.4) for k in range(4)),
        trial(4, **bad, due_s=12.0, alarm_s=9.0), trial(5, **bad, due_s=20.0, alarm_s=19.0),
        trial(6, **bad, due_s=20.0), trial(7, **bad, due_s=10.0, reached=False),
    ])
    assert found.lead_s == pytest.approx((-math.inf, 1.0, 2.6))
    assert (found.unreached, found.in_time, found.missed) == (5, 6, 2)
    assert found.unreached_alarm_s == pytest.approx((0.4, 0.4, math.inf))
    left, late = text(found).splitlines()[2:4]
    assert '2 with an alarm before that, 0 after, 1 without' in left
    assert left.endswith('leaving it 1.0 s (median; middle 80 %: no alarm to 2.6 s)')
    assert late.endswith('to the alarm 0.4 s (median; middle 80 %: 0.4 s to no alarm)')
    assert plain(found)['lead_s'] == [None, pytest.approx(1.0), pytest.approx(2.6)]


def test_a_failed_run_without_an_alarm_counts_in_the_lead_times_as_later_than_any():
    """The least of 21 leads is no alarm, then 0 to 19 s: each tenth of 20 steps is a value."""
    off = {'satisfied': False, 'rho_m': -9.0, 'due_s': 22.0, 'left_runway': True, 'off_s': 25.0}
    alarms = [math.nan, *(22.0 - lead for lead in range(20))]
    found = summarized([trial(k, **off, alarm_s=time_s) for k, time_s in enumerate(alarms)])
    assert found.left == (20, 0, 1)
    assert found.lead_s == (1.0, 9.0, 17.0)
    assert found.off_missed == 1
    assert found.off_lead_s == (4.0, 12.0, 20.0)
    never = summarized([trial(k, **off) for k in range(3)])
    assert never.left == (0, 0, 3)
    assert never.lead_s == never.off_lead_s == (-math.inf,) * 3
    assert 'runway no alarm (median; middle 80 %: no alarm to no alarm)' in text(never)
    assert plain(never)['off_lead_s'] == [None] * 3
    assert math.isnan(summarized([trial(0)]).lead_s[0])


@pytest.mark.parametrize(('runs', 'rate'), [(83, 0.05), (41, 0.1), (200, 0.1)])
def test_one_calibration_raises_more_alarms_than_the_rate_as_often_as_is_told(runs, rate):
    """The rate is an average over calibrations; what each check does has a known distribution."""
    rng, each = np.random.default_rng(runs), rate / 4
    shares = 1 - np.array([
        conformal_threshold(rng.random(runs).tolist(), each) for _ in range(2000)
    ])
    made = SimpleNamespace(runs=runs, rate=rate)
    assert shares.mean() <= each * 1.06
    assert np.mean(shares > each) > 0.3
    assert np.mean(shares <= check_share(made)) == pytest.approx(0.95, abs=0.015)
    assert check_share(SimpleNamespace(runs=83, rate=0.05)) == pytest.approx(0.0354, abs=1e-4)


def test_given_first_alarms_by_threshold_then_false_ones_and_departures_are_counted():
    off = {'satisfied': False, 'left_runway': True, 'off_s': 10.0}
    plain = [trial(0), trial(1), trial(2, **off), trial(3, **off)]
    times = np.full((4, len(FACTORS)), math.nan)
    times[1, :2] = 15.0                      # a false alarm at the two lowest thresholds
    times[2, :3] = 8.0                       # in time to brake, at three
    times[3, :3] = 9.0                       # too late
    found = trade_of(plain, list(times))
    assert [one.factor for one in found] == list(FACTORS)
    assert 1.0 in FACTORS
    assert [one.false_alarms for one in found[:4]] == [1, 1, 0, 0]
    assert found[0].false_per_h.value == pytest.approx(3600 / 25)
    assert [one.off_seen for one in found[:4]] == [1, 1, 1, 0]
    assert {one.off for one in found} == {2}


def test_given_deviations_by_the_model_then_the_turn_per_metre_is_found():
    rng = np.random.default_rng(2)
    steered = rng.normal(0, 0.2, 4000)
    noise = rng.normal(0, (0.1, 0.01), (4000, 2))
    found = fit_kinematics(np.column_stack([noise[:, 0], 0.21 * steered + noise[:, 1], steered]))
    assert found.turn_per_m == pytest.approx(0.21, abs=0.002)
    assert found.cte_spread_m == pytest.approx(0.1, rel=0.06)
    assert found.he_spread_rad == pytest.approx(0.01, rel=0.06)


SCENE = """
model runway_world
param duration_s = 2
param time_of_day_h = Range(9, 11)
ego = new Plane at (Range(-0.5, 0.5), Range(1700, 2000))
"""


@pytest.fixture
def judging(tmp_path):
    """Two short scenes, and a monitor that never raises an alarm."""
    (tmp_path / 'near.scenic').write_text(SCENE)
    (tmp_path / 'mon.py').write_text('def low(seen):\n    return seen.image.mean() * 1e-9\n')
    return {
        'perception': 'taxinet', 'program': str(tmp_path / 'near.scenic'), 'seed': 1, 'workers': 1,
        'controller': 'steering', 'monitor': f'{tmp_path}/mon.py:low',
        'fallbacks': ('stop', 'slow'), 'runs': 2,
    }


@pytest.mark.nightly
def test_given_a_calibration_then_its_monitor_is_judged(tmp_path, judging, capsys):
    few = {name: judging[name] for name in ('perception', 'program', 'seed', 'workers')}
    made = calibrate(no_progress, **few, runs=4, rate=0.9, out=tmp_path / 'b.npz')
    assert made.runs == 4
    options = JudgeOptions(
        **{**judging, 'monitor': str(tmp_path / 'b.npz')}, out=tmp_path / 'out')
    assert run_judge(options, as_json=False) == 0
    assert '2 scenes; first alarm raised by:' in capsys.readouterr().out


@pytest.mark.nightly
def test_given_a_study_then_it_tells_and_keeps_what_it_found_and_goes_on_after_an_end_amid(
    tmp_path, judging, capsys
):
    assert run_judge(JudgeOptions(**judging, out=tmp_path / 'out'), as_json=False) == 0
    told = capsys.readouterr().out
    assert '2 scenes; first alarm raised by: none' in told
    assert 'no run leaves the runway, with it or without' in told
    kept = json.loads((tmp_path / 'out' / 'assurance.json').read_text())
    assert kept['judged']['runs'] == 2
    assert len((tmp_path / 'out' / 'trials.csv').read_text().splitlines()) == 7
    assert len((tmp_path / 'out' / 'alarms.csv').read_text().splitlines()) == 3
    assert (tmp_path / 'out' / 'trade.png').stat().st_size > 5000
    assert [one['factor'] for one in kept['judged']['trade']] == list(FACTORS)
    # What is done is kept and not driven again; what is damaged is.
    out, record = tmp_path / 'out', tmp_path / 'out' / RECORD_NAME
    whole = {path.name: path.read_bytes() for path in out.iterdir()}
    entries = read_record(record)
    assert len(entries['trial']) == 2
    done = []
    assert judge(JudgeOptions(**judging, out=out), lambda *told: done.append(told)).runs == 2
    assert (done, record.read_bytes()) == ([], whole[RECORD_NAME])
    with contextlib.closing(sqlite3.connect(record)) as file, file:
        file.execute('UPDATE entries SET value = "{}" WHERE key = ?', [max(entries['trial'])])
    assert judge(JudgeOptions(**judging, out=out), lambda *told: done.append(told)).runs == 2
    assert done == [('scenes', 2, 2)]
    assert read_record(record) == entries
    for name in ('trials.csv', 'alarms.csv'):
        assert (out / name).read_bytes() == whole[name]
    with pytest.raises(UsageError, match='has runs of another perception, controller, monitor'):
        judge(JudgeOptions(**{**judging, 'fallbacks': ('stop',)}, out=out), no_progress)
    record.unlink()
    with pytest.raises(UsageError, match='contains something else'):
        JudgeOptions(**judging, out=out)


def test_given_settings_then_they_replace_what_the_program_draws(taxinet, tmp_path, judging):
    words = (
        'assure', 'judge', judging['program'], '--perception', 'taxinet', '--monitor',
        judging['monitor'], '--runs', '1', '--workers', '1', '--out', 'out', '--set',
    )
    code, _, err = taxinet(*words, 'steering.heading_gain=1')
    assert (code, err.count('\n')) == (2, 1)
    assert '--set steering.heading_gain: cannot be set together with --monitor' in err
    code, _, err = taxinet(*words, 'duration=12')
    assert code == 0, err
    table = (tmp_path / 'out/trials.csv').read_text().splitlines()
    names, first, *_ = (line.split(',') for line in table)
    assert dict(zip(names, first, strict=True))['duration_s'] == '12.0'
    # The safety argument names the scenes by this.
    kept = json.loads((tmp_path / 'out/assurance.json').read_text())['options']
    assert kept['program'] == f'{judging["program"]} with duration_s=12'


@pytest.mark.nightly
def test_given_a_monitor_that_ends_its_process_then_that_scene_is_left_out_by_name(
    tmp_path, judging, capsys
):
    (tmp_path / 'mon.py').write_text(
        'import os, pathlib\n'
        'def low(seen):\n'
        "    once = pathlib.Path(__file__).with_name('once')\n"
        '    if not once.exists():\n'
        '        once.touch()\n'
        '        os._exit(7)\n'
        '    return seen.image.mean() * 1e-9\n'
    )
    options, why = JudgeOptions(**judging, out=tmp_path / 'out'), 'scene 0, without: worker: exit'
    assert run_judge(options, as_json=False) == 3
    assert f'left out, not judged: {why} code 7' in capsys.readouterr().out
    kept = json.loads((tmp_path / 'out' / 'assurance.json').read_text())['judged']
    assert (kept['runs'], kept['unjudged']) == (1, [f'{why} code 7'])
    assert len((tmp_path / 'out' / 'trials.csv').read_text().splitlines()) == 4
    assert run_judge(options, as_json=False) == 0, 'what was lost is made'


def test_given_a_recorded_run_then_its_monitor_says_the_same_again(tmp_path, capsys):
    (tmp_path / 'mon.py').write_text(
        'def far(seen):\n'
        '    seen_m = abs(seen.estimate.cte_m) + abs(seen.command.steering_rad)\n'
        '    return seen_m / 0.9 + seen.image.mean() * 1e-9\n'
    )
    controller = make_controller(f'steering+{tmp_path}/mon.py:far+slow', SteeringGains())
    run = tx.run(
        tx.Scenario(cross_track_m=0.4, heading_rad=0.3, duration_s=2.0),
        perception='taxinet', controller=controller,
    )
    assert controller.alarm is not None
    assert controller.alarm.step > 3
    bag = run.save_bag(tmp_path / 'bag')
    found = score(ScoreOptions(
        bags=(bag,), source=TruthSource(topic=''), perception='taxinet',
        monitor=f'{tmp_path}/mon.py:far'))
    assert found.alarms is not None
    assert found.alarms['first_s'] == controller.alarm.at_s
    assert set(found.alarms['reasons']) == {controller.alarm.reason}
    assert found.alarms['frames'] == 21
    assert not found.alarms['derived']


@pytest.mark.parametrize(('changed', 'said'), [
    ({'rate': 0.0}, '^rate 0: '), ({'out': 'x.json'}, 'has to end in .npz'),
    ({'out': 'nowhere/x.npz'}, 'is not a folder'),
])
def test_given_bad_options_then_they_are_named(changed, said, tmp_path):
    given = {
        'perception': 'taxinet', 'program': 'nominal', 'runs': 9, 'rate': 0.1, 'seed': 1,
        'workers': 1, 'out': 'x.npz', **changed,
    }
    with pytest.raises(UsageError, match=said):
        calibrate(no_progress, **{**given, 'out': tmp_path / given['out']})
