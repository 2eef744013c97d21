"""Failed runs of a campaign once more, in worker processes, with the truth for the network."""

from __future__ import annotations

import contextlib
import dataclasses
import sqlite3
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from campaign_records import write_campaign

from taxinet_ros.analysis.fault_localisation import (
    Blame,
    Suffices,
    judge_case,
    localisation,
    localisation_json,
    localisation_sentences,
)
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.perception.substituted import AS_RECORDED
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.system import System
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import InfraError, RecordError, UsageError
from taxinet_ros.files.record import RECORD_NAME, Record, read_record
from taxinet_ros.trials.loop_run import Loop
from taxinet_ros.trials.past_runs import trials as kept
from taxinet_ros.trials.past_runs.localisation import localize, make_localize_options
from taxinet_ros.trials.past_runs.recorded_campaign import (
    open_campaign,
    open_failed_campaign,
    scenario_of_row,
    spread_evenly,
)
from taxinet_ros.trials.past_runs.shared_scenes import Scene
from taxinet_ros.trials.past_runs.trials import (
    Trial,
    TrialRecord,
)
from taxinet_ros.trials.record.row import RunRow

SPEC = 'phi_eventually'
FORMULA = 'eventually[0:10](always(abs(cte) <= 1.5))'
JUDGING = Judging(specs=(f'{SPEC}={FORMULA}',))
WET = scenario_from_human({
    'cross_track': 5, 'heading': 20, 'distance': 600, 'clouds': 'stratus', 'rain': 90,
    'time_of_day': 8, 'duration': 12,
})
OFF = [
    scenario_from_human({'cross_track': 5, 'heading': heading, 'duration': 11})
    for heading in (10, 15, 20)
]
"""With a nose wheel that never turns they go on and on to the left."""
LOCKED = {'heading_gain': 0.0}


def row_of(scene: Scenario, index: int, perception: str) -> RunRow:
    """The row of a run that has no result yet."""
    return RunRow(
        run_id=f'run-{index}', index=index, program='s_falsif', seed=3, perception=perception,
        fingerprint=check_perception(perception), sampler='random', weight=1.0,
        **scene.to_human(), outcome=Outcome.INTERRUPTED,
    )


def failed_campaign(
    folder: Path, scenes: Sequence[Scenario], *, perception: str = 'truth',
    gains: Mapping[str, float] = LOCKED,
) -> list[RunRow]:
    """Run scenes as they are, and write the record of a campaign of them."""
    system, loop, rows = System(perception=perception, gains=gains), Loop(), []
    for index, scene in enumerate(scenes):
        row = row_of(scene, index, perception)
        task = Scene(row=row, scenario=scene, exact=True).task(system, JUDGING)
        trial = Trial.of(task, loop.run(task))
        rows.append(dataclasses.replace(
            row, outcome=Outcome.PASS if trial.passed else Outcome.FAIL,
            robustness={SPEC: trial.robustness}, stopped_early=False,
            left_runway=trial.left_runway, max_cross_track_m=trial.max_cross_track_m,
            settle_time_s=trial.settle_time_s,
        ))
    write_campaign(folder, rows, {
        'program': 's_falsif.scenic', 'seed': 3, 'runs': len(rows), 'perception': perception,
        'specs': {SPEC: FORMULA}, 'gains': dict(gains), 'stop_on': 'never',
    })
    return rows


@pytest.fixture(scope='module')
def off(tmp_path_factory) -> Path:
    """A campaign of three runs that fail whatever the perception."""
    folder = tmp_path_factory.mktemp('off') / 'c'
    failed_campaign(folder, OFF)
    return folder


def options(folder: Path, out: Path, **changes):
    given = {'runs': None, 'words': (), 'workers': 1, 'out': out, 'perception': None, **changes}
    return make_localize_options(folder, **given)


def ignore(done: int) -> None:
    pass


def never() -> bool:
    return False


def test_given_a_failure_of_the_network_then_it_comes_out_as_recorded_and_the_truth_passes(
    tmp_path,
):
    (row,) = failed_campaign(tmp_path / 'c', [WET], perception='original', gains={})
    assert row.outcome == 'FAIL'
    trials = localize(options(tmp_path / 'c', tmp_path / 'out'), ignore, never)
    assert sorted(word for _, word in trials) == [AS_RECORDED, 'truth', 'truth-cte',
                                                  'truth-heading']
    control = trials['run-0', AS_RECORDED]
    assert control.robustness == row.robustness[SPEC]
    assert control.max_cross_track_m == row.max_cross_track_m
    case = judge_case(row, {word: trial for (_, word), trial in trials.items()})
    assert (case.blame, case.counted) == (Blame.PERCEPTION, True)
    assert case.suffices is not Suffices.UNKNOWN


