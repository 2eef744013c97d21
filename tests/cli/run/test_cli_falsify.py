"""``taxinet falsify`` on real graphs: workers, kills, Ctrl-C, resumption, refusals."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from contextlib import AbstractContextManager
from pathlib import Path

import pandas as pd
import pytest
from campaign_records import results
from process_table import children, gone
from taxinet_process import begun as command_begun
from taxinet_process import taxinet, taxinet_apart
from waiting import wait_for

from taxinet_ros.bag.reader import read_info
from taxinet_ros.samplers.sampler import LAG
from taxinet_ros.trials.learned_result import LearnedResult
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS
from taxinet_ros.trials.record.table import read_table

WORDS = [
    'falsify', 'nominal', '--runs', '10', '--perception', 'truth', '--set', 'duration=2',
    '--seed', '4', '--sampler', 'ce', '--sampler-option', 'every=2',
    '--spec', 'tight=always(abs(cte) <= 0.3)',
]

pytestmark = pytest.mark.ros


def falsify(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return taxinet(*WORDS, *words, cwd=cwd)


def begun(
    *words: str, stderr: int | None = None
) -> AbstractContextManager[subprocess.Popen[str]]:
    return command_begun(*WORDS, *words, stderr=stderr)


def frames(bag: Path) -> int:
    return sum(file.stat().st_size for file in bag.glob('*.mcap'))


def same_runs(one: Path, other: Path, *but: str) -> None:
    tables = [
        read_table(folder).drop(columns=[*WALL_CLOCK_COLUMNS, *but]) for folder in (one, other)
    ]
    assert len(tables[0]) == 10
    pd.testing.assert_frame_equal(*tables)


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A search by one worker that nobody disturbed."""
    out = tmp_path_factory.mktemp('falsify') / 'whole'
    done = taxinet_apart(*WORDS, '--out', str(out))
    assert (done.returncode, done.stderr) in ((0, ''), (1, '')), done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith('searching nominal for failures: up to 10 runs, sampler ce, seed 4')
    assert lines[1] == 'searched: time_of_day_h, clouds, ego.position.x, distance_m, ego.heading'
    assert lines[2].startswith('tight: within 0.3 m of the centreline all the time')
    assert [line.split()[0] for line in lines[4:14]] == [str(index) for index in range(10)]
    assert 'under the program itself: satisfied' in done.stdout
    return out


def test_given_a_search_then_there_are_bags_without_pictures_a_record_and_what_was_learned(whole):
    table = read_table(whole)
    assert table['rho'].notna().all()
    for bag, outcome in zip(table['bag'], table['outcome'], strict=True):
        info = read_info(whole / bag)
        assert info.complete
        assert ('/camera/image_raw' in info.counts) == (outcome == 'FAIL')
        assert info.counts['/ground_truth/odom'] == 21
    content = read_campaign(whole)
    assert (content.finished, len(content.rows)) == (True, 10)
    assert content.attempts == dict.fromkeys(range(10), 1)
    learned = LearnedResult.read(whole).probabilities
    assert set(learned) == {name[2:] for name in table.columns if name.startswith('u_')}
    assert all(sum(one) == pytest.approx(1) for one in learned.values())
    assert 'found by ce in 10 runs' in (whole / 'learned.scenic').read_text()


@pytest.mark.nightly
def test_given_two_workers_one_of_which_is_killed_then_the_runs_are_the_same(whole, tmp_path):
    out = tmp_path / 'c'
    with begun('--workers', '2', '--out', str(out)) as search:
        wait_for(lambda: results(out) >= 2)
        pids = children(search.pid, 'taxinet_ros.nodes.graph.worker')
        assert len(pids) == 2
        os.kill(min(pids), signal.SIGKILL)
        stdout, _ = search.communicate()
    assert search.returncode in (0, 1), stdout
    same_runs(whole, out, 'retries')
    assert read_table(out)['retries'].sum() <= 1


@pytest.mark.nightly
def test_f10_given_a_killed_scenic_process_then_the_bench_broke_and_resume_goes_on(whole, tmp_path):
    out = tmp_path / 'c'
    with begun('--out', str(out), stderr=subprocess.PIPE) as search:
        wait_for(lambda: results(out) >= 2)
        (pid,) = children(search.pid, 'scenic_child')
        os.kill(pid, signal.SIGKILL)
        _, complaint = search.communicate()
    assert search.returncode == 4
    assert re.fullmatch(r'taxinet: error: died: the Scenic process of \S*nominal.scenic: killed by '
                        r'SIGKILL\n', complaint)
    assert falsify('--out', str(out), '--resume').returncode in (0, 1)
    same_runs(whole, out, 'run_id', 'bag', 'retries')


