"""Commands under the bench: how soon something is seen of them, and what they say in trouble."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from taxinet_ros.bag.topics import describe_topic, offered_qos
from taxinet_ros.bag.writer import BagWriter
from taxinet_ros.bench.processes import peak_memory, processor_time_ns, wait_for
from taxinet_ros.bench.run import run_subjects
from taxinet_ros.bench.subjects import campaign
from taxinet_ros.bench.subjects.start_up import holds_step
from taxinet_ros.errors import InfraError
from taxinet_ros.processes.child import ChildProcess

pytestmark = pytest.mark.nightly


@pytest.fixture(autouse=True)
def threads():
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


def test_given_start_up_when_measured_then_the_first_step_comes_before_the_end() -> None:
    report = run_subjects(['start-up'], 1, lambda done, total: None)
    figures = report['figures']
    assert list(figures) == [
        'start-up/taxinet run, first step', 'start-up/taxinet run of 1 s', 'start-up/node, seen',
    ]  # fmt: skip
    first, whole, _ = (figure['median_s'] for figure in figures.values())
    assert 0 < first < whole
    assert report['amounts']['memory: taxinet run'] > 50e6


def test_given_a_campaign_when_measured_then_its_runs_have_a_real_time_factor(monkeypatch) -> None:
    monkeypatch.setattr(campaign, 'WORKERS', (1,))
    monkeypatch.setattr(campaign, 'RUNS', 3)
    monkeypatch.setattr(campaign, '_SEARCH', (*campaign._SEARCH, '--set', 'duration=1'))
    figures = run_subjects(['campaign'], 1, lambda done, total: None)['figures']
    assert list(figures) == ['campaign/1 worker']
    assert figures['campaign/1 worker']['real_time_factor'] > 0


def test_given_a_campaign_that_breaks_down_when_measured_then_its_last_words_come_out(
    monkeypatch
) -> None:
    command = (sys.executable, '-c', 'import sys; sys.exit("no such program")')
    monkeypatch.setattr(campaign, 'TAXINET', command)
    with pytest.raises(InfraError, match='0 of 8 runs, exit code 1: no such program'):
        run_subjects(['campaign'], 1, lambda done, total: None)


def test_given_a_bag_when_looked_at_then_it_holds_a_step_once_one_is_flushed(
    tmp_path: Path
) -> None:
    qos = offered_qos(
        history='keep_last', depth=1, reliability='reliable', durability='volatile'
    )
    topic = describe_topic(name='/clock', type_name='rosgraph_msgs/msg/Clock', qos=qos)
    writer = BagWriter(
        tmp_path / 'run', [topic], metadata={}, attachments={}, min_free_bytes=0
    )
    mcap = tmp_path / 'run' / 'run_0.mcap'
    assert mcap.exists()
    assert not holds_step(mcap)
    writer.write('/clock', bytes([0, 1, 0, 0, *[0] * 8]), 0)
    assert not holds_step(mcap)
    head = mcap.stat().st_size
    writer.flush()
    assert holds_step(mcap)
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(mcap.read_bytes()[:head + 20])
    assert not holds_step(cut)
    writer.abandon()
    assert not holds_step(tmp_path / 'nowhere.mcap')


def test_given_a_command_that_ends_when_waited_for_then_its_last_words_come_out(
    tmp_path: Path
) -> None:
    script = 'import sys; sys.exit("first\\nthe reason\\n")'
    with (
        ChildProcess('it', [sys.executable, '-c', script], log=tmp_path / 'printed') as process,
        pytest.raises(InfraError, match='died: it: exit code 1: the reason'),
    ):
        wait_for(process, lambda: False)


def test_given_a_process_when_asked_then_its_work_and_memory_are_known() -> None:
    script = 'sum(range(10**7)); data = bytearray(10**8); print(flush=True); input()'
    with subprocess.Popen(
        [sys.executable, '-c', script], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdout.readline()
        assert processor_time_ns(process.pid) >= 20_000_000
        assert peak_memory([process.pid]) > 100_000_000
        process.stdin.close()
    assert peak_memory([process.pid]) == 0
