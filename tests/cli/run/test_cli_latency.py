"""``--latency`` on the command line: recorded, compared, obeyed by what runs a run again."""

from __future__ import annotations

from pathlib import Path

import pytest
from taxinet_process import taxinet

from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.cli.bag.rerun import check_options
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.perception.perception import GroundTruth
from taxinet_ros.core.topics import PARTICIPANTS
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, read_record
from taxinet_ros.nodes.graph.runner import campaign_graph
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.options import make_options
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.facts import read_facts
from taxinet_ros.trials.record.resumption import check_same_campaign
from taxinet_ros.trials.record.table import read_table
from taxinet_ros.trials.shrink.shrinking import make_shrinking

pytestmark = pytest.mark.ros

WORDS = 'latency perception=normal(0.9,0.3) controller=0.1'


@pytest.fixture(scope='module')
def folder(tmp_path_factory) -> Path:
    """A search with latency by two workers, of which every run fails."""
    folder = tmp_path_factory.mktemp('late')
    done = taxinet(
        'falsify', 'nominal', '--perception', 'truth', '--set', 'duration=4',
        '--set', 'cross_track=8', '--spec', 'near=always[3 s:inf](abs(cte) <= 1.5)',
        '--latency', 'perception=normal(0.9,0.3)', '--latency', 'controller=0.1', '--runs', '3',
        '--sampler', 'random', '--images', 'none', '--workers', '2', '--out', 's', cwd=folder,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert WORDS in done.stdout.splitlines()[0]
    return folder


@pytest.mark.nightly
def test_r5_given_a_latency_then_facts_rows_and_bag_info_say_it(folder):
    assert read_facts(folder / 's')['timing'] == WORDS
    assert set(read_table(folder / 's')['timing']) == {WORDS}
    done = taxinet('bag', 'info', 's/nominal-s0-00001', cwd=folder)
    assert f'timing     {WORDS}' in done.stdout.splitlines()


def test_r5_given_two_workers_then_every_run_is_that_of_the_loop_in_one_process(folder):
    rows = read_table(folder / 's').set_index('run_id')
    assert len(rows) == len(set(rows['rho_near'])) == 3
    for name, row in rows.iterrows():
        run = open_recording(folder / 's' / str(name)).run
        judged = run_closed_loop(
            run.request.scenario, GroundTruth(), specs=run.request.judging.parsed_specs,
            timing=run.timing, draws=(run.request.seed, run.request.index),
        )
        assert judged.readings[0].lower == row['rho_near']


def test_r5_given_another_latency_then_resume_refuses_it_by_name(folder):
    content = read_campaign(folder / 's')
    facts = content.facts
    check_same_campaign(folder / 's', content, facts)
    for other in ('', 'latency perception=0.9'):
        with pytest.raises(UsageError, match='was begun with timing "latency perception=normal'):
            check_same_campaign(folder / 's', content, {**facts, 'timing': other})


def test_r5_given_a_run_with_latency_when_run_again_then_it_is_the_same_to_the_bit(folder):
    done = taxinet('run', '--from', 's/nominal-s0-00002', '--out', 'again', cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert WORDS in done.stdout.splitlines()[0]


def test_r5_given_a_latency_that_cannot_be_then_one_line_says_so(tmp_path):
    with pytest.raises(UsageError, match=r'^--from: --latency is taken from the bag$'):
        check_options(['bag', 'latency'])
    with pytest.raises(UsageError, match=r'^latency camera=1: expected NAME=LATENCY'):
        make_options(program='nominal', runs=1, seed=0, perception='truth', settings=(), specs=(),
                     out=tmp_path / 'never', processes=False, latency=['camera=1'])


@pytest.mark.nightly
def test_r5_given_failures_with_latency_when_localized_then_the_control_fails_as_recorded(folder):
    done = taxinet('localize', 's', '--with', 'truth', '--out', 'whose', cwd=folder)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    trials = read_record(folder / 'whose' / RECORD_NAME)['trial'].values()
    control = {trial['run_id']: trial['rho_upper'] for trial in trials
               if trial['word'] == 'as-recorded'}
    assert control == read_table(folder / 's').set_index('run_id')['rho_near'].to_dict()


def test_r5_given_a_failed_run_when_shrunk_then_every_run_has_its_draws(folder):
    shrinking = make_shrinking(
        folder / 's' / 'nominal-s0-00001', runs=100, out=folder / 'small'
    )
    campaign = shrinking.campaign
    assert campaign.timing.words == f'{WORDS} draws=0.1'
    assert campaign_graph(campaign, campaign.alone()).timing == campaign.timing
    with Engine(shrinking, PARTICIPANTS) as engine:
        assert engine.next() is not None
    assert read_facts(folder / 'small')['timing'] == f'{WORDS} draws=0.1'
