"""The command line: what people type, what they get back, and what a mistake costs them."""

from __future__ import annotations

import signal

import pandas as pd
import pytest
from taxinet_process import begun, taxinet, taxinet_apart
from waiting import wait_for

from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.trials.record.content import read_campaign


def test_given_a_program_when_run_then_there_are_lines_a_table_a_record_and_bags(tmp_path):
    out = tmp_path / 'campaign'
    done = taxinet_apart(
        'run', 's_falsif', '--runs', '2', '--seed', '3', '--perception', 'truth',
        '--set', 'duration=12', '--set', 'steering.heading_gain=1.5', '--out', str(out),
    )
    assert (done.returncode, done.stderr) == (0, '')
    lines = done.stdout.splitlines()
    assert lines[0].startswith('2 runs of s_falsif, seed 3, perception truth')
    assert lines[1] == (
        'phi_eventually: within 1.5 m of the centreline from 10 s at the latest to the end'
    )
    assert lines[2].split()[0] == 'run', 'the names of the columns'
    assert all(len(line) <= 100 for line in lines[3:5])
    lines = lines[:1] + lines[3:]
    assert [line.split()[:2] for line in lines[1:3]] == [['0', 'PASS'], ['1', 'PASS']]
    assert lines[3] == '2 PASS'

    table = pd.read_parquet(out / 'runs.parquet')
    assert list(table['outcome']) == ['PASS', 'PASS']
    assert (table['rho'] > 0).all()
    assert (table['rho'] == table['rho_phi_eventually']).all()
    assert list(pd.read_csv(out / 'runs.csv')['run_id']) == list(table['run_id'])
    for bag, start in zip(table['bag'], table['cross_track_m'], strict=True):
        assert read_info(out / bag).complete
        trace = open_recording(out / bag).columns
        assert len(trace['t_ns']) == 121
        assert trace['cte_m'][0] == pytest.approx(start, abs=1e-6)
        assert trace['x_m'][-1] - trace['x_m'][0] > 30, 'the aircraft has moved'
    content = read_campaign(out)
    facts = content.facts
    assert facts['gains'] == {'heading_gain': 1.5}
    assert facts['images'] == 'failures', 'nobody looks at the pictures of several runs'
    assert 'time_of_day' in facts['program_text']
    assert (content.attempts, content.unfinished, content.finished) == ({0: 1, 1: 1}, (), True)


def test_given_a_formula_that_cannot_hold_then_the_exit_code_is_one(tmp_path):
    done = taxinet(
        'run', 'nominal', '--perception', 'truth', '--set', 'duration=1', '--spec',
        'fast=always(speed >= 50)', '--spec', 'on_runway', '--out', str(tmp_path / 'c'),
    )
    assert (done.returncode, done.stderr) == (1, '')
    table = pd.read_parquet(tmp_path / 'c' / 'runs.parquet')
    assert read_campaign(tmp_path / 'c').facts['images'] == 'all'
    assert table['outcome'][0] == 'FAIL'
    assert table['rho_fast'][0] == pytest.approx(-45, abs=0.5)
    assert table['rho_on_runway'][0] > 10


@pytest.mark.nightly
def test_given_separate_processes_then_the_table_is_the_same_but_for_the_clock(tmp_path):
    words = ['run', 'nominal', '--perception', 'truth', '--set', 'duration=2', '--seed', '5']
    one = taxinet(*words, '--out', str(tmp_path / 'one'))
    many = taxinet(*words, '--processes', '--out', str(tmp_path / 'many'))
    assert (one.returncode, many.returncode) == (one.returncode, one.returncode), many.stderr
    tables = [pd.read_parquet(tmp_path / name / 'runs.parquet') for name in ('one', 'many')]
    clock = ['wall_s', 'real_time_factor']
    pd.testing.assert_frame_equal(*(table.drop(columns=clock) for table in tables))
    assert len(list((tmp_path / 'many' / 'logs').iterdir())) == 5