def test_given_a_nose_wheel_that_never_turns_then_the_truth_fails_too_and_the_law_is_to_blame(
    tmp_path,
):
    (row,) = failed_campaign(tmp_path / 'c', OFF[:1], perception='original')
    system, loop = System(perception='original', gains=LOCKED), Loop()
    scene = Scene(row=row, scenario=OFF[0], exact=True)
    tasks = [scene.task(system, JUDGING, word) for word in (AS_RECORDED, 'truth')]
    trials = {task.word: Trial.of(task, loop.run(task)) for task in tasks}
    assert judge_case(row, trials).blame is Blame.CONTROLLER


def test_given_an_interrupt_and_damage_then_the_same_command_does_what_is_left_and_more(
    off, tmp_path, capsys,
):
    out, counts = tmp_path / 'out', []
    asked = options(off, out, words=['truth', 'noisy:1'])
    assert asked.wanted == 9
    part = localize(asked, counts.append, lambda: len(counts) > 3)
    assert counts[0] == 0
    assert 3 <= len(part) < 9
    with contextlib.closing(sqlite3.connect(out / RECORD_NAME)) as file, file:
        file.execute('UPDATE entries SET value = replace(value, "false", "true") WHERE key = '
                     '(SELECT max(key) FROM entries WHERE kind = "trial")')
    rest: list[int] = []
    whole = localize(asked, rest.append, never)
    assert rest == list(range(len(part) - 1, 10)), 'each that is missing once'
    assert len(whole) == 9
    assert 'damaged (entry trial' in capsys.readouterr().err
    assert {key: whole[key] for key in part} == part
    more = localize(options(off, out, words=['truth'], runs=1), ignore, never)
    assert set(more) == {('run-1', AS_RECORDED), ('run-1', 'truth')}
    entries = read_record(out / RECORD_NAME)
    assert len(entries['trial']) == 9
    assert [sitting['python'] for sitting in entries['sitting'].values()], 'on which machine'


def test_given_the_number_of_workers_then_the_trials_are_the_same(off, tmp_path):
    found = [
        localize(
            options(off, tmp_path / f'out{workers}', workers=workers, runs=2,
                    words=['truth', 'noisy:2', 'truth-delayed:1']), ignore, never)
        for workers in (1, 2)
    ]
    assert len(found[0]) == 8
    assert found[0] == found[1]
    assert found[0]['run-0', 'noisy:2'] != found[0]['run-2', 'noisy:2']


def test_given_trials_of_another_campaign_or_something_else_then_they_are_not_mixed(
    off, tmp_path
):
    failed_campaign(tmp_path / 'other', OFF[:1], gains={'heading_gain': 0.01})
    out = tmp_path / 'out'
    localize(options(off, out), ignore, lambda: True)
    with pytest.raises(UsageError, match='contains trials of another campaign or network'):
        localize(options(tmp_path / 'other', out), ignore, never)
    (tmp_path / 'old').mkdir()
    (tmp_path / 'old' / 'trials.jsonl').touch()
    with pytest.raises(UsageError, match=r'contains something else \(trials.jsonl\)'):
        localize(options(off, tmp_path / 'old'), ignore, never)
    with Record(out / RECORD_NAME), pytest.raises(UsageError, match='another command is writing'):
        localize(options(off, out), ignore, never)


def test_given_a_run_that_cannot_be_judged_then_it_is_kept_and_repeated_by_the_next_sitting(
    tmp_path
):
    settings = {'of': 'a test'}
    broken = Trial(run_id='a', word='truth', passed=None, detail='no image')
    with TrialRecord(tmp_path, settings, 'other') as record:
        record.keep('a', broken)
        record.keep('b', dataclasses.replace(broken, passed=True))
        assert set(record.done) == {'a', 'b'}
    with TrialRecord(tmp_path, settings, 'other') as record:
        assert set(record.done) == {'b'}
    assert set(read_record(tmp_path / RECORD_NAME)['trial']) == {'a', 'b'}


def test_given_settings_that_were_lost_then_a_copy_counts_and_without_it_no_trial_does(tmp_path):
    settings = {'of': 'a test'}
    with TrialRecord(tmp_path, settings, 'other') as record:
        record.keep('a', Trial(run_id='a', word='truth', passed=True))
    for lost, left in (('settings',), {'a'}), (('settings', 'settings_spare'), set()):
        with Record(tmp_path / RECORD_NAME) as damaged:
            for kind in lost:
                damaged.remove(kind)
        with TrialRecord(tmp_path, settings, 'other') as record:
            assert set(record.done) == left
    with pytest.raises(UsageError, match='other; choose another folder'):
        TrialRecord(tmp_path, {'of': 'another'}, 'other')


