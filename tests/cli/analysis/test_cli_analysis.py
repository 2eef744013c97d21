"""``taxinet experiment``, ``localize`` and ``gate`` on campaigns of the real graph."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pandas as pd
import pytest
from taxinet_process import begun, taxinet, taxinet_apart
from waiting import wait_for

from taxinet_ros.files.record import RECORD_NAME, read_record
from taxinet_ros.trials.record.table import read_table

# A start 4 m off is too far to settle in a second: all of one arm fail and none of the other.
EXPERIMENT = """
program: halton_time_of_day
runs: 4
sampler: halton
perception: truth
specs: ['near=always(abs(cte) <= 2.05)']
set: {duration: 1}
arms:
  near: {}
  far: {set: {cross_track: 4, shadows: off}}
"""

pytestmark = pytest.mark.ros


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an experiment ``e``, and a campaign ``c`` of failed runs with their bags."""
    folder = tmp_path_factory.mktemp('analysis')
    (folder / 'mine.yaml').write_text(EXPERIMENT)
    done = taxinet_apart('experiment', 'mine.yaml', '--runs', '2', '--out', 'e', cwd=folder)
    assert (done.returncode, done.stderr) == (0, '')
    done = taxinet(
        'run', 's_falsif', '--runs', '2', '--perception', 'original', '--images', 'none', '--set',
        'clouds=stratus', '--set', 'rain=95', '--set', 'duration=2', '--set', 'heading=25',
        '--set', 'cross_track=2', '--spec', 'near=always(abs(cte) <= 2.05)', '--out', 'c',
        cwd=folder,
    )
    assert (done.returncode, done.stderr) == (1, '')
    return folder




def exchange_bags(experiment: Path) -> None:
    for bag in (experiment / 'far').glob('*-0*'):
        shutil.rmtree(bag)
        shutil.copytree(experiment / 'near' / bag.name, bag)


def hidden(experiment: Path) -> None:
    """A stray recording does not make a bag of an arm."""
    (experiment / 'far' / 'x.mcap').touch()
    for bag in (experiment / 'far').glob('*-0*'):
        shutil.rmtree(bag)
    shutil.rmtree(experiment / 'far' / 'logs')


def exchange(experiment: Path) -> None:
    (experiment / 'near').rename(experiment / 'other')
    (experiment / 'far').rename(experiment / 'near')
    (experiment / 'other').rename(experiment / 'far')


@pytest.mark.parametrize(('change', 'says'), [
    pytest.param(
        exchange, 'near: is arm far of its experiment', marks=pytest.mark.nightly,
    ),
    (lambda experiment: shutil.rmtree(experiment / 'far'), 'far: is an arm of the '),
    (lambda experiment: (experiment / 'far' / 'campaign.db').unlink(), 'far: is an arm of the '),
    (hidden, 'far/halton_time_of_day-s0-00000: is missing'),
    (exchange_bags, 'far/halton_time_of_day-s0-00001: its cross_track_m is 0.0, the row has 4'),
])
def test_doctor_given_arms_that_are_exchanged_or_gone_then_it_says_so(
    folder, tmp_path, change, says
):
    experiment = shutil.copytree(folder / 'e', tmp_path / 'e')
    done = taxinet('doctor', experiment)
    assert (done.returncode, 'made from the rest: ' in done.stdout) == (0, True), done.stdout
    change(experiment)
    done = taxinet('doctor', experiment)
    assert done.returncode == 3
    assert f'BAD     {experiment}/{says}' in done.stdout


def test_given_an_experiment_then_its_arms_are_campaigns_of_the_same_scenes_and_go_on(folder):
    done = taxinet('experiment', 'mine.yaml', '--out', 'e', '--resume', '--json', cwd=folder)
    assert done.returncode == 0, done.stderr
    values = json.loads(done.stdout)
    (one,) = values['comparisons']
    assert (one['base'], one['arm'], one['pairs'], one['unpaired']) == ('near', 'far', 4, 0)
    assert one['satisfied']['base_only'] == 4
    assert one['satisfied']['mcnemar_p'] == pytest.approx(2 / 2**4)
    near, far = (read_table(folder / 'e' / arm) for arm in ('near', 'far'))
    assert list(near['index']) == list(far['index']) == [0, 1, 2, 3]
    assert near['time_of_day_h'].nunique() == 4
    assert list(near['time_of_day_h']) == list(far['time_of_day_h'])
    assert list(near['u_time_of_day_h']) == list(far['u_time_of_day_h'])
    assert set(far['cross_track_m']) == {4.0}
    assert set(near['cross_track_m']) == {0.0}
    assert set(near['shadows']) == {True} != set(far['shadows'])
    pairs = pd.read_parquet(folder / 'e' / 'pairs.parquet')
    assert list(pairs['rho_far']) == list(far['rho'])
    # The runs of before were not run again: a bag has a folder, and broken ones are put aside.
    assert not list((folder / 'e').glob('*/*.broken-*'))
    names = {path.name for path in (folder / 'e').iterdir()}
    assert names == {'near', 'far', 'experiment.html', 'experiment.json', 'experiment.png',
                     'change_far.png', 'pairs.parquet'}
    assert 'Experiment mine' in (folder / 'e' / 'experiment.html').read_text()


