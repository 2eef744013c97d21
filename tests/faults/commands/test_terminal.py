"""Ctrl-C on a terminal: every process of the foreground group gets it at once.

``pytest --count 20 tests/faults/commands/test_terminal.py`` tries each case twenty times.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import psutil
import pytest
from command_process import Terminal, on_terminal
from graph_runs import grown, once, request, run, steps_in
from process_table import children, gone
from waiting import wait_for

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.reader import read_info
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.nodes.graph.runner import GraphOptions, process_graph
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.table import read_table

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

CTRL_C = b'\x03'
NODES = Path(sys.prefix, 'lib', 'taxinet_ros')
ALL = (
    'simulator', 'ground_truth_perception', 'steering_controller', 'mtl_monitor', 'recorder',
    'scenario_sampler',
)
RUN = ('program:=nominal', 'runs:=3', 'set:=["duration=600"]')
TAXINET = str(Path(sys.executable).with_name('taxinet'))
PACKAGE = Path(__file__).parents[3] / 'examples' / 'my_perception_package'
PERCEPTION = PACKAGE / 'my_perception_package' / 'perception.py'
DEAF = """
import runpy, signal, subprocess, sys
every = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
signal.pthread_sigmask(signal.SIG_BLOCK, every)
subprocess.Popen(['sleep', '3600'], start_new_session=True)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name='__main__')
"""
GROUP = """
import json, signal, subprocess, sys
processes = [subprocess.Popen(words) for words in json.loads(sys.argv[1])]
signal.signal(signal.SIGINT, lambda *_: None)
print('codes', [process.wait() for process in processes], flush=True)
"""


class Place(NamedTuple):
    """Where a campaign and its bags go."""

    table: Path
    bag: Path


def node(name: str, *parameters: str) -> list[str]:
    options = [part for word in parameters for part in ('-p', word)]
    return [str(NODES / name), *(['--ros-args', *options] if options else [])]


def environment(domain: int) -> dict[str, str]:
    return {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'AMENT_PREFIX_PATH': sys.prefix}


def group(folder: Path) -> tuple[list[str], Place]:
    """Six nodes, started one by one."""
    out = f'out:={folder}/c'
    parameters = {'recorder': [out], 'scenario_sampler': [*RUN, out]}
    nodes = [node(name, *parameters.get(name, ())) for name in ALL]
    return (
        [sys.executable, '-c', GROUP, json.dumps(nodes)], Place(folder / 'c', folder / 'c/c-00000')
    )


def ended(terminal: Terminal, pids: list[int]) -> None:
    """Wait until a group has ended; none of it may have been aborted or have complained."""
    wait_for(lambda: terminal.process.poll() is not None and all(map(gone, pids)))
    terminal.close()
    for word in ('Traceback', 'terminate called', 'FATAL', 'exit code -'):
        assert word not in terminal.shown, terminal.shown


def codes(terminal: Terminal) -> list[int]:
    (found,) = re.findall(r'codes (\[.*\])', terminal.shown)
    return json.loads(found)


def check_interrupted(place: Place) -> None:
    """The run is INTERRUPTED, and its bag is whole up to the last step."""
    assert list(read_table(place.table)['outcome']) == ['INTERRUPTED']
    assert read_info(place.bag).complete
    assert check_bag(place.bag).findings == ()
    (row,) = read_campaign(place.table).rows
    assert steps_in(place.bag) == list(range(row.steps))


@pytest.mark.parametrize('presses', [1, 2])
def test_r3_given_interrupts_of_a_whole_group_then_the_bag_is_closed_and_all_end(
    presses, tmp_path
):
    words, place = group(tmp_path)
    with own_domain() as domain, on_terminal(
        *words, cwd=tmp_path, env=environment(domain)
    ) as terminal:
        wait_for(lambda: grown(place.bag))
        pids = [*children(terminal.process.pid, '')]
        terminal.press(*[CTRL_C] * presses)
        ended(terminal, pids)
    assert len(pids) == 6
    if presses == 1:
        check_interrupted(place)
        assert codes(terminal) == [0, 0, 0, 0, 0, 130]
    else:  # Two that come as one are one.
        assert set(codes(terminal)) <= {0, 130}
        steps = steps_in(place.bag)
        assert steps == list(range(len(steps)))


@contextlib.contextmanager
def standing(folder: Path, *words: str) -> Iterator[tuple[Terminal, list[int], Place]]:
    """A standing graph amid a run, every process that it has started, and where it all goes."""
    alone = {name: word for name, word in os.environ.items() if name != 'ROS_DOMAIN_ID'}
    with on_terminal(
        TAXINET, 'up', *words, '--out', 'up', cwd=folder, env={**alone, 'COLUMNS': '200'},
    ) as terminal:
        wait_for(lambda: 'ready: ' in terminal.shown)
        domain = int(re.findall(r'ROS domain (\d+)', terminal.shown)[0])
        sampler = node('scenario_sampler', *RUN, f'out:={folder}/table')
        place = Place(folder / 'table', folder / 'up' / 'table-00000')
        with on_terminal(*sampler, cwd=folder, env=environment(domain)) as sampling:
            wait_for(lambda: grown(place.bag))
            started = psutil.Process(terminal.process.pid).children(recursive=True)
            yield terminal, [process.pid for process in started], place
            wait_for(lambda: sampling.process.poll() is not None)


ENDS = {
    'once': (lambda terminal: terminal.press(CTRL_C), 130),
    'twice': (lambda terminal: terminal.press(CTRL_C, CTRL_C), 130),
    'closed': (lambda terminal: terminal.close(), 129),
}


@pytest.mark.parametrize('end', ENDS)
def test_r3_given_an_end_of_a_standing_graph_then_all_end_even_a_node_that_hears_nothing(
    end, tmp_path
):
    make_end, code = ENDS[end]
    (tmp_path / 'deaf.py').write_text(DEAF)
    command = shlex.join([sys.executable, 'deaf.py', str(PERCEPTION)])
    deaf = end == 'once'
    perception = ('--perception', f'cmd:{command}') if deaf else ('--perception', 'truth')
    with standing(tmp_path, *perception) as (terminal, pids, place):
        make_end(terminal)
        ended(terminal, pids)
        assert terminal.process.wait() == code
    assert len(pids) == (7 if deaf else 5)
    if end == 'twice':  # two that do not come as one wait for nothing
        steps = steps_in(place.bag)
        assert steps == list(range(len(steps)))
    else:
        check_interrupted(place)


def test_r5_given_a_cancelled_run_then_its_bag_ends_on_a_whole_step(tmp_path):
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    with (
        process_graph(options, tmp_path / 'logs') as graph,
        once(lambda: graph.seq > 20, graph.interrupt),
    ):
        (result,) = run(graph, request())
    assert result.outcome is Outcome.INTERRUPTED
    assert steps_in(tmp_path / 'run') == list(range(result.last_seq + 1))
    assert check_bag(tmp_path / 'run').findings == ()
