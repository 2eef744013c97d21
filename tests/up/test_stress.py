"""Neither a busy machine nor a slow perception, in no layout, changes a byte of a run."""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from graph_runs import judged_in, request
from slowed_perception import SlowedPerception

from taxinet_ros.bag.reader import read_info
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunResult
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph, process_graph

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

BUSY = 3
REQUEST = request(
    'stressed', judging=Judging(specs=('phi_eventually', 'phi_always')),
    scenario=scenario_from_human({
        'cross_track': -5.0, 'heading': 14, 'distance': 1300, 'time_of_day': 16.5,
        'clouds': 'scattered', 'duration': 1.5,
    }),
)


class SlowedOptions(GraphOptions):
    """A graph whose perception takes its time."""

    def nodes(self):
        _, parameters = super().nodes()[interface.PERCEPTION]
        return {**super().nodes(), interface.PERCEPTION: (SlowedPerception, parameters)}


@contextlib.contextmanager
def cpu_load() -> Iterator[None]:
    """More processes that compute than there are cores, while the ``with`` lasts."""
    busy = [subprocess.Popen([sys.executable, '-S', '-c', 'while 1: pass']) for _ in range(BUSY)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def run(opened, out: Path) -> tuple[str, RunResult]:
    """SHA-256 of the bag of one run, and the run's result."""
    (result,) = judged_in(opened, REQUEST)
    bag = out / REQUEST.run_id
    assert read_info(bag).complete
    assert read_info(bag).counts['/camera/image_raw'] == 16
    return hashlib.sha256((bag / f'{REQUEST.run_id}_0.mcap').read_bytes()).hexdigest(), result


@pytest.fixture(scope='module')
def at_leisure(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, RunResult]:
    """The run as it is without any of it."""
    out = tmp_path_factory.mktemp('at_leisure')
    return run(composed_graph(GraphOptions(perception='taxinet', out=out)), out)


@pytest.mark.parametrize(
    ('layout', 'slowed', 'loaded'),
    [('composed', True, False), ('composed', False, True), ('processes', True, True)],
)
def test_given_load_or_a_slow_perception_in_any_layout_then_every_byte_is_the_same(
    layout, slowed, loaded, at_leisure, tmp_path, monkeypatch
):
    # A process of its own finds the slowed perception there.
    monkeypatch.setenv('PYTHONPATH', str(Path(__file__).parent), prepend=os.pathsep)
    options = (SlowedOptions if slowed else GraphOptions)(perception='taxinet', out=tmp_path)
    opened = (
        composed_graph(options) if layout == 'composed'
        else process_graph(options, tmp_path / 'logs')
    )
    with cpu_load() if loaded else contextlib.nullcontext():
        digest, result = run(opened, tmp_path)
    expected_digest, expected = at_leisure
    assert digest == expected_digest
    assert (result.outcome, result.rho) == (expected.outcome, expected.rho)
    assert repr(result.statistics) == repr(expected.statistics)  # A time may be NaN.