def test_given_a_used_folder_or_a_mistake_then_one_line_says_so(folder):
    (folder / 'bad.yaml').write_text(EXPERIMENT.replace('runs: 4', 'runs: four'))
    for words, says in (
        (('experiment', 'mine.yaml', '--out', 'e'), 'already exists'),
        (('experiment', 'bad.yaml'), 'bad.yaml: runs: expected a whole number, 1 or more'),
        (('experiment', 'mine.yaml', '--resume'), '--resume: name the experiment to continue with'),
        (('localize', 'e'), 'not a campaign'),
        (('gate', 'c', '--min-satisfaction', '86'), 'a share'),
        (('gate', 'c', '--min-satisfaction', '0.5', '--inconclusive', 'maybe'), 'unknown; known'),
        (('gate', 'c', '--min-satisfaction', '0.5', '--junit', 'no/x.xml'), 'no such folder'),
    ):
        done = taxinet(*words, cwd=folder)
        assert done.returncode == 2, words
        assert done.stderr.startswith('taxinet: error: ')
        assert says in done.stderr
        assert done.stderr.count('\n') == 1


@pytest.mark.nightly
def test_given_failed_runs_with_bags_then_they_come_out_as_recorded_to_the_last_bit(folder):
    with begun(
        'localize', 'c', '--with', 'truth', '--out', 'l', cwd=folder, stderr=subprocess.PIPE
    ) as process:
        trials = folder / 'l' / RECORD_NAME
        wait_for(lambda: trials.exists() and trials.stat().st_size and read_record(
            trials).get('trial'))
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate()
    assert stderr == ''
    assert process.returncode in (0, 130)
    assert ('run it again to continue' in stdout) is (process.returncode == 130)
    done = taxinet('localize', 'c', '--with', 'truth', '--out', 'l', '--json', cwd=folder)
    assert done.returncode == 0, done.stderr
    values = json.loads(done.stdout)
    assert (values['counted'], values['complete']) == (2, True)
    assert (values['not_reproduced'], values['scenes_from_record']) == ([], 0)
    frame = pd.read_parquet(folder / 'l' / 'localize.parquet')
    assert list(frame['rho']) == list(read_table(folder / 'c')['rho'])
    assert list(frame['rho']) == list(frame['rho_as_recorded'])
    assert list(frame['scene_exact']) == [True, True]
    assert len(read_record(trials)['trial']) == 2 * 2
    assert taxinet('doctor', 'l', cwd=folder).returncode == 0
    worst = frame.loc[frame['rho'].idxmin(), 'run_id']
    page = (folder / 'l' / 'localize.html').read_text()
    first_screen, _, _ = page.partition('<section id="section-')
    assert re.search(rf'<h3>The worst run, [^<]*: <a href="#run={worst}">', first_screen)
    assert 'class="worst-path"' in first_screen
    whole = trials.read_bytes()
    trials.write_bytes(whole.replace(b'as-recorded', b'as-recorder'))
    done = taxinet('doctor', 'l', cwd=folder)
    trials.write_bytes(whole)
    assert (done.returncode, 'campaign.db: damaged' in done.stdout) == (3, True)


def test_given_a_campaign_then_the_gate_exits_with_what_it_proves(folder):
    for words, code in (
        (('--min-satisfaction', '0.9'), 1),
        (('--max-off-runway', '0.5'), 3),
        (('--max-off-runway', '0.5', '--inconclusive', 'fail'), 1),
        (('--max-off-runway', '0.5', '--inconclusive', 'pass', '--junit', 'gate.xml'), 0),
        (('--max-off-runway', '1'), 0),
    ):
        done = taxinet('gate', 'c', *words, cwd=folder)
        assert (done.returncode, done.stderr) == (code, ''), words
        assert 'satisfied' in done.stdout or 'off the runway' in done.stdout
    suite = ElementTree.parse(folder / 'gate.xml').getroot()[0]
    assert (suite.get('name'), suite.get('tests'), suite.get('skipped')) == ('c', '2', '1')
    told = {one.get('name'): one.get('value') for one in suite.iter('property')}
    assert told['table'] == 'gate-runs.parquet'
    assert sum(name.startswith('run ') for name in told) == 2
    done = taxinet('analyze', 'gate-runs.parquet', cwd=folder)
    assert done.stdout.startswith('2 runs of s_falsif'), done.stderr
