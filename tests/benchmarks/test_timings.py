"""Timings of commands, parts of a run and other monitors, and what they say in trouble."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import campaign
import control_step
import cv2
import monitors
import pytest
import timings
from control_step import PARTS, TRANSPORT, WHOLE
from processes import peak_memory, wait_for
from start_up import holds_step
from timings import measure_subjects

from taxinet_ros.bag.topics import describe_topic, offered_qos
from taxinet_ros.bag.writer import BagWriter
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.processes.child import ChildProcess
from taxinet_ros.samplers.registry import SAMPLERS

pytestmark = pytest.mark.nightly


@pytest.fixture(autouse=True)
def threads():
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


def test_given_start_up_when_measured_then_the_first_step_comes_before_the_end() -> None:
    report = measure_subjects(['start-up'], 1, lambda done, total: None)
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
    figures = measure_subjects(['campaign'], 1, lambda done, total: None)['figures']
    assert list(figures) == ['campaign/1 worker']
    assert figures['campaign/1 worker']['real_time_factor'] > 0


def test_given_a_campaign_that_breaks_down_when_measured_then_its_last_words_come_out(
    monkeypatch
) -> None:
    command = (sys.executable, '-c', 'import sys; sys.exit("no such program")')
    monkeypatch.setattr(campaign, 'TAXINET', command)
    with pytest.raises(InfraError, match='0 of 8 runs, exit code 1: no such program'):
        measure_subjects(['campaign'], 1, lambda done, total: None)


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


def test_given_a_process_when_asked_then_its_memory_is_known() -> None:
    script = 'data = bytearray(10**8); print(flush=True); input()'
    with subprocess.Popen(
        [sys.executable, '-c', script], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdout.readline()
        assert peak_memory([process.pid]) > 100_000_000
        process.stdin.close()
    assert peak_memory([process.pid]) == 0


def figures(*words: str, repeats: int = 3) -> dict[str, dict[str, float]]:
    return measure_subjects(words, repeats, lambda done, total: None)['figures']


def test_given_physics_and_monitor_when_measured_then_each_has_its_figures(monkeypatch) -> None:
    for word in ('10k', '100k'):
        monkeypatch.setitem(monitors.LENGTHS, word, 1_000)
    found = figures('monitor', 'physics')
    names = [f'monitor/{spec} {kind}' for spec in SHIPPED for kind in ('sample', 'offline')]
    physics = [f'physics/{what}{pushed}' for what in ('control step', 'new')
               for pushed in ('', ', wind', ', gusts', ', wet, uphill')]
    assert list(found)[: len(physics) + len(names)] == [*physics, *names]
    assert {f'monitor/phi_always {kind} of {length}' for kind in ('sample', 'offline')
            for length in ('1k', '10k', '100k')} < set(found)
    assert {f'monitor/window of {seconds} s sample of 10k' for seconds in (10, 100, 1000)} < set(
        found)
    assert all(figure['median_s'] > 0 for figure in found.values())
    step = found['physics/control step']
    assert step['real_time_factor'] == pytest.approx(0.1 / step['median_s'])


def test_given_a_camera_when_made_then_textures_are_made_a_few_times_only() -> None:
    found = figures('camera', repeats=4)
    assert found['camera/textures']['repeats'] == 3
    assert found['camera/new, dry']['repeats'] == 4


def test_given_network_and_samplers_when_measured_then_each_has_its_figure(capsys) -> None:
    assert timings.main(['samplers', 'inference', '--repeats', '1', '--json']) == 0
    found = json.loads(capsys.readouterr().out)['figures']
    assert list(found) == [
        'inference/estimate', 'inference/preprocessing', 'inference/network',
        *(f'samplers/{word}' for word in SAMPLERS),
    ]
    assert all(figure['median_s'] > 0 for figure in found.values())
    assert timings.main(['inference', '--repeats', '1']) == 0
    assert 'inference/network' in capsys.readouterr().out


@pytest.mark.ros
def test_given_the_graph_when_measured_then_a_control_step_is_the_sum_of_its_parts() -> None:
    report = measure_subjects(['graph'], 1, lambda done, total: None)
    tick, amounts = report['tick'], report['amounts']
    assert list(tick) == [*PARTS, TRANSPORT, WHOLE]
    assert math.fsum(tick[part] for part in (*PARTS, TRANSPORT)) == pytest.approx(tick[WHOLE])
    assert all(tick[part] > 0 for part in PARTS)
    assert tick[WHOLE] == pytest.approx(report['figures']['graph/composed, network']['cpu_s'] / 301)
    assert set(report['ratios']) == {ratio.name for ratio in control_step.RATIOS}
    assert amounts['a run with pictures'] > 10 * amounts['a run without pictures'] > 0
    assert amounts['memory: graph of processes'] > 50e6


@pytest.fixture
def peer_python(tmp_path: Path, monkeypatch) -> str:
    """A Python that has two other monitors, which do nothing."""
    (tmp_path / 'rtamt.py').write_text(
        'class StlDiscreteTimeSpecification:\n'
        '    def __getattr__(self, name):\n'
        '        return lambda *args: None\n'
    )
    (tmp_path / 'mtl.py').write_text('def parse(text):\n    return lambda *args, **words: 0.0\n')
    monkeypatch.setenv('PYTHONPATH', os.fspath(tmp_path))
    return sys.executable


def test_given_a_python_with_other_monitors_when_measured_then_they_stand_beside_ours(
    peer_python: str, monkeypatch
) -> None:
    monkeypatch.setitem(timings.ALONE, 'monitor', list)
    found = measure_subjects(['monitor'], 4, lambda done, total: None, peer_python)['figures']
    formulas = ('phi_always', 'phi_eventually')
    expected = {f'monitor/rtamt {name} offline': 4 for name in formulas}
    expected |= {f'monitor/py-mtl {name} offline': 3 for name in formulas}
    assert {name: figure['repeats'] for name, figure in found.items()} == expected
    assert all(figure['cpu_s'] is None for figure in found.values())


@pytest.mark.parametrize(
    ('python', 'message'),
    [
        ('/nowhere/python', '--peers: cannot run /nowhere/python: No such file'),
        ('/bin/false', '/bin/false has no rtamt, sentil or metric-temporal-logic; tests/core'),
    ],
)
def test_given_no_such_python_when_measured_then_it_is_refused(
    python: str, message: str, monkeypatch
) -> None:
    monkeypatch.setitem(timings.ALONE, 'monitor', list)
    with pytest.raises(UsageError, match=message):
        measure_subjects(['monitor'], 1, lambda done, total: None, python)
