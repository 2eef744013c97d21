"""The sampler as a program of its own, on nodes that were started separately."""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
from campaign_records import results, write_campaign
from graph_runs import judged_in, on_own_domain, parameters, request, start_node
from rclpy.parameter import Parameter
from waiting import wait_for

from taxinet_ros.bag.reader import read_info
from taxinet_ros.cli.run.search import run_falsify
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import PARTICIPANTS, RECORDER
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.scenario_sampler import StandaloneSampler
from taxinet_ros.trials.options import make_options
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.facts import is_campaign
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS, RunRow
from taxinet_ros.trials.record.table import read_table
from taxinet_ros.trials.search import Search, make_search

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

RUNS = 12
SPEC = 'close=always(abs(cte) <= 0.3)'
SEARCH = (
    'program:=nominal', 'sampler:=ce', 'sampler_options:=["every=1"]', 'seed:=4',
    'set:=["duration=1"]', f'specs:=["{SPEC}"]',
)


class Graph:
    """Nodes, each a process, on one domain; the recorder writes to a folder of its own."""

    def __init__(self, domain: int, bags: Path) -> None:
        self.domain, self.bags = domain, bags
        nodes = ('simulator', 'ground_truth_perception', 'steering_controller', 'mtl_monitor')
        self.nodes = [
            *(start(name, domain) for name in nodes),
            start('recorder', domain, f'out:={bags}', 'images:=none'),
        ]

    def sampler(self, *parameters: str, name: str = 'scenario_sampler') -> subprocess.Popen[str]:
        return start('scenario_sampler', self.domain, *parameters, name=name)


def start(
    executable: str, domain: int, *values: str, name: str = ''
) -> subprocess.Popen[str]:
    renamed = ['-r', f'__node:={name}'] if name else []
    return start_node(executable, domain, *parameters(*values), *renamed)


@pytest.fixture(scope='module')
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    with own_domain() as domain:
        running = Graph(domain, tmp_path_factory.mktemp('bags'))
        try:
            yield running
        finally:
            for node in running.nodes:
                node.terminate()
            ends = [node.communicate()[1] for node in running.nodes]
    assert [node.returncode for node in running.nodes] == [0] * 5, ends


@pytest.fixture(scope='module')
def composed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``taxinet falsify`` makes of the search."""
    out = tmp_path_factory.mktemp('composed') / 'c'
    campaign = make_options(
        program='nominal', runs=RUNS, seed=4, perception='truth', settings=['duration=1'],
        specs=[SPEC], out=out, processes=False, images='none',
    )
    options = make_search(campaign, sampler='ce', sampler_options=['every=1'])
    assert run_falsify(options, quiet=True) == 1
    return out


def ended(sampler: subprocess.Popen[str]) -> tuple[int, list[str]]:
    """Exit code and printed lines."""
    with killing(sampler):
        _, errors = sampler.communicate()
    return sampler.returncode, errors.splitlines()


@contextlib.contextmanager
def killing(process: subprocess.Popen[str]) -> Iterator[None]:
    try:
        yield
    finally:
        process.kill()


def interrupted(out: Path) -> list[RunRow]:
    """Results of the runs that were interrupted, as they are on record."""
    return [row for row in read_campaign(out).rows if row.outcome is Outcome.INTERRUPTED]


def complaint(lines: list[str]) -> str:
    """The one line on what is wrong."""
    (line,) = [line for line in lines if not line.startswith('[INFO]')]
    assert line.startswith('error: ')
    return line


@pytest.fixture(scope='module')
def searched(graph: Graph, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The search on the graph, interrupted in its midst and resumed."""
    out = tmp_path_factory.mktemp('searched') / 'c'
    words = (*SEARCH, f'runs:={RUNS}', f'out:={out}')
    sampler = graph.sampler(*words)
    with killing(sampler):
        wait_for(lambda: results(out) >= 3)
        sampler.send_signal(signal.SIGINT)
        code, lines = ended(sampler)
    assert code == 130, lines
    assert any('interrupted; -p resume:=true -p out:=' in line for line in lines)
    assert 3 <= len(read_table(out)) < RUNS
    code, lines = ended(graph.sampler(*words, 'resume:=true'))
    assert code == 1, lines
    assert 'resuming nominal for failures: up to 12 runs, sampler ce' in lines[0]
    assert any('under the program itself: satisfied' in line for line in lines)
    assert any('learned.json, learned.scenic' in line for line in lines)
    return out


def test_given_nodes_started_one_by_one_then_the_search_is_that_of_falsify(composed, searched):
    named = ['run_id', 'bag', 'retries', *WALL_CLOCK_COLUMNS]
    expected, table = (read_table(out).drop(columns=named) for out in (composed, searched))
    assert len(expected) == RUNS
    assert (expected['weight'].tail(3) != 1).any(), 'nothing was learned, so no answer was needed'
    pd.testing.assert_frame_equal(table, expected)
    learned = [json.loads((out / 'learned.json').read_text()) for out in (composed, searched)]
    assert learned[0]['dimensions'] == learned[1]['dimensions']


def test_given_an_interrupt_and_a_resumption_then_every_run_on_record_has_its_whole_bag(
    graph, searched
):
    table = read_table(searched)
    names = {path.name for path in graph.bags.iterdir() if path.name.startswith('c-')}
    assert set(table['run_id']) <= names
    for run_id in table['run_id']:
        info = read_info(graph.bags / run_id)
        assert info.complete
        assert info.counts['/ground_truth/odom'] == 11
    begun_anew = {name for name in table['run_id'] if name.endswith('.2')}
    assert len(begun_anew) <= 1
    # The interrupted run has a bag of its own, unless it was stopped before it was prepared.
    others = names - set(table['run_id'])
    assert others <= {name.removesuffix('.2') for name in begun_anew}
    assert {row.run_id for row in interrupted(searched) if row.steps} <= others


