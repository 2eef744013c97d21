"""The bag of a real graph: everything is in it, and it withstands a kill and a full disk."""

import os
import signal
import subprocess
import sys
import threading

import pytest
from campaign_records import write_campaign
from graph_runs import request, run
from waiting import wait_for

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.reader import read_attachment, read_info
from taxinet_ros.bag.rewrite.recovery import recover
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.topics import (
    COMMAND,
    ESTIMATE,
    IMAGE,
    NODE_STATUS,
    ODOMETRY,
    ONCE,
    ROBUSTNESS,
    RUN_STATUS,
    SCENARIO,
    TF,
    TF_STATIC,
    TRUTH,
    VERDICT,
)
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph, process_graph

pytestmark = pytest.mark.ros

PROGRAM = 'ego = new Plane  # the whole program\n'


def short(run_id: str, duration: float) -> RunRequest:
    return request(run_id, duration, program='mine', judging=Judging(specs=('on_runway',)))


def wrong(bag) -> dict[str, list[str]]:
    """What the doctor finds, by check."""
    return {
        check.name: [finding.what for finding in check.findings]
        for check in check_bag(bag).checks if check.findings
    }


def test_given_the_table_of_the_graph_then_the_names_for_readers_without_ros_are_its():
    names = {
        topic.name.lstrip('/'): topic.recorded
        for topic in (*interface.TOPICS, *interface.TRANSFORMS)
    }
    told = {SCENARIO, NODE_STATUS, IMAGE, ODOMETRY, TRUTH, ESTIMATE, COMMAND, ROBUSTNESS,
            VERDICT, RUN_STATUS, TF, TF_STATIC}
    assert told <= set(names)
    assert {n for n, r in names.items() if r in (interface.PER_RUN, interface.PER_NODE)} == ONCE
    recorded = [topic for topic in interface.TOPICS if topic.recorded]
    assert recorded[-1] is interface.RUN_STATUS, 'it ends the bag'


def test_given_a_disk_that_fills_up_then_that_run_is_a_broken_bag_and_the_next_is_sound(
    tmp_path, monkeypatch
):
    facts = {'program': 'mine.scenic', 'program_text': PROGRAM}
    write_campaign(tmp_path, facts=facts)
    calls = {'n': 0}

    def disk(descriptor: int) -> os.statvfs_result:
        calls['n'] += 1
        blocks = 300 if calls['n'] == 16 else 10**9
        return os.statvfs_result((4096, 4096, blocks, blocks, blocks, 1, 1, 1, 0, 255))

    monkeypatch.setattr(os, 'fstatvfs', disk)
    with composed_graph(GraphOptions(perception='truth', out=tmp_path, images='none')) as graph:
        full, after = run(graph, short('full', 30.0), short('after', 1.0))
    assert (full.outcome, full.kind, full.who) == (
        Outcome.INFRA_ERROR, 'bag', interface.RECORDER
    )
    assert 'No space left on device' in full.detail
    assert full.rho == {}
    info = read_info(tmp_path / 'full')
    assert not info.complete
    assert info.counts['/clock'] < 16, 'nothing is written after the first failure'
    assert after.outcome is Outcome.PASS
    assert wrong(tmp_path / 'after') == {}
    assert read_attachment(tmp_path / 'after', 'mine.scenic').decode() == PROGRAM
    words = read_info(tmp_path / 'after').metadata['taxinet_outcome']
    assert (words['perception'], words['outcome'], words['steps']) == ('truth', 'PASS', '11')


@pytest.mark.nightly
def test_given_a_recorder_killed_in_a_graph_of_processes_then_whole_steps_stay(tmp_path):
    with process_graph(GraphOptions(perception='truth', out=tmp_path), tmp_path / 'logs') as graph:
        victim = next(child for child in graph.children if child.name == interface.RECORDER)

        def kill_once_recorded() -> None:
            bag = tmp_path / 'run' / 'run_0.mcap'
            wait_for(lambda: bag.exists() and bag.stat().st_size > 700_000)
            os.kill(victim.process.pid, signal.SIGKILL)

        threading.Thread(target=kill_once_recorded, daemon=True).start()
        (result,) = run(graph, short('run', 600.0))
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'died')
    outcome = recover(tmp_path / 'run', tmp_path / 'saved')
    counts = outcome.bag.message_counts
    steps = counts['/clock']
    assert steps >= 3
    whole = min(n for name, n in counts.items() if name.strip('/') not in ONCE)
    assert steps - 1 <= whole <= steps
    assert wrong(tmp_path / 'saved') == {
        'lockstep': ['0 messages, not 1; the bag ends before the run does'],
    }
    facts = open_recording(tmp_path / 'saved').facts
    assert facts is not None
    assert facts.outcome == ''


LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
from taxinet_ros.cli.main import main
sys.argv[0] = 'taxinet'
main()
"""


@pytest.mark.nightly
def test_given_files_that_may_not_grow_when_taxinet_runs_then_it_says_so_and_ends_with_four(
    tmp_path,
):
    words = ['run', 'nominal', '--perception', 'truth', '--set', 'duration=5', '--images', 'none']
    done = subprocess.run(
        [sys.executable, '-c', LIMITED, *words, '--out', str(tmp_path / 'c')],
        capture_output=True, text=True, check=False,
    )
    assert done.returncode == 4, done.stderr
    assert 'INFRA_ERROR bag recorder: BagWriteError' in done.stdout
    assert 'cannot write: [Errno 27] File too large' in done.stdout
    assert 'Traceback' not in done.stderr