def test_given_a_folder_that_is_moved_after_the_last_trial_then_it_is_named(tmp_path):
    out = tmp_path / 'out'
    record = TrialRecord(out, {}, 'other')
    record.keep('a', Trial(run_id='a', word='truth', passed=True))
    out.rename(tmp_path / 'elsewhere')
    with pytest.raises(RecordError, match='was moved, deleted or replaced'):
        record.__exit__(None)


EYES = """
import os, pathlib, time

class Eyes:
    def __init__(self):
        self.frames = 0

    def __call__(self, frame):
        self.frames += 1
        how = pathlib.Path(__file__).with_name('how')
        if self.frames == 125 and how.exists():
            os._exit(7) if how.read_text() == 'dies' else time.sleep(60)
        return 0.0, 0.0
"""


@pytest.mark.nightly
@pytest.mark.parametrize(('how', 'why'), [
    ('dies', 'worker: exit code 7'), ('hangs', 'worker: silent for 20 s'),
])
def test_given_a_perception_that_ends_its_process_in_a_scene_then_its_trials_alone_are_lost(
    how, why, tmp_path, monkeypatch,
):
    monkeypatch.setattr(kept, 'SILENCE_S', 20.0)
    (tmp_path / 'eyes.py').write_text(EYES)
    # Only the second scene has as many frames.
    scenes = [OFF[0], dataclasses.replace(OFF[1], duration_s=13.0), OFF[2]]
    rows = failed_campaign(tmp_path / 'c', scenes, perception=f'{tmp_path}/eyes.py:Eyes')
    asked = options(tmp_path / 'c', tmp_path / 'out', words=['truth', 'truth-cte'], workers=2)
    (tmp_path / 'how').write_text(how)
    done = localize(asked, ignore, never)
    lost = {('run-1', AS_RECORDED), ('run-1', 'truth-cte')}
    assert len(done) == 9
    assert {name for name, trial in done.items() if not trial.judged} == lost
    assert {done[name].detail for name in lost} == {why}
    found = localisation(
        asked.campaign, rows, done, words=asked.words, perception=asked.perception,
        examined=asked.examined)
    assert [case.blame for case in found.cases] == [
        Blame.CONTROLLER, Blame.UNKNOWN, Blame.CONTROLLER]
    told = ' '.join(localisation_sentences(found))
    assert f'2 reruns could not be judged (run-1 as-recorded: {why}; ' in told
    # What is done is kept, and what was lost is made once it can be.
    (tmp_path / 'how').unlink()
    counts: list[int] = []
    whole = localize(asked, counts.append, never)
    assert counts == [7, 8, 9]
    assert {name: whole[name] for name in done if name not in lost} == {
        name: done[name] for name in done if name not in lost}
    assert all(trial.judged for trial in whole.values())


def test_given_workers_that_end_one_after_the_other_then_the_command_does_too(
    off, tmp_path, monkeypatch
):
    monkeypatch.setattr(kept, '_PATIENCE', 2)
    (tmp_path / 'eyes.py').write_text('import os\ndef eyes(frame):\n    os._exit(7)\n')
    asked = dataclasses.replace(
        options(off, tmp_path / 'out', words=['truth-cte']),
        perception=f'{tmp_path}/eyes.py:eyes')
    with pytest.raises(InfraError, match=r'2 workers in a row.* exit code 7'):
        localize(asked, ignore, never)
    assert len(read_record(tmp_path / 'out' / RECORD_NAME)['trial']) == 2


@pytest.mark.parametrize(('campaign', 'changes', 'words'), [
    ('', {}, 'not a campaign: no campaign.db'),
    ('c', {'runs': 0}, 'runs 0: needs to be 1 or more'),
    ('c', {'workers': 0}, 'workers 0: needs to be within 1..64'),
    ('c', {'words': ['turth']}, 'substitution turth: unknown'),
    ('c', {'perception': 'original'}, 'and was without weights in the runs; name the file'),
])
def test_given_bad_input_then_one_line_says_what_is_wrong(off, tmp_path, campaign, changes, words):
    with pytest.raises(UsageError, match=words) as error:
        options(off.parent / campaign, tmp_path / 'out', **changes)
    assert '\n' not in str(error.value)