def test_given_another_perception_than_before_then_the_sampler_stops_and_keeps_nothing(
    graph, searched, tmp_path
):
    out = tmp_path / 'c'
    shutil.copytree(searched, out)
    content = read_campaign(out)
    assert (content.facts['perception'], content.facts['perception_sha256']) == ('truth', '')
    write_campaign(out, content.rows, {**content.facts, 'perception_sha256': 'ab' * 32})
    code, lines = ended(graph.sampler(*SEARCH, 'runs:=13', f'out:={out}', 'resume:=true'))
    assert code == 2, lines
    assert complaint(lines).endswith(
        f'{out} was begun with perception truth (sha256 abababababab…), but the graph has truth; '
        'start the original one, or choose another folder'
    )
    assert len(read_table(out)) == RUNS
    assert results(out) == results(searched)


def test_given_a_sampler_at_work_then_others_are_refused_and_it_can_be_interrupted(graph, tmp_path):
    out = tmp_path / 'first'
    words = ('program:=nominal', 'seed:=9', 'set:=["duration=600"]')
    first = graph.sampler(*words, 'sampler:=ce', f'out:={out}')
    with killing(first):
        wait_for(lambda: (graph.bags / 'first-00000').exists() or first.poll() is not None)
        second = graph.sampler(*words, 'sampler:=ce', f'out:={tmp_path / "second"}')
        third = graph.sampler(*words, f'out:={tmp_path / "third"}', name='by_another_name')
        (code, lines), (code_of_third, lines_of_third) = ended(second), ended(third)
        assert (code, code_of_third) == (4, 4)
        # Which one is said depends on whom discovery finds first; by another name nobody can tell.
        known = ('another sampler drives this graph', 'the simulator is busy')
        assert complaint(lines).removeprefix('error: ').startswith(known)
        assert 'the simulator is busy' in complaint(lines_of_third)
        assert first.poll() is None
        # One that is nearly over would come to its end.
        begun = len(list(graph.bags.iterdir()))
        wait_for(lambda: len(list(graph.bags.iterdir())) > begun)
        first.send_signal(signal.SIGINT)
        code, lines = ended(first)
    assert code == 130, lines
    last = read_table(out).iloc[-1]
    assert last['outcome'] == 'INTERRUPTED'
    assert read_info(graph.bags / last['run_id']).complete


def test_given_a_run_of_the_same_name_as_the_one_before_then_it_is_run_again(tmp_path):
    asked = request('again', 1.0, participants=tuple(set(PARTICIPANTS) - {RECORDER}))
    graph = composed_graph(GraphOptions(perception='truth', out=tmp_path))
    results = judged_in(graph, asked, asked)
    assert results[0].rho == results[1].rho


def test_given_no_simulator_then_one_line_says_so_and_the_search_can_be_resumed(tmp_path):
    out = tmp_path / 'c'
    with own_domain() as domain:
        sampler = start('scenario_sampler', domain, *SEARCH, f'out:={out}', 'server_timeout:=0.1')
        code, lines = ended(sampler)
    assert code == 4, lines
    assert 'simulator: not found within 0.1 s' in complaint(lines)
    assert f'continue with -p resume:=true -p out:={out}' in complaint(lines)
    assert results(out) == 0
    assert is_campaign(out)


BAD = {
    'unknown sampler': ({'sampler': 'luck'}, "sampler 'luck' is unknown; known: random"),
    'unknown option': ({'sampler_options': ['seed=1']}, 'sampler ce: unknown option seed'),
    'option without value': ({'sampler_options': ['every']}, "'every': expected key=value"),
    'unknown rule': ({'until': 'bored'}, 'until bored: expected failures=K'),
    'resume of nothing named': ({'resume': True}, 'resume: name the campaign to continue as out'),
    'no sampler': ({'sampler': '', 'until': 'failures=1'}, 'until: for a sampler only; known: ran'),
    'a gain': ({'set': ['steering.heading_gain=1']}, 'set gains as its parameters'),
    'one formula twice': ({'specs': ['phi_always'] * 2}, 'specs: phi_always is given twice'),
    'negative budget': ({'budget': -1.0}, 'allowed: 0.0..1000000.0'),
    'typo': ({'untill': 'failures=1'}, 'did you mean until?'),
}


def built(given: dict[str, object], *words: str) -> Search | None:
    """Build the node in this process, also with words of its command line; what it is to search."""
    with on_own_domain() as spinning:
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        return StandaloneSampler(
            context=spinning.context, parameter_overrides=overrides,
            cli_args=['--ros-args', *words],
        ).search


@pytest.mark.parametrize('case', BAD)
def test_given_bad_parameters_then_one_line_names_the_parameter(case, tmp_path, monkeypatch):
    changes, words = BAD[case]
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError) as caught:
        built({'sampler': 'ce', **changes})
    assert words in str(caught.value)
    assert '--' not in str(caught.value)
    assert '\n' not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_f8_given_an_empty_list_then_it_is_none_and_participants_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    search = built({'sampler': 'ce'}, '-p', 'specs:=[]', '-p', 'set:=[]')
    assert search is not None
    with pytest.raises(UsageError, match=r'participants: a run needs .*, got only nobody'):
        built({'sampler': 'ce'}, '-p', 'participants:=[]')


def test_s4_given_the_word_program_then_the_programs_sampler_is_taken(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    search = built({'sampler': 'program', 'sampler_options': ['alpha=0.9']})
    assert search is not None
    assert (search.sampler, search.sampler_options) == ('', {'alpha': '0.9'})
    assert search.campaign.runs == 100
    assert built({'sampler': ''}) is None
