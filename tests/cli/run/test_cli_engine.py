"""``--engine loop``: the campaigns of the graph without ROS; audits, interrupts, refusals."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pandas as pd
import psutil
import pytest
from campaign_records import results
from process_table import gone
from taxinet_process import begun, taxinet, taxinet_apart
from waiting import wait_for

from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.facts import read_facts
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS
from taxinet_ros.trials.record.table import read_table

pytestmark = pytest.mark.ros

SCENES = [
    'nominal', '--perception', 'truth', '--set', 'duration=2', '--seed', '4',
    '--spec', 'tight=always(abs(cte) <= 0.3)', '--spec', 'slow=always(speed <= 6)',
]
SEARCH = ['falsify', *SCENES, '--runs', '8', '--sampler', 'ce', '--sampler-option', 'every=2']
LOOP = ('--engine', 'loop')
MOODY = """
import sys
steps = []

def eyes(truth):
    steps.append(truth)
    on_graph = sys.argv[0].endswith('graph/worker.py') and len(steps) > 15
    return truth.cte_m + 1e-12 * on_graph, truth.he_rad

eyes.needs_image = False
"""


def check_same(one: Path, other: Path) -> None:
    """Compare tables, and bags to the byte."""
    tables = [read_table(out).drop(columns=list(WALL_CLOCK_COLUMNS)) for out in (one, other)]
    pd.testing.assert_frame_equal(*tables)
    bags = [bag for bag in tables[0]['bag'] if bag]
    assert len(bags) == len(tables[0]) > 2
    for bag in bags:
        names = sorted(file.name for file in (one / bag).iterdir())
        assert names == sorted(file.name for file in (other / bag).iterdir()) != []
        for name in names:
            assert (one / bag / name).read_bytes() == (other / bag / name).read_bytes(), name


@pytest.fixture(scope='module')
def whole(tmp_path_factory) -> Path:
    """A search on the graph."""
    out = tmp_path_factory.mktemp('graph') / 'c'
    assert taxinet(*SEARCH, '--out', out).returncode in (0, 1)
    return out


@pytest.mark.nightly
def test_given_a_search_by_two_loops_then_rows_and_bags_are_those_of_the_graph(whole, tmp_path):
    out = tmp_path / 'c'
    done = taxinet(*SEARCH, *LOOP, '--audit', '50%', '--workers', '2', '--out', out)
    assert done.returncode in (0, 1), done.stderr
    assert 'perception truth, engine loop, 50 % audited, 2 workers' in done.stdout
    check_same(whole, out)
    told = read_facts(out)
    assert (told['engine'], told['audit_percent']) == ('loop', 50.0)
    assert (read_facts(whole)['engine'], read_facts(whole)['audit_percent']) == (
        'graph', 0.0
    )
    assert not list((out / 'logs' / 'audit').glob('nominal-*')), 'equal bags are not kept'
    assert taxinet('doctor', out).returncode == 0


@pytest.mark.nightly
def test_given_a_campaign_on_one_engine_when_resumed_on_the_other_then_nothing_tells(
    whole, tmp_path
):
    out = tmp_path / 'c'
    for runs, engine in (('3', ()), ('5', LOOP), ('8', ())):
        words = [runs if word == '8' else word for word in SEARCH]
        resume = ['--resume'] if out.exists() else []
        assert taxinet(*words, *engine, *resume, '--out', out).returncode in (0, 1)
    check_same(whole, out)
    assert read_facts(out)['engine'] == 'graph', 'that of the latest session'


def test_given_a_plain_campaign_by_the_loop_then_rows_and_bags_are_those_of_the_graph(tmp_path):
    words = ('run', *SCENES, '--runs', '3', '--out')
    assert taxinet(*words, tmp_path / 'graph').returncode in (0, 1)
    done = taxinet(*words, tmp_path / 'loop', *LOOP, '--audit', '100')
    assert done.returncode in (0, 1), done.stderr
    check_same(tmp_path / 'graph', tmp_path / 'loop')
    one = tmp_path / 'loop' / 'nominal-s4-00001'
    assert taxinet('run', '--from', one, '--out', tmp_path / 'again').returncode == 0


def test_given_no_ros_then_a_search_by_the_loop_goes_on_without_it_and_what_only_workers_need(
    tmp_path
):
    code = (
        'import sys; sys.modules.update(dict.fromkeys(["rclpy", "taxinet_ros.core.loop"])); '
        'from taxinet_ros.cli.main import main; main()'  # to import either raises ImportError
    )
    words = ['falsify', *SCENES, '--runs', '1', *LOOP, '--audit', '0', '--out', str(tmp_path / 'c')]
    done = subprocess.run(
        [sys.executable, '-c', code, *words], capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr


@pytest.mark.nightly
@pytest.mark.parametrize('engine', ['loop', 'graph'])
def test_given_a_plain_campaign_on_workers_then_rows_and_bags_are_those_of_one_at_a_time(
    engine, tmp_path
):
    words = ('run', *SCENES, '--runs', '3', '--engine', engine, '--out')
    audit = ('--audit', '0') if engine == 'loop' else ()
    one = taxinet(*words, tmp_path / 'one', *audit)
    two = taxinet(*words, tmp_path / 'two', *audit, '--workers', '2')
    assert (two.returncode, two.returncode in (0, 1)) == (one.returncode, True), two.stderr
    assert ', 2 workers -> ' in two.stdout
    assert len(list((tmp_path / 'two' / 'logs').glob('worker-*.log'))) == 2
    check_same(tmp_path / 'one', tmp_path / 'two')


@pytest.mark.nightly
@pytest.mark.parametrize('command', ['run', 'falsify'])
def test_given_a_perception_that_is_not_a_function_of_its_frame_then_an_audit_ends_the_campaign(
    command, tmp_path
):
    (tmp_path / 'moody.py').write_text(MOODY)
    words = [f'{tmp_path}/moody.py:eyes' if word == 'truth' else word for word in SCENES]
    words = [command, *words, '--runs', '40', '--out', str(tmp_path / 'c')]
    done = taxinet_apart(*words, *LOOP)
    assert done.returncode == 4, done.stdout + done.stderr
    line = next(line for line in done.stdout.splitlines() if 'loop and graph differ' in line)
    assert re.search(
        r' INFRA_ERROR audit loop: loop and graph differ: /perception/tracking_error, step 15, '
        r'cross_track_error: \S+ \| \S+; bag of the graph: \S*c/logs/audit/nominal-s4-00000', line
    )
    table = read_table(tmp_path / 'c')
    assert len(table) < 40
    assert (table['outcome'] == 'INFRA_ERROR').sum() == 1
    assert table['retries'].max() == 0
    for folder in ('', 'logs/audit'):
        assert (tmp_path / 'c' / folder / 'nominal-s4-00000' / 'metadata.yaml').is_file()
    assert len(read_campaign(tmp_path / 'c').rows) == len(table)


@pytest.mark.nightly
def test_given_a_killed_campaign_then_no_process_outlives_it_and_resumed_it_is_as_if_not(
    whole, tmp_path
):
    out = tmp_path / 'c'
    words = [*SEARCH, *LOOP, '--audit', '100', '--workers', '2', '--out', str(out)]
    with begun(*words) as search:
        wait_for(lambda: results(out) >= 2)
        below = [child.pid for child in psutil.Process(search.pid).children(recursive=True)]
        assert len(below) >= 4, 'Scenic, a loop, and the graph of its audits at least'
        search.send_signal(signal.SIGKILL)
        search.wait()
        wait_for(lambda: all(map(gone, below)))
    assert results(out) < 8
    done = taxinet(*words, '--resume')
    assert done.returncode in (0, 1), done.stderr
    check_same(whole, out)


@pytest.mark.nightly
def test_given_a_killed_loop_then_the_rows_are_the_same(whole, tmp_path):
    out = tmp_path / 'c'
    words = [*SEARCH, *LOOP, '--audit', '100', '--workers', '2', '--out', str(out)]
    with begun(*words) as search:
        wait_for(lambda: results(out) >= 1)
        loops = [
            child.pid for child in psutil.Process(search.pid).children()
            if 'taxinet_ros.trials.loop_worker' in child.cmdline()
        ]
        os.kill(loops[0], signal.SIGKILL)
        stdout, _ = search.communicate()
    assert search.returncode in (0, 1), stdout
    tables = [
        read_table(one).drop(columns=[*WALL_CLOCK_COLUMNS, 'retries']) for one in (whole, out)
    ]
    pd.testing.assert_frame_equal(*tables)


@pytest.mark.nightly
@pytest.mark.parametrize('command', ['run', 'falsify'])
def test_given_an_interrupt_then_what_is_recorded_is_complete_and_can_be_resumed(
    command, tmp_path
):
    out = tmp_path / 'c'
    long = ['duration=60' if word == 'duration=2' else word for word in SCENES]
    words = [command, *long, '--runs', '200', *LOOP, '--audit', '0', '--out', str(out)]
    with begun(*words) as campaign:
        wait_for(lambda: results(out) >= 1)
        campaign.send_signal(signal.SIGINT)
        stdout, _ = campaign.communicate()
    assert campaign.returncode == 130, stdout
    assert not psutil.pid_exists(campaign.pid)
    table = read_table(out)
    assert 1 <= len(table) < 200
    assert set(table['outcome'][:-1]) <= {'PASS', 'FAIL'}
    assert all((out / bag / 'metadata.yaml').is_file() for bag in table['bag'])
    assert taxinet('doctor', out).returncode == 0


@pytest.mark.parametrize(('words', 'said'), [
    (['run', *SCENES, '--processes'], 'processes: not with engine loop'),
    (['run', *SCENES, '--free'], 'free: not with engine loop'),
    (['run', *SCENES, '--foxglove', '8765'], '--foxglove: not with --engine loop'),
    (['run', '--from', 'somewhere'], '--from: --engine: a rerun is always made on the graph'),
    (['falsify', 'nominal', '--perception', 'external'], 'perception external is a node'),
    (['falsify', 'nominal', '--controller', 'cmd:mine'], 'controller cmd:mine is a node'),
    (['falsify', *SCENES, '--audit', 'all'], 'audit all: expected a percentage'),
])
def test_given_what_needs_a_graph_then_one_line_names_it_and_nothing_is_left_behind(
    words, said, tmp_path
):
    done = taxinet(*words, *LOOP, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, '')
    (line,) = done.stderr.strip().splitlines()
    assert said in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly
def test_given_an_experiment_and_a_shrinking_by_the_loop_then_they_are_as_on_the_graph(tmp_path):
    (tmp_path / 'e.yaml').write_text("""
program: nominal
runs: 3
perception: truth
specs: ['tight=always(abs(cte) <= 0.3)']
set: {duration_s: 2, heading_deg: 10}
arms: {calm: {}, windy: {set: {wind_speed_mps: 9, wind_direction_deg: 90}}}
""")
    for engine in ('graph', 'loop'):
        out = tmp_path / engine
        audited = ('--audit', '100') if engine == 'loop' else ()
        words = ('experiment', tmp_path / 'e.yaml', '--out', out, '--engine', engine, *audited)
        done = taxinet(*words)
        assert done.returncode == 0, done.stderr
        failed = read_table(out / 'windy').query('outcome == "FAIL"')['bag'].iloc[0]
        small = tmp_path / f'{engine}-small'
        words = ('shrink', out / 'windy' / failed, '--out', small, '--engine', engine)
        done = taxinet(*words)
        assert done.returncode == 0, done.stderr
    for arm in ('calm', 'windy'):
        check_same(tmp_path / 'graph' / arm, tmp_path / 'loop' / arm)
    check_same(tmp_path / 'graph-small', tmp_path / 'loop-small')
