"""The closed loop over ROS 2: composed in one process, and each node a process.

All run the scenario of :mod:`.subjects`, for comparison with the loop without ROS. A run is
measured from the request to the result, including preparation and closing the bag.
"""

from __future__ import annotations

import itertools
import os
import queue
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

import psutil
from rclpy.logging import LoggingSeverity, set_logger_level

from taxinet_ros.bench import subjects
from taxinet_ros.bench.measure import Clock, Subject
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import Graph, GraphOptions, composed_graph, process_graph

_END_S = 30.0
_MOST = 3
_DOMAIN = 'TAXINET_DOMAIN_ID'
Start = Callable[[GraphOptions], AbstractContextManager[Graph]]


class StandingGraph:
    """Runs one scenario after the other; a context manager that stops the graph.

    Requests are drawn on the executor's own thread. So a composed graph is idle between two runs
    and takes no time from other subjects.
    """

    def __init__(self, graph: Graph, participants: Sequence[str], bags: Path) -> None:
        """Take over a graph.

        Args:
            graph: graph without any other source of requests.
            participants: its nodes that take part in the lockstep.
            bags: output folder of its recorder.
        """
        self.bag = bags
        self.pids = tuple(child.pid for child in getattr(graph, 'children', ()))
        self._graph = graph
        self._participants = tuple(participants)
        self._bags = bags
        self._numbers = itertools.count()
        self._requests: queue.SimpleQueue[RunRequest | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[RunResult | BaseException] = queue.SimpleQueue()
        self._busy = False
        self._thread = threading.Thread(target=self._work, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._busy:
            self._graph.interrupt()
        self._requests.put(None)
        self._thread.join(_END_S)

    def run(self) -> None:
        """Perform one run, from the request to its result.

        Raises:
            InfraError: it has no verdict.
        """
        number = next(self._numbers)
        self.bag = self._bags / f'run-{number}'
        self._requests.put(RunRequest(
            run_id=self.bag.name, index=number, program='', seed=0, scenario=subjects.SCENARIO,
            judging=Judging(specs=(subjects.SPEC.text,)), participants=self._participants,
        ))
        self._busy = True
        answer = self._answers.get()
        self._busy = False
        if isinstance(answer, BaseException):
            raise answer
        if not answer.outcome.judged:
            raise InfraError(answer.kind, answer.who, answer.last_seq, answer.detail)

    def clear(self) -> None:
        """Remove the bag of the last run."""
        if self.bag != self._bags:
            shutil.rmtree(self.bag, ignore_errors=True)

    def subject(self, name: str, most: int = _MOST) -> Subject:
        """Subject of its runs; their processor time is that of all its processes."""
        return Subject(
            name=f'graph/{name}', run=self.run, before=self.clear, warm_ups=1, most=most,
            simulated_s=subjects.SCENARIO.duration_s, cpu=_clock(self.pids),
        )

    def _work(self) -> None:
        try:
            self._graph.run(iter(self._requests.get, None), self._answer)
        except BaseException as error:
            self._answers.put(error)

    def _answer(self, request: RunRequest, result: RunResult) -> bool:
        self._answers.put(result)
        return True


def graph_subjects(stack: ExitStack) -> list[Subject]:
    """Runs through graphs that live until ``stack`` is closed.

    Raises:
        UsageError: the user has set one domain, in which all these graphs would communicate.
    """
    check_domain()
    found = []
    for way in ('composed', 'processes'):
        for word, perception in subjects.PERCEPTIONS.items():
            folder = scratch(stack)
            start = composed_graph if way == 'composed' else partial(
                process_graph, logs=folder / 'logs'
            )
            options = GraphOptions(perception=perception, out=folder, images='none')
            found.append(standing_graph(stack, options, start).subject(f'{way}, {word}'))
    return found


def check_domain() -> None:
    """Check that each graph can have a domain of its own, and quieten rosout.

    Raises:
        UsageError: the user has set one domain for all.
    """
    if os.environ.get(_DOMAIN):
        raise UsageError(f'bench: {_DOMAIN} puts all its graphs into one domain; unset it')
    # Concurrent graphs have nodes of the same names, which the rosout logger would report.
    set_logger_level('rcl.logging_rosout', LoggingSeverity.ERROR)


def scratch(stack: ExitStack) -> Path:
    """A folder that is removed with the stack."""
    return Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='taxinet-bench-')))


def standing_graph(
    stack: ExitStack, options: GraphOptions, start: Start = composed_graph
) -> StandingGraph:
    """Start a graph that is stopped with the stack."""
    graph = stack.enter_context(start(options))
    there = [name for name in interface.PARTICIPANTS if name in options.nodes()]
    return stack.enter_context(StandingGraph(graph, there, options.out))


def _clock(pids: Sequence[int]) -> Clock:
    """Clock of the processor time of this process and of children [ns], theirs in 10 ms steps."""
    return lambda: time.process_time_ns() + sum(_processor_time_ns(pid) for pid in pids)


def _processor_time_ns(pid: int) -> int:
    spent = psutil.Process(pid).cpu_times()
    return round((spent.user + spent.system) * NS_PER_S)
