"""The workers of a campaign: started when there is work, watched, replaced when they break."""

from __future__ import annotations

import select
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from taxinet_ros.campaign.wire import result_from_json
from taxinet_ros.campaign.worker_process import WorkerProcess
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult

SILENCE_S = 120.0
"""A worker whose run gets nowhere for so long is killed. Its start counts too."""

_INTERRUPT_S = 20.0
"""How long a run may take to end in order."""

Answer = tuple[RunRequest, RunResult]


class Crew:
    """Up to ``size`` worker processes; a context manager that leaves none behind.

    After an infrastructure error the worker is not used again: a graph that broke once is not to
    be trusted with the next run.

    Attributes:
        workers: those that live, idle or at work.
        interrupted: whether :meth:`interrupt` was called.
    """

    def __init__(
        self, command: Sequence[str], size: int, logs: Path, silence_s: float = SILENCE_S
    ) -> None:
        """Nothing is started before the first :meth:`give`.

        Args:
            command: what starts a worker, see :class:`.worker_process.WorkerProcess`.
            size: most workers.
            logs: folder for what they print.
            silence_s: how long a run may get nowhere [s of wall clock].
        """
        self.workers: list[WorkerProcess] = []
        self.interrupted = False
        self._command = tuple(command)
        self._size = size
        self._logs = logs
        self._silence_s = silence_s
        self._started = 0

    def __enter__(self) -> Self:
        """Make the folder for logs.

        Raises:
            UsageError: that is not possible.
        """
        try:
            self._logs.mkdir(exist_ok=True)
        except OSError as error:
            raise UsageError(f'{self._logs}: cannot be written: {error.strerror}') from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End them all: the idle ones in order, those at work at once."""
        for worker in self.workers:
            worker.hang_up()
        for worker in self.workers:
            if worker.request is None:
                worker.end()
            else:
                worker.end(0.0)
        self.workers.clear()

    @property
    def busy(self) -> int:
        """Number of runs under way."""
        return sum(worker.request is not None for worker in self.workers)

    @property
    def free(self) -> bool:
        """Whether one more run could be under way."""
        return self.busy < self._size and not self.interrupted

    def give(self, request: RunRequest) -> None:
        """Have a free worker, or a new one, run something."""
        idle = [worker for worker in self.workers if worker.request is None]
        for worker in idle:
            if not worker.alive:
                self._dismiss(worker)
        idle = [worker for worker in idle if worker in self.workers]
        worker = idle[0] if idle else self._start()
        worker.give(request)

    def answers(self, timeout_s: float) -> list[Answer]:
        """The runs that have ended since the last call; waits for one, at most ``timeout_s``.

        Raises:
            UsageError: a worker found a mistake of the user's.
        """
        busy = {worker.answers: worker for worker in self.workers if worker.request is not None}
        readable, _, _ = select.select(list(busy), [], [], timeout_s)
        found = [answer for fd in readable if (answer := self._listen(busy[fd])) is not None]
        return found + self._overdue()

    def interrupt(self) -> None:
        """Have every run under way end in order; there will be no more."""
        self.interrupted = True
        for worker in self.workers:
            if worker.request is not None:
                worker.interrupt()

    def _start(self) -> WorkerProcess:
        self._started += 1
        worker = WorkerProcess(self._command, self._logs / f'worker-{self._started}.log')
        self.workers.append(worker)
        return worker

    def _dismiss(self, worker: WorkerProcess) -> None:
        worker.end(0.0)
        self.workers.remove(worker)

    def _listen(self, worker: WorkerProcess) -> Answer | None:
        messages = worker.read()
        if messages is None:
            return self._lost(worker, 'died')
        results = [message['result'] for message in messages if 'result' in message]
        return self._answered(worker, results[0]) if results else None

    def _answered(self, worker: WorkerProcess, values: Mapping[str, Any]) -> Answer:
        request, result = worker.request, result_from_json(values)
        assert request is not None
        worker.request = None
        if result.outcome is Outcome.INFRA_ERROR:
            self._dismiss(worker)
        return request, result

    def _overdue(self) -> list[Answer]:
        limit_s = _INTERRUPT_S if self.interrupted else self._silence_s
        now = time.monotonic()
        late = [
            worker for worker in self.workers
            if worker.request is not None and now - worker.silent_since > limit_s
        ]
        return [self._lost(worker, 'timeout', f'silent for {limit_s:g} s') for worker in late]

    def _lost(self, worker: WorkerProcess, kind: str, detail: str = '') -> Answer:
        request = worker.request
        assert request is not None
        result = worker.bury(kind, detail)
        self.workers.remove(worker)
        if self.interrupted:
            result = RunResult(outcome=Outcome.INTERRUPTED, last_seq=worker.seq)
        return request, result
