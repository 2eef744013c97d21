"""``tx.falsify``: the search of the command line, with closed loops for graphs."""

from __future__ import annotations

import pytest

import taxinet_ros as tx
from taxinet_ros.trials.campaign import exit_code
from taxinet_ros.trials.engine import Engine, run_search
from taxinet_ros.trials.options import make_options
from taxinet_ros.trials.record.facts import recorded_system
from taxinet_ros.trials.search import make_search
from taxinet_ros.trials.worker_pool import WorkerPool

SETTINGS = {'duration': 4, 'cross_track': 3}
PER_MACHINE = ['bag', 'wall_s', 'real_time_factor']


def search(out, **asked):
    with pytest.warns(UserWarning, match='ends at 10 s, after the run of 4 s'):
        return tx.falsify(
            's_falsif', perception='truth', sampler='random', settings=SETTINGS, out=out, **asked
        )


@pytest.mark.nightly
@pytest.mark.ros
def test_given_a_search_then_its_table_is_that_of_graphs(tmp_path):
    from taxinet_ros.nodes.graph.runner import campaign_graph
    from taxinet_ros.nodes.graph.worker import worker_command
    from taxinet_ros.nodes.interface import PARTICIPANTS

    found = search(tmp_path / 'loops', runs=3)
    campaign = make_options(
        program='s_falsif', runs=3, seed=0, perception='truth', specs=(), out=tmp_path / 'graphs',
        settings=[f'{name}={value}' for name, value in SETTINGS.items()], processes=False,
        images='none',
    )
    options = make_search(campaign, sampler='random')
    with Engine(options, PARTICIPANTS) as graphs:
        command = worker_command(campaign_graph(
            campaign, recorded_system(campaign, graphs.book.facts)
        ))
        with WorkerPool(command, 1, campaign.out / 'logs') as pool:
            run_search(graphs, pool)
    assert exit_code(graphs.summary) in (0, 1)
    there = tx.open_campaign(campaign.out)
    assert len(found.rows) == len(there.rows) == 3
    assert found.rows.drop(columns=PER_MACHINE).equals(there.rows.drop(columns=PER_MACHINE))
    assert found.rows['bag'].eq('').all()
    assert there.rows['bag'].ne('').all()
    assert (there.facts['engine'], found.facts['engine']) == ('graph', 'loop')
    assert {**there.facts, 'bags': False, 'engine': 'loop'} == found.facts


@pytest.mark.nightly
def test_given_more_runs_and_workers_when_resumed_then_the_table_is_that_of_one_sitting(
    tmp_path, capsys
):
    whole = search(tmp_path / 'whole', runs=4)
    search(tmp_path / 'parts', runs=2)
    assert capsys.readouterr().err == '', 'neither a terminal nor a notebook'
    parts = search(tmp_path / 'parts', runs=4, workers=2, resume=True, progress=True)
    lines = capsys.readouterr().err.split('\r')[1:]
    assert [line[:11] for line in lines] == ['3 of 4 runs', '4 of 4 runs']
    assert len(whole.rows) == 4
    assert parts.rows.drop(columns=PER_MACHINE).equals(whole.rows.drop(columns=PER_MACHINE))


def test_given_a_search_by_likelihood_then_its_campaign_has_the_likeliest_failure(tmp_path):
    program = tmp_path / 'biased.scenic'
    program.write_text(
        "model runway_world\nego = new Plane at (0, 400)\nparam duration_s = 4\n"
        "param 'steering_bias_deg@1' = Normal(0, 2)\nparam 'steering_bias_deg@2' = Normal(0, 2)\n"
    )
    found = tx.falsify(
        program, sampler='stress', runs=12, perception='truth', out=tmp_path / 'out',
        specs='near=always(abs(cte) <= 0.1)',
    )
    likeliest = found.likeliest_failure
    assert list(likeliest.deviations) == ['steering_bias_deg@1', 'steering_bias_deg@2']
    assert 0 < likeliest.sigma < 3
    assert likeliest.log_likelihood == -likeliest.sigma**2 / 2
    assert likeliest.row.run_id in {each.run_id for each in found.counterexamples}
    satisfied = tx.falsify(
        program, sampler='stress', runs=2, perception='truth', out=tmp_path / 'satisfied',
        specs='near=always(abs(cte) <= 9)',
    )
    assert satisfied.likeliest_failure is None


def test_given_late_answers_then_a_search_drives_as_single_runs_do(tmp_path):
    late = {'latency': 'perception=0.5', 'rates': 'cte=3', 'stop_on': 'violated'}
    specs = ['phi_eventually', 'soon=always[3:4](cte <= 9)']
    found = search(tmp_path / 'late', runs=1, specs=specs, **late)
    at_once = search(tmp_path / 'at-once', runs=1, specs=specs)
    assert found.rows['rho_soon'][0] != at_once.rows['rho_soon'][0]
    assert (found.facts['rates'], found.facts['timing']) == (
        ['cte=3'], 'latency perception=0.5'
    )


def test_given_a_function_that_fails_then_its_runs_are_infrastructure_errors(tmp_path):
    file = tmp_path / 'eyes.py'
    file.write_text('def look(frame):\n    raise ValueError("blind")\n')
    found = tx.falsify(
        's_falsif', perception=f'{file}:look', runs=1, sampler='random', specs='phi_always',
        settings=SETTINGS, out=tmp_path / 'campaign',
    )
    [row] = found.rows.to_dict('records')
    assert (row['outcome'], row['kind']) == ('INFRA_ERROR', 'node_error')
    assert 'ValueError: blind' in row['detail']


@pytest.mark.parametrize(('asked', 'words'), [
    ({'perception': 'external'}, 'is a node of a graph, but this command'),
    ({'controller': 'cmd:steer'}, 'is a node of a graph, but this command'),
    ({'sampler': 'luck'}, 'luck'),
    ({'sampler': 'ce', 'sampler_options': {'flor': 0.3}}, 'flor'),
    ({'settings': {'fog': 1}}, 'fog'),
    ({'until': 'tired'}, 'tired'),
    ({'workers': 0}, 'workers'),
    ({'specs': ()}, 'no requirement'),
    ({'resume': True}, 'nothing to resume'),
    ({'bounds': 'he=-1:1'}, 'bounds? he: has no effect'),
    ({'latency': 'eyes=1'}, 'latency eyes=1'),
    ({'world': 'moon'}, "world: 'moon' is unknown"),
])
def test_given_what_cannot_be_then_one_line_says_so_and_nothing_is_written(asked, words, tmp_path):
    with pytest.raises(tx.UsageError, match=words):
        tx.falsify('s_falsif', out=tmp_path / 'out', **asked)
    assert not (tmp_path / 'out').exists()
