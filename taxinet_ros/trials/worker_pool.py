"""The workers that make runs: started on demand, monitored, and replaced after errors.

A worker is a process with a pipe in each direction. It receives ``{"run": …}`` lines on its
standard input, and an ``{"interrupt": true}`` line to end the current run; it exits at the end of
the input. It writes to another descriptor: ``{"seq": n}`` periodically, ``{"result": …}`` after
each run, and ``{"error": text}`` before it exits on a usage error. Its side of this is a
:class:`Link`, which reads requests in a thread, so that an interrupt arrives during a run.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import io
import json
import os
import queue
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from taxinet_ros.core.perception.substituted import AS_RECORDED
from taxinet_ros.core.system import System
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import ExitCode, InfraKind, UsageError
from taxinet_ros.files.plain_values import typed
from taxinet_ros.processes.child import ChildProcess, open_pipe


def encode_line(message: Mapping[str, Any]) -> bytes:
    """Encode one line; floats round-trip exactly, including NaN and infinities."""
    return json.dumps(message, separators=(',', ':')).encode() + b'\n'


@dataclass(frozen=True, kw_only=True, slots=True)
class Task(RunRequest):
    """Request of a run by a system that it names itself.

    Attributes:
        system: what drives.
        word: what stands in for its estimates (:mod:`taxinet_ros.core.perception.substituted`).
        exact: whether the scene is that of a recorded run to the bit.
        observer: ``MODULE:NAME`` of what looks on (:class:`.loop_run.Observer`), made from the
            scenario and ``observed``; '' for none.
        observed: word for the observer.
    """

    system: System
    word: str = AS_RECORDED
    exact: bool = True
    observer: str = ''
    observed: str = ''


_GRACE_S = 5.0


class WorkerProcess:
    """A worker process that runs requests.

    Attributes:
        request: the current run, or None.
        seq: the last control step reported.
        silent_since: time of its last message, on the monotonic clock [s].
        answers: descriptor to wait on; read it with :meth:`read`.
    """

    def __init__(self, command: Sequence[str], log: Path, folder: Path | None = None) -> None:
        """Start the process.

        Args:
            command: arguments; ``--answers=<descriptor>`` is added.
            log: file to which the process's output is appended.
            folder: its working directory; None for the current one.
        """
        self.request: RunRequest | None = None
        self.seq = -1
        self.silent_since = time.monotonic()
        self._unread = b''
        self.answers, answers_write = open_pipe()
        try:
            self._child = ChildProcess(
                'worker', [*command, f'--answers={answers_write}'], log=log, folder=folder,
                stdin=subprocess.PIPE, descriptors=(answers_write,), killed_with_parent=True,
            )
        except BaseException:
            os.close(self.answers)
            raise
        finally:
            os.close(answers_write)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._child.pid

    @property
    def alive(self) -> bool:
        """Whether the process is alive."""
        return not self._child.dead

    def give(self, request: RunRequest) -> None:
        """Send a run; if the process is dead, :meth:`read` reports it."""
        self.request, self.seq, self.silent_since = request, -1, time.monotonic()
        self._send({'run': dataclasses.asdict(request)})

    def interrupt(self) -> None:
        """Request an orderly end of the current run."""
        self.silent_since = time.monotonic()
        self._send({'interrupt': True})

    def read(self) -> list[Mapping[str, Any]] | None:
        """Messages since the last call; None when the process has exited."""
        part = os.read(self.answers, 65536)
        if not part:
            return None
        *lines, self._unread = (self._unread + part).split(b'\n')
        messages = [json.loads(line) for line in lines]
        for message in messages:
            if 'error' in message:
                raise UsageError(message['error'])
            if message.get('seq', self.seq) != self.seq:
                self.seq, self.silent_since = message['seq'], time.monotonic()
        return messages

    def end_broken_run(self, kind: str, detail: str = '') -> RunResult:
        """Kill the process; return the result of its current run."""
        self.end(0.0 if detail else 1.0)
        return RunResult.infra_error(
            kind, 'worker', detail or self._child.how_it_ended(), self.seq
        )

    def close_input(self) -> None:
        """Close its input, so that it exits."""
        with contextlib.suppress(BrokenPipeError):
            assert self._child.process.stdin is not None
            self._child.process.stdin.close()

    def end(self, grace_s: float = _GRACE_S) -> None:
        """Wait for it to exit, at most ``grace_s``, then kill it."""
        self.close_input()
        self._child.wait(grace_s)
        self._child.end(())
        if self.answers >= 0:
            os.close(self.answers)
        self.answers = -1

    def _send(self, message: Mapping[str, Any]) -> None:
        assert self._child.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._child.process.stdin.write(encode_line(message))
            self._child.process.stdin.flush()


SILENCE_S = 120.0
"""Time without progress, including start-up, after which a worker is killed [s]."""
_INTERRUPT_S = 20.0
"""Time limit for an orderly end of a run [s]."""
Answer = tuple[RunRequest, RunResult]


class WorkerPool:
    """Up to ``size`` worker processes; a context manager that leaves none behind.

    After an infrastructure error the worker is not reused: a graph that broke once is not trusted
    with the next run.

    Attributes:
        workers: live workers, idle or busy.
        interrupted: whether :meth:`interrupt` was called.
    """

    def __init__(
        self, command: Sequence[str], size: int, logs: Path, silence_s: float = SILENCE_S,
        folder: Path | None = None,
    ) -> None:
        """Create the pool; nothing is started before the first :meth:`give`.

        Args:
            command: command of a worker, see :class:`WorkerProcess`.
            size: maximum number of workers.
            logs: folder for their output.
            silence_s: wall-clock limit for a run without progress [s].
            folder: working directory of the workers; None for the current one.
        """
        self.workers: list[WorkerProcess] = []
        self.interrupted = False
        self._command = tuple(command)
        self._size = size
        self._logs = logs
        self._silence_s = silence_s
        self._folder = folder
        self._started = 0

    def __enter__(self) -> Self:
        """Create the folder for logs.

        Raises:
            UsageError: it cannot be created.
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
        """Stop all workers: idle ones orderly, busy ones immediately."""
        for worker in self.workers:
            worker.close_input()
        for worker in self.workers:
            if worker.request is None:
                worker.end()
            else:
                worker.end(0.0)
        self.workers.clear()

    @property
    def busy(self) -> int:
        """Number of runs in flight."""
        return sum(worker.request is not None for worker in self.workers)

    @property
    def free(self) -> bool:
        """Whether one more run can be started."""
        return self.busy < self._size and not self.interrupted

    def give(self, request: RunRequest) -> None:
        """Send a run to a free worker, or to a new one."""
        idle = [worker for worker in self.workers if worker.request is None]
        for worker in idle:
            if not worker.alive:
                self._dismiss(worker)
        idle = [worker for worker in idle if worker in self.workers]
        worker = idle[0] if idle else self._start()
        worker.give(request)

    def answers(self, timeout_s: float) -> list[Answer]:
        """The runs finished since the last call; waits for one, at most ``timeout_s``.

        Raises:
            UsageError: a worker reported a usage error.
        """
        busy = {worker.answers: worker for worker in self.workers if worker.request is not None}
        readable, _, _ = select.select(list(busy), [], [], timeout_s)
        found = [answer for fd in readable if (answer := self._listen(busy[fd])) is not None]
        return found + self._overdue()

    def interrupt(self) -> None:
        """Request an orderly end of all runs in flight; no more may be started."""
        self.interrupted = True
        for worker in self.workers:
            if worker.request is not None:
                worker.interrupt()

    def _start(self) -> WorkerProcess:
        self._started += 1
        log = self._logs / f'worker-{self._started}.log'
        worker = WorkerProcess(self._command, log, self._folder)
        self.workers.append(worker)
        return worker

    def _dismiss(self, worker: WorkerProcess) -> None:
        worker.end(0.0)
        self.workers.remove(worker)

    def _listen(self, worker: WorkerProcess) -> Answer | None:
        messages = worker.read()
        if messages is None:
            return self._lost(worker, InfraKind.DIED)
        results = [message['result'] for message in messages if 'result' in message]
        return self._answered(worker, results[0]) if results else None

    def _answered(self, worker: WorkerProcess, values: Mapping[str, Any]) -> Answer:
        request, result = worker.request, typed(RunResult, values)
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
        detail = f'silent for {limit_s:g} s'
        return [self._lost(worker, InfraKind.TIMEOUT, detail) for worker in late]

    def _lost(self, worker: WorkerProcess, kind: str, detail: str = '') -> Answer:
        request = worker.request
        assert request is not None
        result = worker.end_broken_run(kind, detail)
        self.workers.remove(worker)
        if self.interrupted:
            result = RunResult(outcome=Outcome.INTERRUPTED, last_seq=worker.seq)
        return request, result


