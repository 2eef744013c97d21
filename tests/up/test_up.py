"""A standing graph runs what a sampler elsewhere asks for; it is fixed, named and ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from process_table import gone
from standing import TAXINET, Standing, ended, environment, standing, taxinet
from waiting import wait_for

from taxinet_ros.bag.check.compare import compare_bags
from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.reader import read_info, read_messages
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.trials.doctor import examine
from taxinet_ros.trials.record.table import read_table

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

NODES = ('simulator', *PARTICIPANTS)
SHORT, LONG = 'set:=["duration=1"]', 'set:=["duration=600"]'
GOLDEN = Path(__file__).parents[2] / 'bags' / 'golden' / 'truth-nominal'
ENOUGH = 'set:=["duration=40"]'


@pytest.fixture(scope='module')
def graph(tmp_path_factory):
    with standing(tmp_path_factory.mktemp('up')) as graph:
        yield graph
        assert graph.ask_to_end() == 130
    assert graph.errors == ''
    assert 'publishes /clock' not in graph.printed


def outcomes(graph: Standing, seed: int) -> list[tuple[str, str, str]]:
    table = read_table(graph.folder / f'table-{seed}')[['outcome', 'kind', 'who']].astype(object)
    return list(table.where(table.notna(), '').itertuples(index=False, name=None))


def test_the_table_and_the_last_line_name_the_folder_in_which_the_recorder_writes(graph):
    code, output, errors = ended(graph.sampler('runs:=1', SHORT, seed=2))
    assert code == 0, output + errors
    assert f'bags: {graph.out}/<run>/' in errors
    folder = graph.folder / 'table-2'
    (bag,) = read_table(folder)['bag']
    assert bag == str(graph.out / 'table-2-00000')
    found = examine(folder)
    assert (found.findings, found.looked_at['bags']) == ([], 1)


def test_given_the_same_scenes_once_more_then_their_bags_lie_beside_the_first(graph):
    for table in ('once', 'again'):
        code, output, errors = ended(graph.sampler('runs:=1', SHORT, seed=1, table=table))
        assert code == 0, output + errors
    one, other = (graph.out / f'{name}-00000' for name in ('once', 'again'))
    compared = compare_bags(one, other)
    assert compared
    assert all(topic.equal for topic in compared)


def test_a_replay_beside_the_graph_is_no_run_of_it_and_is_not_recorded(graph):
    player = taxinet(
        'node', 'bag_player', '--ros-args', '-p', f'bag:={GOLDEN}', '-p', 'rate:=100.0',
        '-p', 'wait_for:=["scenario", "node_status", "run_status"]', '-p', 'exclude:=["/clock"]',
        cwd=graph.folder, domain=graph.domain,
    )
    code, output, errors = ended(player)
    assert code == 0, output + errors
    code, output, errors = ended(graph.sampler('runs:=1', SHORT, seed=4))
    assert code == 0, output + errors
    graph.wait_to_say('run table-4-00000: PASS')
    assert GOLDEN.name not in graph.printed
    assert not (graph.out / GOLDEN.name).exists()


@pytest.mark.parametrize(
    ('who', 'module'),
    [('perception', 'ground_truth_perception'), ('simulator', 'simulator')],
)
def test_r6_given_a_node_killed_amid_a_run_then_the_sampler_goes_on_and_the_next_run_is_whole(
    graph, who, module
):
    seed = 10 + NODES.index(who)
    sampler = graph.sampler('runs:=2', ENOUGH, 'silence_timeout:=3000.0', seed=seed)
    graph.wait_for_run(seed, sampler)
    before = graph.pids()
    os.kill(before[module], signal.SIGKILL)
    code, output, errors = ended(sampler)
    assert code == 4, output + errors
    # What the dead leave behind lingers for some 20 s; the run waits, and the new one is in it.
    assert outcomes(graph, seed) == [('INFRA_ERROR', 'died', who), ('PASS', '', '')]
    graph.wait_to_say(f'{who} died: killed by SIGKILL; restarted (1 of 3 in 60 s)')
    after = graph.pids()
    assert after.keys() == before.keys()
    assert {name for name in before if after[name] != before[name]} == {module}
    bag = graph.out / f'table-{seed}-00001'
    assert read_info(bag).complete
    found = [check.findings for check in check_bag(bag).checks if check.findings]
    assert not found


def test_given_ctrl_c_amid_a_run_then_the_run_the_bag_and_the_graph_end_in_order(tmp_path):
    with standing(tmp_path) as graph:
        pids = graph.pids()
        assert len(pids) == len(NODES)
        sampler = graph.sampler('runs:=2', LONG, seed=3)
        graph.wait_for_run(3, sampler)
        assert graph.ask_to_end() == 130
        code, output, errors = ended(sampler)
    assert code == 130, output + errors
    assert outcomes(graph, 3) == [('INTERRUPTED', '', '')]
    bag = graph.out / 'table-3-00000'
    assert (bag / 'metadata.yaml').exists()
    assert {m.topic for m in read_messages(bag)} >= {'/clock', '/run_status'}
    assert graph.printed.splitlines()[-2:] == ['run table-3-00000: INTERRUPTED', 'ended']
    assert graph.errors == ''
    assert all(map(gone, pids.values()))


def test_given_never_and_a_node_that_dies_then_the_graph_ends_with_one_line(tmp_path):
    with standing(tmp_path, '--restart', 'never', '--no-record') as graph:
        pids = graph.pids()
        assert 'recorder' not in pids
        assert "'participants:=[perception,steering_controller,mtl_monitor]'" in graph.printed
        os.kill(pids['steering_controller'], signal.SIGSEGV)
        assert graph.process.wait() == 4
    assert graph.errors == (
        'taxinet: error: steering_controller died: killed by SIGSEGV; '
        'see up/logs/steering_controller.log\n'
    )
    assert all(map(gone, pids.values()))


def test_given_a_node_that_hangs_amid_a_run_then_it_is_started_again(tmp_path):
    with standing(tmp_path) as graph:
        pids = graph.pids()
        sampler = graph.sampler('runs:=1', LONG, seed=5)
        graph.wait_for_run(5, sampler)
        os.kill(pids['mtl_monitor'], signal.SIGSTOP)
        graph.wait_to_say('mtl_monitor is killed: its silence ended the run')
        graph.wait_to_say('mtl_monitor died: killed by SIGKILL; restarted (1 of 3 in 60 s)')
        code, output, errors = ended(sampler)
        assert code == 4, output + errors
    assert outcomes(graph, 5) == [('INFRA_ERROR', 'timeout', 'mtl_monitor')]


def test_given_a_killed_parent_then_a_stopped_node_dies_as_well(tmp_path):
    with standing(tmp_path, '--restart', 'never') as graph:
        pids = graph.pids()
        os.kill(pids['mtl_monitor'], signal.SIGSTOP)
        graph.process.kill()
        wait_for(lambda: all(map(gone, pids.values())), lambda: str(pids))


def in_bash(script: str, cwd: Path) -> list[str]:
    """What a script prints, with ``$taxinet`` and ``$code`` as a shell has it."""
    taxinet = f'{sys.executable} -c "{TAXINET[2]}"'
    script = f'taxinet() {{ exec {taxinet} "$@"; }}\n{script}'
    done = subprocess.run(
        ['bash', '-c', script], cwd=cwd, env=environment(), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )
    return done.stdout.splitlines()


def test_given_sigterm_then_a_shell_sees_143_and_no_bag_folder_is_left_by_a_mistake(tmp_path):
    lines = in_bash(
        ': > said; taxinet up --perception truth --out up --no-record > said & pid=$!\n'
        'until grep -q ^ready: said || ! kill -0 $pid 2> /dev/null; do sleep 0.1; done\n'
        'kill -TERM $pid; wait $pid; echo "code $?"\n'
        'tail -n 1 said\n'
        '(taxinet up --out up); echo "code $?"\n'
        '(taxinet up --perception gone.safetensors --out other); echo "code $?"\n'
        'ls',
        tmp_path,
    )
    assert lines[:2] == ['code 143', 'ended']
    assert lines[2].startswith('taxinet: error: out up: already exists')
    assert lines[3] == 'code 2'
    assert lines[4].startswith('taxinet: error: ')
    assert 'gone.safetensors' in lines[4]
    assert lines[5:] == ['code 2', 'said', 'up']