def test_given_a_violated_requirement_that_is_not_the_first_then_that_one_is_looked_into(tmp_path):
    specs = {'low': 'always(cte <= 99)', 'far': 'always(abs(cte) >= 6)', SPEC: FORMULA}
    judging = Judging(specs=tuple(f'{name}={text}' for name, text in specs.items()))
    system, loop, rows = System(perception='truth', gains=LOCKED), Loop(), []
    for index, scene in enumerate(OFF[:2]):
        row = row_of(scene, index, 'truth')
        task = Scene(row=row, scenario=scene, exact=True).task(system, judging)
        result = loop.run(task)
        assert Trial.from_json(Trial.of(task, result).to_json()) == Trial.of(task, result)
        rows.append(dataclasses.replace(
            row, outcome=result.outcome, robustness=result.robustness, stopped_early=False))
    write_campaign(tmp_path / 'c', rows, {
        'program': 's_falsif.scenic', 'seed': 3, 'runs': 2, 'perception': 'truth',
        'specs': specs, 'gains': LOCKED, 'stop_on': 'never',
    })
    assert [[name for name, rho in row.robustness.items() if rho.failed] for row in rows] == [
        ['far', SPEC]] * 2
    asked = options(tmp_path / 'c', tmp_path / 'out', words=['truth'])
    done = localize(asked, ignore, never)
    assert {trial.robustness for trial in done.values()} == {
        row.robustness['far'] for row in rows}
    found = localisation(
        asked.campaign, asked.rows, done, words=asked.words, perception='truth',
        examined=asked.examined)
    assert [case.blame for case in found.cases] == [Blame.CONTROLLER] * 2
    first, *_ = told = localisation_sentences(found)
    assert first == 'No run violates low; looked into: far, violated by 2 of 2 runs.'
    assert (f'Runs also violate {SPEC} (2 of 2); look into that by: taxinet localize '
            f'{tmp_path / "c"} --spec {SPEC}.') in told
    assert localisation_json(found)['spec'] == 'far'
    # Another requirement is told from the same trials.
    other = options(tmp_path / 'c', tmp_path / 'out', words=['truth'], spec=SPEC)
    counts: list[int] = []
    again = localize(other, counts.append, never)
    assert counts == [4]
    assert {trial.robustness for trial in again.values()} == {row.robustness[SPEC] for row in rows}
    with pytest.raises(UsageError, match='none of its 2 judged runs violates low'):
        options(tmp_path / 'c', tmp_path / 'out', spec='low')


def test_given_runs_that_passed_then_there_is_nothing_to_localise(tmp_path):
    failed_campaign(tmp_path / 'good', OFF[:1], gains={})
    with pytest.raises(UsageError, match='none of its 1 judged runs failed'):
        options(tmp_path / 'good', tmp_path / 'out')


def test_given_runs_of_another_control_rate_then_a_delay_is_a_number_of_their_steps(tmp_path):
    quick = scenario_from_human({**OFF[0].to_human(), 'control_rate_hz': 20})
    failed_campaign(tmp_path / 'c', [quick])
    found = options(tmp_path / 'c', words=('delayed:0.05',), out=tmp_path / 'found')
    assert {word for _, word in localize(found, ignore, never)} == {AS_RECORDED, 'delayed:0.05'}
    with pytest.raises(UsageError, match=r'delayed:0\.02: a delay has to be a multiple of 0\.05 s'):
        options(tmp_path / 'c', tmp_path / 'none', words=('delayed:0.02',))
    slow = scenario_from_human({**OFF[0].to_human(), 'control_rate_hz': 5})
    failed_campaign(tmp_path / 'mixed', [quick, slow])
    with pytest.raises(UsageError, match=r'delayed:0\.1: a delay has to be a multiple of 0\.2 s'):
        options(tmp_path / 'mixed', tmp_path / 'none', words=('delayed:0.1',))


def test_given_a_number_of_runs_then_they_are_spread_over_all():
    many = tuple(range(1996))
    chosen = spread_evenly(many, 200)
    assert len(set(chosen)) == 200
    steps = {b - a for a, b in pairwise(chosen)}
    assert steps <= {9, 10}
    assert chosen[0] < 10 > 1995 - chosen[-1]
    assert spread_evenly(many, None) == spread_evenly(many, 5000) == many


def test_given_a_recorded_campaign_then_rows_rates_and_counterexamples_are_read_from_its_record(
    off,
):
    before = {path: path.stat().st_mtime_ns for path in off.parent.rglob('*')}
    found = open_campaign(off)
    assert len(found.rows) == 3
    assert found.rows == found.judged == found.counterexamples
    assert open_failed_campaign(off).counterexamples == found.rows
    table = found.table()
    assert list(table['run_id']) == [row.run_id for row in found.rows]
    assert (table['outcome'] == 'FAIL').all()
    rate = found.failure_rate.rate
    assert rate is not None
    assert (rate.rate, rate.high) == (1.0, 1.0)
    assert found.judging == JUDGING
    row = found.rows[0]
    assert found.bag(row) is None
    assert found.scenario(row) == scenario_of_row(row, off, {}) == (OFF[0], False)
    assert {path: path.stat().st_mtime_ns for path in off.parent.rglob('*')} == before