BEAT_S = 1.0
"""Time between two reports of progress [s]; silence means that a run hangs."""


class Link:
    """The pipes to the parent; messages may be sent from several threads.

    Attributes:
        interrupt: called when the current run is to end in order.
    """

    def __init__(self, answers: int) -> None:
        """``answers``: descriptor that results are written to."""
        self.interrupt: Callable[[], None] = lambda: None
        self._answers = answers
        self._lock = threading.Lock()
        self._requests: queue.SimpleQueue[RunRequest | None] = queue.SimpleQueue()
        self._interrupted = False
        self._told_s = time.monotonic()

    def requests(self) -> Iterator[RunRequest]:
        """Yield the runs as they are asked for, until there are no more or they are interrupted."""
        threading.Thread(target=self._listen, daemon=True).start()
        while not self._interrupted and (request := self._requests.get()) is not None:
            yield request

    def answer(self, request: RunRequest, result: RunResult) -> bool:
        """Send a result; the parent decides whether this worker gets another run."""
        self._say(result=dataclasses.asdict(result))
        return True

    def progress(self, seq: int) -> None:
        """Report a control step, unless one was reported just before."""
        if time.monotonic() - self._told_s > BEAT_S:
            self._told_s = time.monotonic()
            self._say(seq=seq)

    def refuse(self, error: UsageError) -> None:
        """Report what the user must fix."""
        self._say(error=str(error))

    def _listen(self) -> None:
        # Unbuffered: an unjoined thread would hold a buffer's lock forever.
        for line in io.FileIO(sys.stdin.fileno(), closefd=False):
            message = json.loads(line)
            if 'run' in message:
                kind = Task if 'system' in message['run'] else RunRequest
                self._requests.put(typed(kind, message['run']))
            else:
                self._interrupted = True
                self._requests.put(None)
                self.interrupt()
        self._requests.put(None)

    def _say(self, **message: Any) -> None:
        with self._lock:
            os.write(self._answers, encode_line(message))


def serve(work: Callable[[dict[str, Any], Link], None], words: Sequence[str] | None = None) -> int:
    """The main function of a worker.

    Args:
        work: makes the runs of a link, by the worker's options.
        words: command-line arguments; None for those of this process.

    Returns:
        Exit code: 0, or 2 after a usage error.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument('--answers', type=int, required=True)
    parser.add_argument('--options', required=True)
    arguments = parser.parse_args(words)
    link = Link(arguments.answers)
    try:
        work(json.loads(arguments.options), link)
    except UsageError as error:
        link.refuse(error)
        return ExitCode.USAGE
    return ExitCode.OK
