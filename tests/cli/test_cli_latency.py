"""``--latency`` on the command line: recorded, compared, obeyed by what runs a run again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from taxinet_process import taxinet

from taxinet_ros.campaign.shrink_options import make_shrink_options
from taxinet_ros.campaign.shrinking import Shrinking
from taxinet_ros.campaign.table import read_table
from taxinet_ros.nodes.graph import campaign_graph
from taxinet_ros.nodes.names import PARTICIPANTS

pytestmark = pytest.mark.ros

LATE = ('--latency', 'perception=normal(0.9,0.3)', '--latency', 'controller=0.1')
WORDS = 'latency perception=normal(0.9,0.3) controller=0.1'
SCENES = ('--perception', 'truth', '--set', 'duration=4', '--set', 'cross_track=8',
          '--spec', 'near=always[3 s:inf](abs(cte) <= 1.5)')


@pytest.fixture(scope='module')
def folder(tmp_path_factory) -> Path:
    """A search with latency, of which every run fails."""
    folder = tmp_path_factory.mktemp('late')
    done = taxinet('falsify', 'nominal', *SCENES, *LATE, '--runs', '3', '--sampler', 'random',
                   '--images', 'none', '--out', 's', cwd=folder)
    assert done.returncode == 1, done.stdout + done.stderr
    assert WORDS in done.stdout.splitlines()[0]
    return folder


def test_r5_given_a_latency_then_facts_rows_and_bag_info_say_it(folder):
    assert json.loads((folder / 's' / 'campaign.json').read_text())['timing'] == WORDS
    assert set(read_table(folder / 's')['timing']) == {WORDS}
    done = taxinet('bag', 'info', 's/nominal-s0-00001', cwd=folder)
    assert f'timing     {WORDS}' in done.stdout.splitlines()


def test_r5_given_another_number_of_workers_then_the_rows_are_the_same(folder):
    done = taxinet('falsify', 'nominal', *SCENES, *LATE, '--runs', '3', '--sampler', 'random',
                   '--images', 'none', '--workers', '2', '--out', 'w', cwd=folder)
    assert done.returncode == 1, done.stdout + done.stderr
    one, two = (read_table(folder / name).set_index('index')['rho_near'] for name in ('s', 'w'))
    assert len(set(one)) == 3
    assert one.sort_index().equals(two.sort_index())


def test_r5_given_another_latency_then_resume_refuses_it_by_name(folder):
    done = taxinet('falsify', 'nominal', *SCENES, *LATE[:2], '--runs', '3', '--sampler', 'random',
                   '--images', 'none', '--resume', '--out', 's', cwd=folder)
    assert done.returncode == 2
    assert f's was begun with timing "{WORDS}", not' in done.stderr


def test_r5_given_a_run_with_latency_when_run_again_then_it_is_the_same_to_the_bit(folder):
    done = taxinet('run', '--from', 's/nominal-s0-00002', '--out', 'again', cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert WORDS in done.stdout.splitlines()[0]


@pytest.mark.parametrize(('words', 'says'), [
    (('--from', 's/nominal-s0-00002', '--latency', 'perception=1'),
     '--from: the bag already says --latency'),
    (('nominal', '--latency', 'camera=1'), '--latency camera=1: expected NAME=LATENCY'),
])
def test_r5_given_a_latency_that_cannot_be_then_one_line_says_so(folder, words, says):
    done = taxinet('run', *words, '--out', 'never', cwd=folder)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert says in done.stderr
    assert not (folder / 'never').exists()


def test_r5_given_failures_with_latency_when_localized_then_the_control_fails_as_recorded(folder):
    done = taxinet('localize', 's', '--with', 'truth', '--out', 'whose', cwd=folder)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    trials = [json.loads(line) for line in (folder / 'whose' / 'trials.jsonl').open()]
    control = {t['trial']['run_id']: t['trial'] for t in trials
               if t['event'] == 'trial' and t['trial']['word'] == 'as-recorded'}
    rows = read_table(folder / 's').set_index('run_id')
    assert len(control) == 3
    for name, trial in control.items():
        assert trial['rho_upper'] == rows.loc[name, 'rho_near']


def test_r5_given_a_failed_run_when_shrunk_then_every_run_has_its_draws(folder):
    options = make_shrink_options(
        folder / 's' / 'nominal-s0-00001', perception=None, specs=(), nominal=(), runs=100,
        workers=1, out=folder / 'small', resume=False, images='none',
    )
    assert options.campaign.timing.words == f'{WORDS} draws=0.1'
    assert campaign_graph(options.campaign, '').timing == options.campaign.timing
    with Shrinking(options, PARTICIPANTS) as shrinking:
        assert shrinking.next() is not None
    facts = json.loads((folder / 'small' / 'campaign.json').read_text())
    assert facts['timing'] == f'{WORDS} draws=0.1'
