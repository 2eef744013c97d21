"""The closed loop over ROS 2: composed, as processes, on another executor, without a recorder.

All run the scenario of :mod:`.closed_loop`, for comparison with the loop without ROS. A run is
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
from typing import Any, Self

from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level

from taxinet_ros.bench.measure import Clock, Subject
from taxinet_ros.bench.processes import Amounts, folder_bytes, peak_memory, processor_time_ns
from taxinet_ros.bench.subjects import closed_loop
from taxinet_ros.bench.subjects.closed_loop import tick_subject
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import Graph, GraphOptions, composed_graph, process_graph

_END_S = 30.0


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
        self._graph = graph
        self._participants = tuple(participants)
        self._bags = bags
        self._numbers = itertools.count()
        self._requests: queue.SimpleQueue[RunRequest | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[RunResult | BaseException] = queue.SimpleQueue()
        self._busy = False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self.bag = bags

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
            run_id=self.bag.name, index=number, program='', seed=0, scenario=closed_loop.SCENARIO,
            judging=Judging(specs=(closed_loop.SPEC.text,)), participants=self._participants,
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

    def _work(self) -> None:
        try:
            self._graph.run(iter(self._requests.get, None), self._answer)
        except BaseException as error:
            self._answers.put(error)

    def _answer(self, request: RunRequest, result: RunResult) -> bool:
        self._answers.put(result)
        return True


PERCEPTIONS = {'network': 'taxinet', 'truth': 'truth'}
"""Perception given to the graph, by its word in a figure's name."""
_MOST, _MOST_SLOW = 3, 2
_DOMAIN = 'TAXINET_DOMAIN_ID'
Open = Callable[[GraphOptions], AbstractContextManager[Graph]]


class _Unrecorded(GraphOptions):
    """Options of a graph without a recorder, available only to the benchmark."""

    def nodes(self) -> dict[str, tuple[Any, dict[str, Any]]]:
        """See :class:`GraphOptions`."""
        nodes = super().nodes()
        del nodes[interface.RECORDER]
        return nodes


def subjects(stack: ExitStack, amounts: Amounts) -> list[Subject]:
    """Runs through graphs that live until ``stack`` is closed, and the parts of a control step.

    Args:
        stack: closes the graphs.
        amounts: receives the bytes of a run and the memory of the processes.

    Raises:
        UsageError: the user has set one domain, in which all these graphs would communicate.
    """
    if os.environ.get(_DOMAIN):
        raise UsageError(f'bench: {_DOMAIN} puts all its graphs into one domain; unset it')
    # Concurrent graphs have nodes of the same names, which the rosout logger would report.
    set_logger_level('rcl.logging_rosout', LoggingSeverity.ERROR)
    maker = _Maker(stack)
    found: list[Subject] = []
    for word in PERCEPTIONS:
        composed = maker.make('composed', word)
        found.append(composed.subject)
        if word == 'network':
            found.append(tick_subject(composed.bag))
            amounts['a run without pictures'] = composed.bytes
    logs = maker.folder / 'logs'
    for word in PERCEPTIONS:
        apart = maker.make('processes', word, partial(process_graph, logs=logs / word))
        found.append(apart.subject)
        if word == 'network':
            amounts['memory: graph of processes'] = partial(peak_memory, apart.pids)
    default = partial(composed_graph, executor=SingleThreadedExecutor)
    for word in PERCEPTIONS:
        found.append(maker.make('default executor', word, default, most=_MOST_SLOW).subject)
    pictures = maker.make('with pictures', 'network', images='all')
    amounts['a run with pictures'] = pictures.bytes
    unrecorded = maker.make('no recorder', 'network', kind=_Unrecorded)
    amounts['memory: this process, with all its graphs'] = partial(peak_memory, [os.getpid()])
    return [*found, pictures.subject, unrecorded.subject]


class _Standing:
    """One standing graph as a subject."""

    def __init__(
        self, name: str, graph: StandingGraph, pids: Sequence[int], most: int
    ) -> None:
        self.graph = graph
        self.pids = pids
        self.subject = Subject(
            name=f'graph/{name}', run=graph.run, before=graph.clear, warm_ups=1, most=most,
            simulated_s=closed_loop.SCENARIO.duration_s, cpu=_clock(pids),
        )

    def bag(self) -> Path:
        """The bag of its last run."""
        return self.graph.bag

    def bytes(self) -> float:
        """Size of the last run's files on disk [bytes]."""
        return folder_bytes(self.graph.bag)


class _Maker:
    """Sets up graphs, each with its own folder."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        folder = tempfile.TemporaryDirectory(prefix='taxinet-bench-')
        self.folder = Path(stack.enter_context(folder))

    def make(
        self, way: str, word: str, start: Open = composed_graph, *, images: str = 'none',
        kind: type[GraphOptions] = GraphOptions, most: int = _MOST,
    ) -> _Standing:
        """Set up a graph that works in the given ``way``, with perception ``word``."""
        bags = self.folder / way / word
        options = kind(perception=PERCEPTIONS[word], out=bags, images=images)
        graph = self._stack.enter_context(start(options))
        pids = [child.pid for child in getattr(graph, 'children', ())]
        known = options.nodes()
        there = [name for name in interface.PARTICIPANTS if name in known]
        standing = self._stack.enter_context(StandingGraph(graph, there, bags))
        return _Standing(f'{way}, {word}', standing, pids, most)


def _clock(pids: Sequence[int]) -> Clock:
    """Clock of the processor time of this process and of children [ns], theirs in 10 ms steps."""
    return lambda: time.process_time_ns() + sum(processor_time_ns(pid) for pid in pids)
