"""Stages are run once, kept while they fit, continued after an interrupt, never thrown away."""

from __future__ import annotations

import dataclasses
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from studies import asked, run_study, sittings_of, smoke_config, stand_in

from taxinet_ros.cli.study.case_study import case_study
from taxinet_ros.errors import InfraError, RecordError, UsageError
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.study.stages.plan import stages
from taxinet_ros.study.stages.run import (
    StageRecord,
    State,
    StudyRun,
    open_study,
    read_stages,
    state_of,
)
from taxinet_ros.study.stages.stage import Stage
from taxinet_ros.training.data import unfinished
from taxinet_ros.trials.doctor import examine

RUN = """
import sys
from pathlib import Path
from studies import run_study
lines = []
try:
    code, _ = run_study(Path(sys.argv[1]), lines=lines)
finally:
    print('\\n'.join(lines))
sys.exit(code)
"""


@pytest.fixture(scope='module')
def first_sitting(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A study that was run to its end, and what it printed."""
    out = tmp_path_factory.mktemp('study') / 'whole'
    code, lines = run_study(out)
    assert (code, len(asked(out))) == (0, 30), lines
    return out, lines


@pytest.fixture(scope='module')
def finished(first_sitting: tuple[Path, list[str]]) -> Path:
    return first_sitting[0]


def copied(finished: Path, tmp_path: Path, *without: str) -> Path:
    """A copy of the finished study, without the folders of some stages."""
    out = tmp_path / 'study'
    shutil.copytree(finished, out)
    for name in without:
        shutil.rmtree(out / name)
    return out


def test_given_a_study_then_headings_number_its_stages_and_none_is_done_twice(first_sitting):
    out, lines = first_sitting
    headings = [line for line in lines if line.startswith('[')]
    assert len(headings) == 30
    assert headings[1].startswith('[2/30] falsify-original: taxinet falsify s_falsif --sampler ')
    assert ' --runs 20 --workers 2' in headings[1]
    assert sum(line.endswith(' elapsed') for line in lines) == 30
    code, lines = run_study(out)
    assert (code, asked(out), len(lines)) == (0, [], 30)
    assert all('done, kept' in line for line in lines)


def test_given_another_training_when_resumed_then_what_rests_on_it_is_done_anew(
    finished, tmp_path
):
    out = copied(finished, tmp_path)
    code, _ = run_study(out, dataclasses.replace(smoke_config(), specialised='training_full'))
    assert code == 0
    done = asked(out)
    assert [line.split()[0] for line in done] == ['train', 'falsify', 'case-study']
    assert done[0].startswith('train training_full')
    assert '--out evaluate-specialised' in done[1]


def test_given_weights_that_were_lost_when_trained_to_the_same_again_then_the_rest_is_kept(
    finished, tmp_path
):
    out = copied(finished, tmp_path)
    (out / 'train-halton' / 'halton.safetensors').write_text('others')
    code, lines = run_study(out)
    assert code == 0
    (done,) = asked(out)
    assert '--out train-halton/halton.safetensors' in done
    assert any('kept as train-halton.before-1' in line for line in lines)
    assert (out / 'train-halton.before-1' / 'halton.safetensors').read_text() == 'others'


def test_given_another_number_of_workers_when_resumed_then_everything_is_kept(finished):
    code, _ = run_study(finished, dataclasses.replace(smoke_config(), workers=7))
    assert (code, asked(finished)) == (0, [])


def test_given_another_seed_when_resumed_then_the_campaigns_of_before_stay(finished, tmp_path):
    out = copied(finished, tmp_path)
    code, _ = run_study(out, dataclasses.replace(smoke_config(), seed=5))
    words = [line.split()[0] for line in asked(out)]
    assert code == 0
    assert words.count('falsify') == 8
    assert 'train' not in words
    assert (out / 'falsify-original.before-1' / 'runs.parquet').is_file()


def test_given_more_runs_when_resumed_then_campaigns_go_on_and_their_analysis_is_renewed(
    finished, tmp_path
):
    out = copied(finished, tmp_path)
    code, _ = run_study(out, dataclasses.replace(smoke_config(), runs=30))
    done = asked(out)
    assert code == 0
    evaluations = [line for line in done if line.startswith('falsify s_falsif ')]
    assert len(evaluations) == 8
    assert all(line.endswith('--runs 30 --workers 2 --resume') for line in evaluations)
    assert sum(line.startswith('analyze') for line in done) == 1
    assert not list(out.glob('evaluate-*.before-*'))
    assert sittings_of(out, 'evaluate-halton') == 2


def test_given_fewer_runs_when_resumed_then_it_is_refused_and_nothing_is_touched(finished):
    with pytest.raises(UsageError, match='was begun with 20 runs, more than the 10 asked for'):
        run_study(finished, dataclasses.replace(smoke_config(), runs=10))
    assert asked(finished) == []


def test_given_a_stage_that_is_refused_then_the_study_stops_and_goes_on_later(finished, tmp_path):
    out = copied(finished, tmp_path, 'analyze-original', 'localize-original')
    (out / 'fail.txt').write_text('analyze-original')
    lines: list[str] = []
    with pytest.raises(UsageError, match=r'^analyze-original: out of luck$'):
        run_study(out, lines=lines)
    assert len(asked(out)) == 1
    assert lines[-1] == 'stopped at analyze-original; once it is fixed, resuming goes on'
    (out / 'fail.txt').unlink()
    assert run_study(out)[0] == 0
    assert [line.split()[0] for line in asked(out)] == ['analyze', 'localize']


@pytest.mark.parametrize(('code', 'ends_with', 'why'), [
    (0, 4, 'train-original/original.safetensors is missing'), (3, 3, 'exit code 3'),
])
def test_given_a_stage_that_leaves_nothing_behind_then_the_study_stops(
    tmp_path, code, ends_with, why
):
    ended, lines = run_study(tmp_path / 'study', work=lambda stage, resume: code)
    assert (ended, read_stages(tmp_path / 'study')['train-original'].key) == (ends_with, '')
    assert lines[-1] == f'stopped at train-original: {why}; once it is fixed, resuming goes on'


def test_given_an_original_without_failures_then_nobody_is_asked_whose_fault_they_are(
    finished, tmp_path
):
    out = copied(finished, tmp_path, 'falsify-original', 'localize-original')
    (out / 'flawless.txt').write_text('falsify-original')
    code, lines = run_study(out)
    assert code == 0
    assert 'none of the 20 runs of falsify-original failed: nothing to do' in lines
    assert not [line for line in asked(out) if line.startswith('localize')]
    assert run_study(out)[0] == 0
    assert asked(out) == []


def test_t14_study_given_a_search_that_learned_nothing_then_nothing_is_trained_on_it(
    finished, tmp_path
):
    out = copied(finished, tmp_path, 'learn-ce-verifai-2', 'train-iterative-learned',
                 'evaluate-iterative-learned')
    (out / 'flawless.txt').write_text('learn-ce-verifai-2')
    code, lines = run_study(out)
    assert code == 0
    missing = 'there is no learn-ce-verifai-2/learned.scenic, for nothing was found: nothing to do'
    assert missing in lines
    assert not [line for line in asked(out) if 'iterative-learned' in line]
    assert run_study(out)[0] == 0
    assert asked(out) == []


def waiting(out: Path) -> subprocess.Popen[str]:
    """A study that waits in the stage evaluate-generic."""
    (out / 'wait.txt').write_text('evaluate-generic')
    study = subprocess.Popen(
        [sys.executable, '-c', RUN, str(out)], cwd=Path(__file__).parent, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )
    assert study.stdout is not None
    assert study.stdout.readline() == 'waiting\n'
    (out / 'wait.txt').unlink()
    return study


@pytest.mark.parametrize('number', [
    signal.SIGKILL, *(
        pytest.param(number, marks=pytest.mark.nightly)
        for number in (signal.SIGINT, signal.SIGTERM)
    ),
])
def test_given_a_study_when_interrupted_or_killed_then_its_stage_is_resumed(
    finished, tmp_path, number
):
    out = copied(finished, tmp_path, 'evaluate-generic', 'evaluate-halton')
    with waiting(out) as study:
        study.send_signal(number)
        printed, _ = study.communicate()
    killed = number == signal.SIGKILL
    assert study.returncode == (-9 if killed else 130)
    last = 'interrupted in evaluate-generic; resuming goes on'
    assert killed or printed.splitlines()[-1] == last
    records = read_stages(out)
    assert (records['evaluate-generic'].key, records['evaluate-generic'].begun) == ('', killed)
    assert records['evaluate-halton'].sittings == 1
    assert len(asked(out)) == 1
    assert run_study(out)[0] == 0
    first, second = asked(out)
    assert 'evaluate-halton' in second
    assert first.startswith('falsify s_falsif')
    assert first.endswith('--out evaluate-generic --runs 20 --workers 2 --resume')
    # The time of a killed sitting is not known.
    found = read_stages(out)['evaluate-generic']
    assert (found.sittings, found.killed) == ((1, True) if killed else (2, False))


def test_given_an_interrupt_that_comes_as_a_stage_ends_then_the_next_one_is_not_begun(
    finished, tmp_path, monkeypatch
):
    out = copied(finished, tmp_path, 'evaluate-generic', 'evaluate-halton')
    received = iter([0, 1])
    monkeypatch.setattr('taxinet_ros.study.stages.run.interrupts_received', lambda: next(received))
    code, lines = run_study(out)
    assert (code, lines[-1]) == (130, 'interrupted after evaluate-generic; resuming goes on')
    assert len(asked(out)) == 1
    assert read_stages(out)['evaluate-generic'].key


def test_given_a_study_at_work_when_another_begins_in_its_folder_then_that_is_refused(tmp_path):
    with (
        open_study(tmp_path, print), pytest.raises(UsageError, match='another command is writing'),
        open_study(tmp_path, print),
    ):
        pass


def test_given_a_damaged_record_then_it_is_named_and_what_it_lacks_is_done_again(
    finished, tmp_path
):
    out = copied(finished, tmp_path)
    path, whole = out / RECORD_NAME, read_stages(out)
    data = bytearray(path.read_bytes())
    data[data.index(b'train-halton{"identity"') + 30] ^= 1
    path.write_bytes(data)
    with pytest.raises(UsageError, match=rf'{RECORD_NAME}: damaged'):
        read_stages(out)
    lines: list[str] = []
    assert run_study(out, lines=lines)[0] == 0
    assert 'damaged' in lines[0]
    (line,) = asked(out)
    assert line.startswith('train s_falsif')
    assert (out / 'train-halton.before-1').is_dir(), 'what the lost stage had made is kept'
    assert {name: one.outputs for name, one in read_stages(out).items()} == {
        name: one.outputs for name, one in whole.items()}


def test_given_a_killed_sitting_then_the_record_says_that_its_time_is_not_known():
    begun = StageRecord().started('a', 3, resumed=False)
    record = begun.started('a', 3, resumed=True).done('k', {}, 2.0, workers=1)
    assert (record.killed, record.wall_s, record.sittings) == (True, 2.0, 1)
    anew = record.started('a', 3, resumed=False)
    assert (anew.killed, anew.wall_s, anew.sittings, anew.key) == (False, 0.0, 0, '')


def test_given_a_whole_study_then_every_stage_is_done(finished):
    records = read_stages(finished)
    assert {state_of(stage, records, finished) for stage in stages(smoke_config())} == {State.DONE}


def test_f9_given_a_study_whose_folder_is_moved_then_it_ends_with_one_line(finished, tmp_path):
    out, moved = copied(finished, tmp_path, 'evaluate-generic', 'evaluate-halton'), tmp_path / 'to'

    def move(stage: Stage, resume: bool) -> int:
        out.rename(moved)
        raise OSError(2, 'No such file or directory')

    with pytest.raises(RecordError, match=f'{out}/{RECORD_NAME}: was moved, deleted or replaced'):
        run_study(out, work=move)
    assert not out.exists()
    assert run_study(moved)[0] == 0
    assert len(asked(moved)) == 2, 'what was not done, and no more'


def test_f1_given_a_full_disk_at_the_first_file_then_the_error_names_it(tmp_path, monkeypatch):
    def refuse(record: object, kind: str, key: str, values: object) -> None:
        raise OSError(28, 'No space left on device', str(tmp_path / 'study' / RECORD_NAME))

    out = tmp_path / 'study'
    with monkeypatch.context() as full:
        full.setattr('taxinet_ros.files.record.Record.put', refuse)
        with pytest.raises(OSError, match='No space left'):
            case_study(None, out=out, scale=0.005)
    monkeypatch.setattr(StudyRun, 'run', lambda run: None)
    with pytest.raises(UsageError, match=r'resume: .*: no study of taxinet case-study'):
        case_study(None, out=out, resume=True)
    assert case_study(None, out=tmp_path / 'other', scale=0.005) == 0


@pytest.mark.parametrize('how', ['refused', 'broken', 'code'])
def test_given_an_optional_stage_that_is_refused_then_the_others_go_on_and_it_is_tried_again(
    tmp_path, how
):
    logs = tmp_path / 'logs'
    logs.mkdir()
    (tmp_path / 'fail.txt').write_text('look')
    first = Stage(
        name='look', command='analyze', argument='x', options={'out': 'look'},
        outputs=('look/report.html',), optional=True,
    )
    second = dataclasses.replace(
        first, name='after', options={'out': 'after'}, outputs=('after/report.html',),
        optional=False,
    )

    def work(stage: Stage, resume: bool) -> int:
        print(f'at {stage.name}')
        try:
            return stand_in(stage, resume)
        except UsageError:
            if how == 'refused':
                raise
            if how == 'broken':
                raise InfraError('died', 'worker', 3, 'out of luck') from None
            return 4

    def sitting() -> tuple[dict[str, str], list[str]]:
        lines: list[str] = []
        with open_study(tmp_path, lines.append) as record:
            run = StudyRun(
                tmp_path, (first, second), record=record, work=work, workers=1, show=lines.append,
                logs=logs,
            )
            run.run()
            return run.refused, lines

    refused, lines = sitting()
    why = 'exit code 4' if how == 'code' else 'out of luck'
    assert list(refused) == ['look']
    assert why in refused['look']
    assert f'look: not done: {refused["look"]}' in lines
    assert (tmp_path / 'after' / 'report.html').is_file()
    assert (logs / 'look.log').read_text() == 'at look\n'
    (tmp_path / 'fail.txt').unlink()
    asked(tmp_path)
    assert sitting()[0] == {}
    assert [line.split()[-1] for line in asked(tmp_path)] == ['look']


def test_given_a_training_that_was_killed_then_it_goes_on_from_its_last_epoch(finished, tmp_path):
    out = copied(finished, tmp_path, 'train-halton')
    (out / 'train-halton' / 'halton.part').mkdir(parents=True)
    (out / 'train-halton' / 'halton.part' / unfinished.NAME).write_text('begun')
    assert run_study(out)[0] == 0
    (line,) = asked(out)
    assert line.startswith('train s_falsif')
    assert line.endswith(' --resume')


@pytest.mark.nightly
def test_doctor_given_what_a_stage_has_made_then_it_is_looked_for(finished, tmp_path):
    out = copied(finished, tmp_path)
    made, lost = (out / 'train-halton' / f'halton.{end}' for end in ('safetensors', 'json'))
    made.write_text('others')
    lost.unlink()
    found = {Path(one.where): one.what for one in examine(out).findings if 'stage' in one.what}
    assert found == {
        made: 'is not the file made by stage train-halton',
        lost: 'is missing, but was made by stage train-halton',
    }
    assert run_study(out)[0] == 0
    assert not [one for one in examine(out).findings if 'stage' in one.what]
