"""``taxinet case-study`` as a person types it: lists, refusals, and a campaign for real."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from taxinet_process import taxinet

from taxinet_ros.cli.study.case_study import case_study
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.study.report.report import report_case_study
from taxinet_ros.study.stages.run import read_options
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import read_table

PROGRAM = """model runway_world
param time_of_day = Range(10, 11)
param clouds = 'clear'
param rain = 0
param duration = 2
ego = new Plane at (Range(-1, 1), Range(900, 1000))
"""
CONFIG = """evaluation: {program: plain.scenic, runs: 4}
best: truth
workers: 1
"""
BEST_ONLY = """
import sys
from pathlib import Path
from taxinet_ros.cli.study.stages import call_stage
from taxinet_ros.study.stages.config import read_config
from taxinet_ros.study.stages.plan import stages
from taxinet_ros.study.stages.run import open_study
from taxinet_ros.study.stages.run import StoppedError, StudyRun

found = [stage for stage in stages(read_config(Path('mine.yaml'))) if stage.name == 'evaluate-best']
sys.stdout.reconfigure(line_buffering=True)
with open_study(Path('study'), print) as record:
    run = StudyRun(
        Path('study'), found, record=record, work=call_stage, workers=1, show=print)
    try:
        run.run()
    except StoppedError as stopped:
        sys.exit(stopped.code)
"""


def test_given_list_then_all_stages_are_named_with_their_commands_and_nothing_is_done(tmp_path):
    done = taxinet('case-study', '--list', '--scale', '0.02', cwd=tmp_path)
    lines = done.stdout.splitlines()
    assert (done.returncode, len(lines)) == (0, 30), done.stderr
    assert lines[1].split()[:5] == ['2', 'falsify-original', 'to', 'do', 'taxinet']
    assert '--runs 80 --workers 2' in lines[1]
    assert '--images 240 ' in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_given_a_folder_that_is_full_then_the_command_says_so_in_one_line(tmp_path):
    (tmp_path / 'full').mkdir()
    (tmp_path / 'full' / 'something').touch()
    done = taxinet('case-study', '--out', 'full', cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith('taxinet: error: out full: already exists; recordings')
    assert len(done.stderr.splitlines()) == 1
    assert [path.name for path in (tmp_path / 'full').iterdir()] == ['something']


@pytest.mark.parametrize(('options', 'complaint'), [
    ({'resume': True}, r'--resume: name the case study to continue with --out'),
    ({'resume': True, 'out': Path('new')}, r'resume: new: no study of taxinet case-study'),
    ({'until': 'lunch'}, r'until lunch: no such stage; known: train-original, '),
    ({'scale': 0.0}, r'scale 0: needs to be above 0, at most 100'),
    ({'config': Path('gone.yaml')}, r'config gone.yaml: cannot be read'),
])
def test_given_bad_input_then_it_is_refused_and_nothing_is_written(
    tmp_path, monkeypatch, options, complaint
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=complaint):
        case_study(None, **options)
    assert list(tmp_path.iterdir()) == []


def test_given_no_study_then_there_is_no_report(tmp_path):
    with pytest.raises(UsageError, match=r'report_only: name the case study as out'):
        report_case_study(None)
    with pytest.raises(UsageError, match=r'report_only: .*/new: no study of taxinet case-study'):
        report_case_study(tmp_path / 'new')


def test_given_a_study_that_was_begun_when_resumed_then_it_keeps_its_own_sizes(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(
        'taxinet_ros.cli.study.case_study.call_stage', lambda stage, resume: 3)
    out = tmp_path / 'study'
    assert case_study(None, out=out, scale=0.02) == 3
    begun = read_options(out, 'case-study', '')
    assert (begun['runs'], begun['images']) == (80, 240)
    assert case_study(None, out=out, resume=True, workers=1) == 3
    begun = read_options(out, 'case-study', '')
    assert (begun['runs'], begun['images'], begun['workers']) == (80, 240, 1)
    (tmp_path / 'more.yaml').write_text('evaluation: {runs: 90}')
    assert case_study(None, out=out, resume=True, config=tmp_path / 'more.yaml') == 3
    assert read_options(out, 'case-study', '')['runs'] == 90
    printed = capsys.readouterr().out
    assert 'stopped at train-original: exit code 3; once it is fixed, --resume' in printed
    with pytest.raises(UsageError, match=r'study: already exists'):
        case_study(None, out=out)


@pytest.mark.ros
@pytest.mark.nightly
def test_given_a_campaign_interrupted_when_the_study_is_resumed_then_it_goes_on_where_it_was(
    tmp_path,
):
    (tmp_path / 'plain.scenic').write_text(PROGRAM)
    (tmp_path / 'mine.yaml').write_text(CONFIG)
    out = tmp_path / 'study'
    out.mkdir()
    command = [sys.executable, '-c', BEST_ONLY]
    environment = {**os.environ, 'COLUMNS': '80'}
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, text=True, env=environment
    ) as study:
        assert study.stdout is not None
        assert next((line for line in study.stdout if line.startswith('    0  ')), '')
        study.send_signal(signal.SIGINT)
        rest = study.stdout.read()
    assert study.returncode == 130
    assert rest.splitlines()[-1] == 'interrupted in evaluate-best; resuming goes on'
    before = _results(out)
    assert 1 <= len(before) < 4

    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert '--runs 4 --workers 1 --resume' in done.stdout
    kept = [row for row in before if row.outcome is not Outcome.INTERRUPTED]
    assert _results(out)[:len(kept)] == kept
    table = read_table(out / 'evaluate-best')
    assert table['index'].tolist() == list(range(4))
    assert table['duration_s'].unique().tolist() == [2.0]


def _results(out: Path) -> list[RunRow]:
    return list(read_campaign(out / 'evaluate-best').rows)


def test_s11_given_list_for_a_folder_without_a_study_then_all_stages_are_named(tmp_path):
    done = taxinet('case-study', '--list', '--out', 'new', cwd=tmp_path)
    assert (done.returncode, len(done.stdout.splitlines())) == (0, 30), done.stderr
    assert list(tmp_path.iterdir()) == []
