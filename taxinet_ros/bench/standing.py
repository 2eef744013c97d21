"""A graph that stands ready and runs the bench's scenario whenever it is asked to."""

from __future__ import annotations

import itertools
import queue
import shutil
import threading
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from taxinet_ros.bench import loop
from taxinet_ros.core.errors import InfraError
from taxinet_ros.core.outcome import RunRequest, RunResult
from taxinet_ros.nodes.graph import Graph

_END_S = 30.0


class StandingGraph:
    """Runs one scenario after the other; a context manager that ends the graph's work.

    Requests are drawn on the executor's own thread. So between two runs all of a composed graph
    stands still, and takes no time from whatever else is measured.
    """

    def __init__(self, graph: Graph, participants: Sequence[str], bags: Path) -> None:
        """Take over a graph.

        Args:
            graph: nothing else gives it work.
            participants: its nodes that take part in the lockstep.
            bags: where its recorder writes.
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
        """One run, from the request to its result.

        Raises:
            InfraError: it has no verdict.
        """
        number = next(self._numbers)
        self.bag = self._bags / f'run-{number}'
        self._requests.put(RunRequest(
            run_id=self.bag.name, index=number, program='', seed=0, scenario=loop.SCENARIO,
            specs=(loop.SPEC.text,), participants=self._participants,
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