@pytest.mark.nightly
def test_given_a_killed_campaign_then_no_process_outlives_it_and_resumed_it_is_as_if_not(
    whole, tmp_path
):
    out = tmp_path / 'c'
    with begun('--workers', '2', '--out', str(out)) as search:
        wait_for(lambda: results(out) >= 3)
        pids = children(search.pid, 'taxinet_ros.')
        assert len(pids) == 3, 'two workers and Scenic'
        search.send_signal(signal.SIGKILL)
        search.wait()
        wait_for(lambda: all(map(gone, pids)))
    kept = results(out)
    done = falsify('--workers', '2', '--resume', '--out', str(out))
    assert done.returncode in (0, 1), done.stderr
    assert done.stdout.startswith('resuming nominal')
    assert results(out) == 10
    shown = re.findall(r'^ +\d+  (?:PASS|FAIL)  rho ', done.stdout, re.MULTILINE)
    assert len(shown) == 10 - kept
    same_runs(whole, out)


@pytest.mark.nightly
def test_given_an_interrupt_then_the_runs_end_in_order_and_the_rest_can_be_resumed(tmp_path):
    out = tmp_path / 'c'
    long = ('duration=600' if word == 'duration=2' else word for word in WORDS)
    with command_begun(*long, '--workers', '2', '--runs', '3', '--out', str(out)) as search:
        wait_for(lambda: len([bag for bag in out.glob('nominal-*') if frames(bag) > 60_000]) == 2)
        search.send_signal(signal.SIGINT)
        stdout, _ = search.communicate()
    assert search.returncode == 130
    assert '2 INTERRUPTED' in stdout
    assert '--resume continues it' in stdout
    table = read_table(out)
    assert list(table['outcome']) == ['INTERRUPTED'] * 2
    assert all(read_info(out / bag).complete for bag in table['bag'])
    assert not children(search.pid, 'taxinet')


BAD = {
    'unknown sampler': (['--sampler', 'luck'], "sampler 'luck' is unknown; known: random"),
    'unknown option': (['--sampler-option', 'seed=1'], 'sampler ce: unknown option seed'),
    'unknown rule': (['--until', 'bored'], 'until bored: expected failures=K'),
    'resume of nothing': (['--resume', '--out', 'c'], 'nothing to resume'),
}


@pytest.mark.parametrize('case', BAD)
def test_given_a_mistake_then_one_line_says_what_and_nothing_is_left_behind(case, tmp_path):
    words, expected = BAD[case]
    done = falsify(*words, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith('taxinet: error: ')
    assert expected in line
    assert list(tmp_path.iterdir()) == []


def test_given_another_seed_when_resumed_then_it_is_refused_with_one_line(whole):
    done = falsify('--resume', '--out', str(whole), '--seed', '5')
    assert done.returncode == 2
    assert 'was begun with seed 4, not 5' in done.stderr
    assert done.stderr.count('\n') == 1


@pytest.mark.nightly
def test_given_quiet_and_an_early_stop_then_there_is_only_the_summary(tmp_path):
    done = falsify(
        '--quiet', '--spec', 'fast=always(speed >= 50)', '--until', 'failures=1',
        '--out', str(tmp_path / 'c'),
    )
    assert (done.returncode, done.stderr) == (1, '')
    lines = done.stdout.splitlines()
    assert lines[0].startswith('warning: fast: no run can satisfy it: speed >= 50 m/s (97.19 kt)')
    assert lines[1] == f'{LAG} FAIL', 'those that were chosen before the first result was told'
    assert 'ended before its 10 runs: failures=1 reached; --resume continues it' in lines


def test_t7_given_no_sampler_then_it_is_the_one_that_finds_most(capsys):
    from taxinet_ros.cli.main import _exit_code, app

    words = ['falsify', 'nominal', '--sampler-option', 'seed=1']
    assert _exit_code(lambda: app(words, standalone_mode=False)) == 2
    assert 'sampler active: unknown option seed; known: radius, floor' in capsys.readouterr().err
