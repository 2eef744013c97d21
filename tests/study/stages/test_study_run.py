"""Stages are run once, kept while they fit, continued after an interrupt, never thrown away.

What a study says that its stages have made is looked for by the doctor.
"""

from __future__ import annotations

import dataclasses
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from studies import STAND_IN, asked, run_study, sittings_of, smoke_config

from taxinet_ros.campaign.doctor import examine
from taxinet_ros.cli.study import case_study
from taxinet_ros.errors import UsageError
from taxinet_ros.files.sealed_json import file_sha256
from taxinet_ros.study.stages.log import LOG_NAME, StageLog, read_records
from taxinet_ros.study.stages.plan import stages
from taxinet_ros.study.stages.progress import State, seconds_left, state_of
from taxinet_ros.study.stages.run import StudyRun, run_command
from taxinet_ros.study.stages.stage import Kind, Stage

RUN = 'import sys, pathlib, studies; code, lines = studies.run_study(pathlib.Path(sys.argv[1])); ' \
    "print('\\n'.join(lines)); sys.exit(code)"


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


def test_given_a_whole_study_when_run_again_then_nothing_is_done_twice(finished):
    code, lines = run_study(finished)
    assert code == 0
    assert asked(finished) == []
    assert len(lines) == 30
    assert all('done, kept' in line for line in lines)


def test_given_a_whole_study_then_headings_number_its_stages_and_tell_the_time(first_sitting):
    _, lines = first_sitting
    headings = [line for line in lines if line.startswith('[')]
    assert len(headings) == 30
    assert headings[1].startswith('[2/30] falsify-original: taxinet falsify s_falsif --sampler ')
    assert ' --runs 20 --workers 2' in headings[1]
    assert sum(' left' in line for line in lines) == 30


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


def test_given_a_stage_that_fails_then_the_study_stops_with_its_code_and_goes_on_later(
    finished, tmp_path, capfd
):
    out = copied(finished, tmp_path, 'analyze-original', 'localize-original')
    (out / 'fail.txt').write_text('analyze-original')
    code, lines = run_study(out)
    assert code == 2
    assert len(asked(out)) == 1
    assert lines[-1] == (
        'stopped at analyze-original: exit code 2; once it is mended, --resume goes on'
    )
    assert 'taxinet: error: analyze-original: out of luck' in capfd.readouterr().err
    (out / 'fail.txt').unlink()
    code, _ = run_study(out)
    assert code == 0
    assert [line.split()[0] for line in asked(out)] == ['analyze', 'localize']


def test_given_a_command_that_leaves_nothing_behind_then_the_study_stops(tmp_path, monkeypatch):
    monkeypatch.setattr('studies.STAND_IN', [sys.executable, '-c', ''])
    code, lines = run_study(tmp_path / 'study')
    assert code == 4
    assert 'train-original/original.safetensors is missing' in lines[-1]


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


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_given_a_study_when_interrupted_then_its_stage_ends_in_order_and_is_resumed(
    finished, tmp_path, number
):
    out = copied(finished, tmp_path, 'evaluate-generic', 'evaluate-halton')
    (out / 'wait.txt').write_text('evaluate-generic')
    here = str(Path(__file__).parent)
    with subprocess.Popen(
        [sys.executable, '-c', RUN, str(out)], cwd=here, stdout=subprocess.PIPE, text=True
    ) as study:
        assert study.stdout is not None
        assert study.stdout.readline() == 'waiting\n'
        study.send_signal(number)
        printed, _ = study.communicate()
    assert study.returncode == 130
    assert printed.splitlines()[-1] == 'interrupted in evaluate-generic; --resume goes on'
    records = read_records(out)
    assert not records['evaluate-generic'].key
    assert records['evaluate-halton'].sittings == 1
    (out / 'wait.txt').unlink()
    assert len(asked(out)) == 1
    assert run_study(out)[0] == 0
    first, second = asked(out)
    assert 'evaluate-halton' in second
    assert first.startswith('falsify s_falsif')
    assert first.endswith('--out evaluate-generic --runs 20 --workers 2 --resume')
    assert sittings_of(out, 'evaluate-generic') == 2


def test_given_a_study_at_work_when_another_begins_in_its_folder_then_that_is_refused(tmp_path):
    with (
        StageLog(tmp_path),
        pytest.raises(UsageError, match='in use by another taxinet case-study or improve'),
    ):
        StageLog(tmp_path)


def test_given_a_log_with_a_torn_line_then_it_is_left_out_and_a_damaged_one_is_named(
    finished, tmp_path
):
    out = copied(finished, tmp_path)
    log = out / LOG_NAME
    whole = read_records(out)
    with log.open('a') as file:
        file.write('{"event":"begin","sta')
    assert read_records(out) == whole
    log.write_text('{"event":"end"}\n' + log.read_text())
    with pytest.raises(UsageError, match=rf'{LOG_NAME}:1: damaged line .no checksum'):
        read_records(out)


def test_given_a_killed_sitting_then_the_log_says_that_its_time_is_not_known(tmp_path):
    with StageLog(tmp_path) as log:
        begin = {'identity': 'a', 'runs': 3}
        log.write('begin', 'one', resumed=False, **begin)
    with StageLog(tmp_path) as log:
        log.write('begin', 'one', resumed=True, **begin)
        log.write('end', 'one', key='k', outputs={}, wall_s=2.0)
        record = log.records['one']
    assert (record.killed, record.wall_s, record.sittings) == (True, 2.0, 1)


