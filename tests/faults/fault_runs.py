"""Runs that something is done to, and what they leave behind."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from taxinet_ros.bag.errors import BagTruncated
from taxinet_ros.bag.reader import read_messages
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.nodes.interface import PARTICIPANTS

PERIOD_NS = 100_000_000


def request(run_id: str = 'run', duration: float = 600.0, **changes: Any) -> RunRequest:
    """A run that lasts long enough to be disturbed."""
    values: dict[str, Any] = {
        'run_id': run_id, 'index': 0, 'program': 'test', 'seed': 0,
        'scenario': scenario_from_human({'cross_track': 3.0, 'heading': 5, 'duration': duration}),
        'judging': Judging(specs=('phi_always',)), 'participants': PARTICIPANTS,
    }
    return RunRequest(**{**values, **changes})


def run(graph: Any, *asked: RunRequest) -> list[RunResult]:
    """All results, also those after a broken run."""
    results: list[RunResult] = []
    graph.run(asked, lambda request, result: results.append(result) or True)
    return results


def grown(bag: Path) -> bool:
    """Whether a run is well under way."""
    return sum(file.stat().st_size for file in bag.glob('*.mcap')) > 100_000


@contextlib.contextmanager
def once(condition: Callable[[], object], act: Callable[[], object]) -> Iterator[None]:
    """Within the ``with``, have ``act`` called from another thread as soon as a condition holds."""
    over, done = threading.Event(), threading.Event()

    def wait() -> None:
        while not condition() and not over.wait(0.01):
            pass
        if condition():
            act()
            done.set()

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    yield
    over.set()
    thread.join()
    assert done.is_set(), 'it was over before'


def steps_in(folder: Path) -> list[int]:
    """Numbers of the steps whose truth is in a bag, which may be cut short."""
    stamps = []
    with contextlib.suppress(BagTruncated):
        for name, _, stamp, _ in read_messages(folder):
            if name == '/ground_truth/tracking_error':
                stamps.append(stamp)
    assert all(stamp % PERIOD_NS == 0 for stamp in stamps)
    return [stamp // PERIOD_NS for stamp in stamps]


def files(bag: Path) -> dict[str, bytes]:
    """Bytes of a bag's files."""
    return {file.name: file.read_bytes() for file in bag.iterdir()}