@pytest.mark.parametrize('engine', [
    'graph', pytest.param('loop', marks=pytest.mark.nightly),
])
def test_given_a_perception_of_ones_own_that_crashes_then_each_run_says_so(engine, tmp_path):
    (tmp_path / 'eyes.py').write_text('import os\n\n\ndef look(image):\n    os._exit(1)\n')
    done = taxinet_apart(
        'run', 'nominal', '--runs', '2', '--perception', 'eyes.py:look', '--engine', engine,
        '--images', 'none', '--set', 'duration=1', '--out', 'c', cwd=tmp_path,
    )
    assert done.returncode == 4, done.stdout + done.stderr  # 1 would say that a run was violated
    assert 'one worker process -> c' in done.stdout
    rows = read_campaign(tmp_path / 'c').rows
    assert [(row.kind, row.who, row.detail) for row in rows] == [
        ('died', 'worker', 'exit code 1')
    ] * 2


def test_given_a_program_with_a_mistake_then_the_line_names_file_and_line(tmp_path):
    text = 'model runway_world\nego = new Plane at (1, 2) facing\n'
    (tmp_path / 'broken.scenic').write_text(text)
    done = taxinet_apart('run', 'broken.scenic', cwd=tmp_path)
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert 'broken.scenic:2' in line
    assert [file.name for file in tmp_path.iterdir()] == ['broken.scenic']


def test_given_a_folder_with_something_in_it_then_it_is_left_alone(tmp_path):
    (tmp_path / 'notes.txt').write_text('mine')
    done = taxinet('run', 'nominal', '--out', str(tmp_path))
    assert done.returncode == 2
    assert done.stderr.endswith(' already exists; recordings are never overwritten, '
                                'choose a new folder\n')
    assert [file.name for file in tmp_path.iterdir()] == ['notes.txt']
    done = taxinet('falsify', 'nominal', '--out', str(tmp_path))
    assert done.stderr.endswith('choose a new folder, or resume it\n')


def test_given_an_interrupt_then_the_run_ends_in_order_and_its_bag_is_whole(tmp_path):
    words = ['run', 'nominal', '--runs', '3', '--perception', 'truth', '--set', 'duration=600']
    bag = tmp_path / 'c' / 'nominal-s0-00000'
    with begun(*words, '--out', 'c', cwd=tmp_path) as campaign:
        wait_for(lambda: sum(file.stat().st_size for file in bag.glob('*.mcap')) > 1_000_000)
        campaign.send_signal(signal.SIGINT)
        out, _ = campaign.communicate()
    assert campaign.returncode == 130
    assert '1 INTERRUPTED' in out
    table = pd.read_parquet(tmp_path / 'c' / 'runs.parquet')
    assert list(table['outcome']) == ['INTERRUPTED']
    assert read_info(bag).complete


@pytest.mark.nightly
def test_given_the_demo_then_there_are_three_campaigns_and_two_pictures(tmp_path):
    done = taxinet('demo', '--runs', '1', '--seed', '2', '--out', str(tmp_path / 'demo'))
    assert (done.returncode, done.stderr) == (0, '')
    scenes = []
    for perception in ('original', 'taxinet', 'truth'):
        table = pd.read_parquet(tmp_path / 'demo' / perception / 'runs.parquet')
        assert list(table['perception']) == [perception]
        scene = ['cross_track_m', 'distance_m', 'heading_deg', 'time_of_day_h', 'clouds']
        scenes.append(table[scene])
        trace = open_recording(tmp_path / 'demo' / perception / table['bag'][0]).columns
        wrong = abs(trace['est_cte_m'] - trace['cte_m']).max()
        assert wrong == 0 if perception == 'truth' else wrong > 0.001
    for others in scenes[1:]:
        pd.testing.assert_frame_equal(scenes[0], others)
    for picture in ('frames.png', 'trajectories.png'):
        assert (tmp_path / 'demo' / picture).read_bytes().startswith(b'\x89PNG')


def test_given_no_command_or_a_wish_for_help_then_the_commands_are_listed():
    for words in ((), ('--help',)):
        done = taxinet_apart(*words)
        assert 'Traceback' not in done.stderr
        for command in ('run', 'demo', 'train', 'node'):
            assert f'  {command} ' in done.stdout
    assert taxinet_apart('--version').stdout.startswith('taxinet 0.')
