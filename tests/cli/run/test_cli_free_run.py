"""``--free`` on the command line: marked, never mixed, refused where verdicts must come again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from taxinet_process import taxinet

from taxinet_ros.analysis.runs.campaign import read_runs, runs_of
from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.options import make_options
from taxinet_ros.trials.past_runs.localisation import make_localize_options
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.resumption import facts_of_graph
from taxinet_ros.trials.record.table import read_table

pytestmark = pytest.mark.ros

WORDS = 'free real_time_factor=10'


@pytest.fixture(scope='module')
def folder(tmp_path_factory) -> Path:
    """A campaign of two free runs, which fail."""
    folder = tmp_path_factory.mktemp('free')
    done = taxinet('run', 'nominal', '--free', '--real-time-factor', '10', '--runs', '2',
                   '--perception', 'truth', '--set', 'duration=3', '--set', 'cross_track=5',
                   '--spec', 'near=always(abs(cte) <= 1.5)', '--images', 'none', '--out', 'f',
                   cwd=folder)
    assert done.returncode == 1, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert f'{WORDS}, separate processes -> f' in lines[0]
    assert any(line.startswith('free runs, which need not come out so again: ') for line in lines)
    return folder / 'f'


@pytest.mark.nightly
def test_r5_given_free_runs_then_rows_facts_and_bag_say_so(folder):
    table = read_table(folder)
    assert list(table['timing']) == [WORDS, WORDS]
    assert list(table['free_frames']) == [31, 31]
    assert (table['free_loop_simulated_median_s'] >= 0.1).all()
    content = read_campaign(folder)
    assert content.facts['timing'] == WORDS
    for row, frame in zip(content.rows, table.to_dict('records'), strict=True):
        assert row.free['unanswered'] == frame['free_unanswered']
    done = taxinet('bag', 'info', 'nominal-s0-00000', cwd=folder)
    assert f'timing     {WORDS}' in done.stdout
    assert ' of 31 frames unanswered, loop ' in done.stdout


def test_r5_given_runs_of_both_kinds_in_one_table_then_no_rate_is_made_of_them(folder):
    assert read_runs(folder).label == f'truth, {WORDS}'
    table = read_table(folder)
    table.loc[0, 'timing'] = ''
    with pytest.raises(UsageError, match='mixes runs with immediate answers and '
                                         'with free real_time_factor=10'):
        runs_of(table, folder)


def test_r5_given_bags_of_free_and_other_runs_then_monitor_marks_them_and_counts_them_apart(folder):
    golden = Path(__file__).parents[3] / 'bags' / 'golden' / 'truth-nominal'
    bags = (*(f'{folder}/nominal-s0-0000{index}' for index in (0, 1)), golden)
    words = ('monitor', *bags, '--spec', 'near=always(abs(cte) <= 1.5)')
    done = taxinet(*words, cwd=folder)
    assert (done.returncode, done.stderr) == (1, '')
    lines = done.stdout.splitlines()
    assert [line.endswith(f'  {WORDS}') for line in lines if '  near  ' in line] == [
        True, True, False]
    assert f'near ({WORDS}): 2 VIOLATED of 2 bags' in done.stdout
    (other,) = [line for line in lines if line.startswith('near (immediate answers')]
    assert ' of 1 bags' in other
    told = json.loads(taxinet(*words, '--json', cwd=folder).stdout)
    assert [bag['timing'] for bag in told['bags']] == [WORDS, WORDS, '']


def test_r5_given_free_runs_then_a_search_or_a_localisation_of_them_is_refused(folder, tmp_path):
    with pytest.raises(UsageError, match='free runs depend on the speed of'):
        make_localize_options(folder, runs=None, words=(), workers=1, out=tmp_path / 'never',
                              perception=None)
    answer = RunResult(outcome=Outcome.PASS, robustness=exact_intervals({'near': 1.0}),
                       timing=WORDS, perception='truth')
    with pytest.raises(UsageError, match=r'^the graph is free-running, but a search needs'):
        facts_of_graph(folder, {'perception': '', 'perception_sha256': '', 'timing': ''}, answer)


@pytest.mark.parametrize(('words', 'says'), [
    ({'real_time_factor': '2'}, 'real_time_factor: has an effect on a free run only'),
    ({'free': True, 'latency': ['perception=0.1']}, 'latency perception=0.1: not in a free run'),
    ({'free': True, 'real_time_factor': '0.01'}, 'real_time_factor 0.01: needs to be within'),
    ({'free': True, 'stop_on': 'violated'}, 'stop_on violated: not in a free run'),
])
def test_r5_given_words_that_have_no_effect_together_then_one_line_says_so(tmp_path, words, says):
    with pytest.raises(UsageError) as raised:
        make_options(**{
            'program': 'nominal', 'runs': 1, 'seed': 0, 'perception': 'truth', 'settings': (),
            'specs': (), 'out': tmp_path / 'never', 'processes': False, **words,
        })
    assert str(raised.value).startswith(says)
