"""The graph under the bench: a second of it, composed and as processes."""

from __future__ import annotations

import dataclasses
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import pytest

from taxinet_ros.bench import subjects
from taxinet_ros.bench.graph import StandingGraph, graph_subjects
from taxinet_ros.bench.report import RATIOS
from taxinet_ros.bench.run import run_subjects
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.nodes import interface


@pytest.fixture(scope='module')
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp('scratch')


@pytest.fixture(scope='module')
def report(scratch: Path) -> Iterator[dict[str, Any]]:
    """A bench of the graph on runs of one second."""
    threads, folder = cv2.getNumThreads(), tempfile.tempdir
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, 'tempdir', str(scratch))
        patch.setattr(
            subjects, 'SCENARIO', dataclasses.replace(subjects.SCENARIO, duration_s=1.0)
        )
        yield run_subjects(['graph'], 1, lambda done, total: None)
    cv2.setNumThreads(threads)
    assert tempfile.tempdir == folder


@pytest.mark.nightly
def test_given_the_graph_when_measured_then_each_way_has_a_figure_beside_the_loop(
    report, scratch: Path
) -> None:
    figures = report['figures']
    expected = {
        f'graph/{way}, {word}' for way in ('composed', 'processes') for word in ('network', 'truth')
    }
    assert set(figures) == {*expected, 'loop/truth', 'loop/network'}
    for name in expected:
        assert figures[name]['cpu_s'] > 0
        assert figures[name]['real_time_factor'] == pytest.approx(1 / figures[name]['median_s'])
    assert set(report['ratios']) == {ratio.name for ratio in RATIOS}
    assert all(ratio['low'] <= ratio['value'] <= ratio['high']
               for ratio in report['ratios'].values())
    assert list(scratch.iterdir()) == []


def test_given_one_domain_for_all_when_measured_then_it_is_refused(monkeypatch) -> None:
    monkeypatch.setenv('TAXINET_DOMAIN_ID', '7')
    with (
        pytest.raises(UsageError, match='TAXINET_DOMAIN_ID puts all its graphs into one domain'),
        ExitStack() as stack,
    ):
        graph_subjects(stack)


def test_given_a_failing_set_up_when_measured_then_the_graphs_before_are_closed(
    monkeypatch
) -> None:
    before = set(threading.enumerate())
    monkeypatch.setitem(subjects.PERCEPTIONS, 'truth', 'nowhere.safetensors')
    with pytest.raises(UsageError, match='nowhere'), ExitStack() as stack:
        graph_subjects(stack)
    assert not {thread for thread in threading.enumerate() if thread.is_alive()} - before


class Answering:
    """A graph whose runs end as it is told, or do not end before they are interrupted."""

    domain = 0

    def __init__(self, result: RunResult | Exception | None) -> None:
        self.result = result
        self.requests: list[RunRequest] = []
        self.interrupted = threading.Event()

    def run(
        self, requests: Iterable[RunRequest], on_result: Callable[[RunRequest, RunResult], bool]
    ) -> None:
        for request in requests:
            self.requests.append(request)
            if isinstance(self.result, Exception):
                raise self.result
            if self.result is None:
                self.interrupted.wait()
                return
            on_result(request, self.result)

    def interrupt(self) -> None:
        self.interrupted.set()


def test_given_a_standing_graph_when_run_then_each_run_has_a_bag_which_is_cleared(
    tmp_path: Path
) -> None:
    answering = Answering(RunResult(outcome=Outcome.FAIL))
    with StandingGraph(answering, interface.PARTICIPANTS, tmp_path) as standing:
        standing.clear()
        assert tmp_path.is_dir()
        standing.run()
        standing.run()
        standing.bag.mkdir()
        standing.clear()
    assert [request.run_id for request in answering.requests] == ['run-0', 'run-1']
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ('result', 'error', 'message'),
    [
        (RunResult(outcome=Outcome.INFRA_ERROR, kind='died', who='recorder', detail='gone'),
         InfraError, 'died: recorder'),
        (UsageError('perception: no such file'), UsageError, 'no such file'),
    ],
)  # fmt: skip
def test_given_a_graph_that_breaks_when_run_then_the_reason_comes_out(
    result: RunResult | Exception, error: type[Exception], message: str, tmp_path: Path
) -> None:
    with (
        StandingGraph(Answering(result), (), tmp_path) as standing,
        pytest.raises(error, match=message),
    ):
        standing.run()


def test_given_a_run_under_way_when_left_then_it_is_interrupted(tmp_path: Path) -> None:
    answering = Answering(None)

    class Interrupted:
        """Ctrl-C while the answer is awaited."""

        def get(self) -> RunResult:
            raise KeyboardInterrupt

    standing = StandingGraph(answering, (), tmp_path)
    standing._answers = Interrupted()
    with pytest.raises(KeyboardInterrupt), standing:
        standing.run()
    assert answering.interrupted.is_set()