def test_given_what_took_how_long_then_the_rest_is_told_by_it(finished):
    found, records = stages(smoke_config()), read_records(finished)
    assert all(state_of(stage, records, finished) is State.DONE for stage in found)
    slow = {
        name: dataclasses.replace(record, wall_s=1000.0) for name, record in records.items()
    }
    evaluation = next(stage for stage in found if stage.name == 'evaluate-best')
    quick = seconds_left([evaluation], found, records, 2)
    assert 0 < quick < 100
    assert 200 < seconds_left([evaluation], found, slow, 2) <= 1000
    assert seconds_left([evaluation], found, {}, 1) > seconds_left([evaluation], found, {}, 2)


def test_f9_given_a_study_whose_folder_is_moved_then_it_ends_with_one_line(finished, tmp_path):
    out = copied(finished, tmp_path, 'evaluate-generic', 'evaluate-halton')
    (out / 'wait.txt').write_text('evaluate-generic')
    here = str(Path(__file__).parent)
    with subprocess.Popen(
        [sys.executable, '-c', RUN, str(out)], cwd=here, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    ) as study:
        assert study.stdout is not None
        assert study.stdout.readline() == 'waiting\n'
        out.rename(tmp_path / 'moved')
        study.send_signal(signal.SIGINT)
        _, complaints = study.communicate()
    assert f'RecordError: {out}/stages.jsonl: was moved, deleted or replaced' in complaints
    assert not out.exists()
    (tmp_path / 'moved' / 'wait.txt').unlink()
    asked(tmp_path / 'moved')
    assert run_study(tmp_path / 'moved')[0] == 0
    assert len(asked(tmp_path / 'moved')) == 2, 'what was not done, and no more'


MOVES = """
import sys
from pathlib import Path
from taxinet_ros.files.atomic import make_folder
study = Path(sys.argv[1])
study.rename(study.with_name('moved'))
print('moved', flush=True)
make_folder(study / 'analyze')
"""


def test_f9_given_a_folder_that_is_moved_during_a_stage_then_nothing_is_made_in_its_place(tmp_path):
    out = tmp_path / 'study'
    (out / 'logs').mkdir(parents=True)
    code, interrupted, said = run_command(
        [sys.executable, '-c', MOVES, str(out)], out, tmp_path, out / 'logs' / 'analyze.log')
    assert (code, interrupted, said) == (1, False, '')
    assert 'RecordError' in (tmp_path / 'moved' / 'logs' / 'analyze.log').read_text()
    assert not out.exists()


def test_f1_given_a_full_disk_at_the_first_file_then_the_study_can_be_begun_again(
    tmp_path, monkeypatch
):
    def refuse(out: Path, config: object) -> None:
        raise OSError(28, 'No space left on device', str(out / 'study.json'))

    options = case_study.CaseStudyOptions(out=tmp_path / 'study', scale=0.005)
    with monkeypatch.context() as full:
        full.setattr(case_study, 'write_study', refuse)
        with pytest.raises(OSError, match='No space left'):
            case_study.run_case_study(options)
    assert list((tmp_path / 'study').iterdir()) == []
    monkeypatch.setattr(case_study.StudyRun, 'run', lambda run: 0)
    assert case_study.run_case_study(options) == 0


def test_doctor_given_what_a_stage_has_made_then_it_is_looked_for(tmp_path: Path) -> None:
    made = tmp_path / 'one' / 'result.parquet'
    made.parent.mkdir()
    made.write_bytes(b'1')
    with StageLog(tmp_path) as log:
        log.write('begin', 'one', identity='a', runs=1, resumed=False)
        outputs = {'one/result.parquet': file_sha256(made)}
        log.write('end', 'one', key='k', outputs=outputs, wall_s=1.0)
    assert examine(tmp_path).findings == []
    made.write_bytes(b'2')
    assert [(one.where, one.what) for one in examine(tmp_path).findings] == [
        (str(made), 'is not the file made by stage one')
    ]
    made.unlink()
    assert [one.what for one in examine(tmp_path).findings] == [
        'is missing, but was made by stage one'
    ]
    with StageLog(tmp_path) as log:  # one that is begun anew makes it anew
        log.write('begin', 'one', identity='b', runs=1, resumed=False)
    assert examine(tmp_path).findings == []


def test_given_an_optional_stage_that_is_refused_then_the_others_go_on_and_it_is_tried_again(
    tmp_path
):
    logs = tmp_path / 'logs'
    logs.mkdir()
    (tmp_path / 'runs.parquet').write_text('')
    (tmp_path / 'fail.txt').write_text('look')
    first = Stage(
        name='look', words=('analyze', 'x', '--out', 'look'), outputs=('look/report.html',),
        kind=Kind.REPORT, amount=1, optional=True,
    )
    second = dataclasses.replace(
        first, name='after', words=('analyze', 'x', '--out', 'after'),
        outputs=('after/report.html',), optional=False,
    )

    def sitting() -> tuple[int, dict[str, str], list[str]]:
        lines: list[str] = []
        with StageLog(tmp_path) as log:
            run = StudyRun(
                tmp_path, (first, second), log=log, command=STAND_IN, workers=1,
                show=lines.append, logs=logs,
            )
            return run.run(), run.refused, lines

    code, refused, lines = sitting()
    assert (code, refused) == (0, {'look': 'look: out of luck'})
    assert 'look: not done: look: out of luck' in lines
    assert (tmp_path / 'after' / 'report.html').is_file()
    assert 'out of luck' in (logs / 'look.log').read_text()
    (tmp_path / 'fail.txt').unlink()
    asked(tmp_path)
    assert sitting()[:2] == (0, {})
    assert [line.split()[-1] for line in asked(tmp_path)] == ['look']
