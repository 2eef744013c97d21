"""Runs on graphs, what is done to them and what they leave behind; nodes on a domain alone."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future

from taxinet_ros.bag.errors import BagTruncated
from taxinet_ros.bag.reader import read_messages
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.executor import NodeExecutor

PERIOD_NS = 100_000_000
EXECUTABLES = Path(sys.prefix, 'lib', 'taxinet_ros')


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


def run_in(opened: Any, *asked: RunRequest) -> list[RunResult]:
    """All results of a graph that is opened for these runs."""
    with opened as graph:
        results = run(graph, *asked)
    assert len(results) == len(asked)
    return results


def judged_in(opened: Any, *asked: RunRequest) -> list[RunResult]:
    """As :func:`run_in`, of runs that all have a verdict."""
    results = run_in(opened, *asked)
    assert all(result.outcome.judged for result in results), results
    return results


def files(folder: Path) -> dict[str, bytes]:
    """What lies in a folder."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@contextlib.contextmanager
def on_own_domain(
    executor: Callable[..., Any] = EventsExecutor, domain: int | None = None
) -> Iterator[NodeExecutor]:
    """A context on a domain that nobody else uses, with an executor; its nodes leave at the end."""
    found = own_domain() if domain is None else contextlib.nullcontext(domain)
    with found as number, NodeExecutor(number, executor) as spinning:
        yield spinning


def start_node(
    name: str, domain: int | str, *words: str, **how: Any
) -> subprocess.Popen[str]:
    """An installed executable as ``ros2 run`` starts it; what it logs comes over a pipe."""
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'PYTHONUNBUFFERED': '1'}
    streams = {'stdout': subprocess.DEVNULL, 'stderr': subprocess.PIPE, **how}
    command = [str(EXECUTABLES / name), *words]
    return subprocess.Popen(command, env=environment, text=True, **streams)


def class_of(executable: str) -> type[Any]:
    """The node class of an executable."""
    module = import_module(f'taxinet_ros.nodes.{executable}')
    (kind,) = (
        one for one in vars(module).values()
        if isinstance(one, type) and issubclass(one, Node) and one.__module__ == module.__name__
    )
    return kind


def parameters(*values: str) -> list[str]:
    """Words that give a node parameters, ``NAME:=VALUE`` each."""
    return ['--ros-args', *(word for value in values for word in ('-p', value))]


def spin(executor: Any, until: Callable[[], object]) -> None:
    """Spin until something holds."""
    future = Future(executor=executor)
    while not until():
        executor.spin_until_future_complete(future, timeout_sec=0.05)


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
