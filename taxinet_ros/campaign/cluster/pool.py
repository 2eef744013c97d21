"""The workers of a cluster as the pool of a campaign, behind the seam of :class:`.Executor`.

Runs are given out in tasks, each to one worker by name. A task whose worker is lost is given out
again, in halves, so that workers that do not live long get on as well. Each result is taken once,
from the task that has the run at that time; its bag is moved into the campaign's folder then.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import queue
import shutil
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from taxinet_ros.campaign.cluster.connection import LIMITS, Cluster, Limits, Tell
from taxinet_ros.campaign.cluster.machine import Needs
from taxinet_ros.campaign.cluster.task import PYTHON, run_task
from taxinet_ros.campaign.options import AUDIT, GRAPH, CampaignOptions
from taxinet_ros.campaign.record.facts import FACTS_NAME
from taxinet_ros.campaign.worker_pool import Answer, request_to_json, result_from_json
from taxinet_ros.core.provenance import Provenance, stack_id
from taxinet_ros.core.topics import RECORDER
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.errors import InfraKind, UsageError
from taxinet_ros.files.atomic import disk_error

if TYPE_CHECKING:
    from distributed import Future

TASK_RUNS = 50
"""Number of runs of a task, where so many may be in flight."""
_QUEUED = 2
"""Tasks for each thread of a worker: one is made while another waits."""
_LOSSES = 3
"""Number of workers that a run alone in its task may lose before it counts as broken."""
_FAILURES = 3
"""Number of tasks in a row that a worker may fail before it is put aside."""
_INTERRUPT_S = 30.0
_MOVE_S = 10.0
_RESULT_S = 30.0
CLUSTER_FOLDER = Path('logs') / 'cluster'
"""Folder within a campaign's for bags whose results are not taken yet."""


@dataclass(frozen=True, kw_only=True)
class _Task:
    requests: Sequence[RunRequest]
    worker: str
    connection: int
    future: Future[str]


def campaign_cluster(
    campaign: CampaignOptions, where: str, *, tell: Tell = lambda line: None,
    limits: Limits = LIMITS,
) -> Cluster:
    """The cluster for a campaign, not yet connected.

    Args:
        campaign: the campaign, whose folder need not exist yet.
        where: result of :func:`.connection.check_cluster`.
        tell: called with lines on what happens to the cluster.
        limits: how long to wait.
    """
    needs = Needs(
        perception=campaign.perception, controller=campaign.controller, world=campaign.world,
        gains=campaign.gains, folder=os.getcwd(),
        graph=campaign.engine == GRAPH or (campaign.bags and campaign.audit_percent > 0),
    )
    return Cluster(
        where, needs, out=campaign.out if campaign.bags else None, tell=tell, limits=limits,
    )


class ClusterPool:
    """The pool of a connected cluster; a context manager.

    Attributes:
        interrupted: whether :meth:`interrupt` was called.
    """

    def __init__(
        self, cluster: Cluster, command: Sequence[str], out: Path, *, runs: int,
        in_flight: int | None, fingerprint: str = '',
        on_machine: Callable[[Provenance], None] = lambda record: None,
    ) -> None:
        """Create it.

        Args:
            cluster: the cluster, within its ``with``.
            command: command of a child, whose folder of bags is :data:`.task.OUT`.
            out: folder of the campaign, which exists.
            runs: number of runs planned.
            in_flight: number of runs that may be in flight; None: any.
            fingerprint: SHA-256 of the perception that every result must name, or ''.
            on_machine: called with the provenance of each other machine before its first result.
        """
        self.interrupted = False
        self._cluster, self._out = cluster, out.absolute()
        self._runs, self._in_flight = runs, in_flight
        self._fingerprint, self._on_machine = fingerprint, on_machine
        self._folder = self._out / CLUSTER_FOLDER if cluster.shares_folder else None
        self._job = dataclasses.replace(
            cluster.job, command=[word.replace(sys.executable, PYTHON) for word in command],
            folder='' if self._folder is None else str(self._folder),
        )
        self._pending: list[RunRequest] = []
        self._again: deque[Sequence[RunRequest]] = deque()
        self._tasks: dict[str, _Task] = {}
        self._answers: list[Answer] = []
        self._losses: Counter[int] = Counter()
        self._failures: Counter[str] = Counter()
        self._machines: set[str] = set()
        self._given = 0
        self._interrupted_s = math.inf
        self._ended: queue.SimpleQueue[str] = queue.SimpleQueue()

    def __enter__(self) -> Self:
        """Make the folder of bags; what a lost session left there is removed.

        Raises:
            UsageError: it cannot be made.
        """
        facts = (self._out / FACTS_NAME).read_text(encoding='utf-8')
        self._job_text = json.dumps(dataclasses.asdict(
            dataclasses.replace(self._job, facts=facts)
        ))
        if self._folder is not None:
            _clear(self._folder)
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise UsageError(f'{self._folder}: cannot be written: {error.strerror}') from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End what is still running, and remove the bags of results that were not taken."""
        if self._tasks:
            self._cluster.stop()
            for task in self._tasks.values():
                with contextlib.suppress(Exception):
                    task.future.cancel()
        if self._folder is not None:
            _clear(self._folder)

    @property
    def busy(self) -> int:
        """Number of runs in flight."""
        return (
            len(self._pending) + len(self._answers) + sum(map(len, self._again))
            + sum(len(task.requests) for task in self._tasks.values())
        )

    @property
    def free(self) -> bool:
        """Whether one more run can be started; not while results wait to be taken."""
        if self.interrupted or (self._tasks and not self._ended.empty()):
            return False
        return self.busy < _QUEUED * self._cluster.threads * self._size

    @property
    def _size(self) -> int:
        """Number of runs of the next task: no worker is to be idle while another has many."""
        left = max(self._runs - self._given, 1)
        most = left if self._in_flight is None else min(left, self._in_flight)
        share = math.ceil(most / (_QUEUED * max(self._cluster.threads, 1)))
        return min(max(share, 1), TASK_RUNS)

    def give(self, request: RunRequest) -> None:
        """Start a run, with others in one task."""
        self._pending.append(request)
        self._given += 1
        if len(self._pending) >= self._size:
            self._send_pending()

    def answers(self, timeout_s: float) -> list[Answer]:
        """The runs finished since the last call; waits for one, at most ``timeout_s``.

        Raises:
            UsageError: no worker is left that can make the runs.
            InfraError: the cluster has been gone for too long.
        """
        if self._interrupted_s == math.inf:  # when ending, nobody is waited for
            self._cluster.watch()
        self._take_back_lost()
        if self._ended.empty() and not self._answers:
            self._send_pending()
        with contextlib.suppress(queue.Empty):
            key = self._ended.get(timeout=0 if self._answers else timeout_s)
            while True:
                if (task := self._tasks.get(key)) is not None:
                    self._take(key, task)
                key = self._ended.get_nowait()
        if self.interrupted:
            self._drop_overdue()
        found, self._answers = self._answers, []
        return found

    def interrupt(self) -> None:
        """Request an orderly end of current runs; others are dropped, and begin with a resume."""
        self.interrupted = True
        self._interrupted_s = time.monotonic()
        self._pending.clear()
        self._again.clear()
        self._cluster.stop()

    # Giving out --------------------------------------------------------------------------------

    def _send_pending(self) -> None:
        while self._again and self._send(self._again[0]):
            self._again.popleft()
        if self._pending and self._send(self._pending):
            self._pending = []

    def _send(self, requests: Sequence[RunRequest]) -> bool:
        """Give runs to the worker with the least to do; whether there is one."""
        loads = Counter(task.worker for task in self._tasks.values())
        workers = self._cluster.workers
        if not workers:
            return False
        worker = min(workers, key=lambda one: loads[one] / workers[one])
        if loads[worker] >= _QUEUED * workers[worker]:
            return False
        text = json.dumps([request_to_json(request) for request in requests])
        key, future = self._cluster.submit(worker, run_task, self._job_text, text)
        self._tasks[key] = _Task(
            requests=tuple(requests), worker=worker, future=future,
            connection=self._cluster.connection,
        )
        future.add_done_callback(lambda ended: self._ended.put(key))
        return True

    def _take_back_lost(self) -> None:
        for key, task in list(self._tasks.items()):
            lost = task.connection != self._cluster.connection
            if lost or task.worker not in self._cluster.workers:
                if not lost and task.future.status == 'finished':
                    continue  # it came before its worker went
                self._take_back(key, task)

    def _take_back(self, key: str, task: _Task) -> None:
        """Give the runs of a lost task out again, unless a run has lost too many workers."""
        del self._tasks[key]
        with contextlib.suppress(Exception):
            task.future.cancel()
        if self.interrupted:
            return
        requests = task.requests
        if len(requests) == 1:
            request, = requests
            self._losses[request.index] += 1
            if self._losses[request.index] >= _LOSSES:
                del self._losses[request.index]
                detail = f'{_LOSSES} workers of the cluster were lost with it, {task.worker} last'
                self._answers.append(
                    (request, RunResult.infra_error(InfraKind.DIED, 'worker', detail, -1))
                )
                return
        half = math.ceil(len(requests) / 2)
        self._again.extend(part for part in (requests[:half], requests[half:]) if part)

    # Taking ------------------------------------------------------------------------------------

    def _take(self, key: str, task: _Task) -> None:
        """Take the results of a task that has ended, in whatever way."""
        if task.connection != self._cluster.connection:
            return  # given out again with all of that connection
        if task.future.status == 'cancelled':
            self._cluster.note_cut()
            return
        try:
            told = json.loads(task.future.result(timeout=_RESULT_S))
        except Exception as error:  # of Dask, or of a worker of whatever kind
            self._failed(key, task, error)
            return
        self._failures.pop(task.worker, None)
        del self._tasks[key]
        task.future.release()
        stack = self._stack(told.get('record') or {})
        missing = {request.index: request for request in task.requests}
        unfit = str(told['unfit'])
        for answer in told['answers']:
            request = missing[int(answer['index'])]
            result = result_from_json(answer['result'])
            if self._fingerprint and result.fingerprint not in ('', self._fingerprint):
                unfit = f'has another perception now (sha256 {result.fingerprint[:12]}…)'
                break
            del missing[request.index]
            self._answers.append((request, self._with_bag(request, result, answer, stack)))
        if unfit:
            self._cluster.take_aside(task.worker, unfit)
        if missing and not self.interrupted:
            self._again.append(tuple(missing.values()))

    def _failed(self, key: str, task: _Task, error: Exception) -> None:
        """Give a task out again that Dask lost, or that its worker could not read."""
        self._failures[task.worker] += 1
        lost = self._cluster.workers.get(task.worker) is None
        if not lost and self._failures[task.worker] >= _FAILURES:
            reason = f'failed {_FAILURES} tasks in a row: {type(error).__name__}: {error}'
            self._cluster.take_aside(task.worker, ' '.join(reason.split()))
        self._take_back(key, task)

    def _stack(self, record: Mapping[str, str]) -> str:
        if not record:
            return ''
        stack = stack_id(record)
        if stack not in self._machines:
            self._machines.add(stack)
            self._on_machine(record)
        return stack

    def _with_bag(
        self, request: RunRequest, result: RunResult, answer: Mapping[str, Any], stack: str
    ) -> RunResult:
        """The result, once its bag is in the campaign's folder."""
        result = dataclasses.replace(result, stack=stack)
        if result.kind == AUDIT:  # its text names the bag of the graph, beside that of the loop
            return result
        folder = self._out / request.run_id
        try:
            if answer['bag']:
                _move(Path(answer['bag']), folder)
        except FileNotFoundError:
            detail = f'its bag is not at {answer["bag"]}'
            broken = RunResult.infra_error(InfraKind.BAG, RECORDER, detail, result.last_seq)
            return dataclasses.replace(broken, stack=stack)
        except OSError as error:
            raise disk_error(folder, error) from error
        return result

    def _drop_overdue(self) -> None:
        """Drop the runs of workers that do not end in time after an interrupt."""
        late = time.monotonic() - self._interrupted_s > _INTERRUPT_S
        for key, task in list(self._tasks.items()):
            if late or task.worker not in self._cluster.workers:
                del self._tasks[key]
                with contextlib.suppress(Exception):
                    task.future.cancel()


def _move(bag: Path, folder: Path) -> None:
    """Move a bag; on a network file system, what another machine wrote may appear late."""
    deadline = time.monotonic() + _MOVE_S
    while True:
        try:
            bag.rename(folder)
            return
        except FileNotFoundError:
            if time.monotonic() > deadline:
                raise
        time.sleep(0.2)


def _clear(folder: Path) -> None:
    """Remove what children left, except for logs that say something and bags of audits."""
    for child in folder.iterdir() if folder.is_dir() else ():
        for path in child.iterdir() if child.is_dir() else ():
            if path.name != 'logs' and path.is_dir() and not (child / 'logs' / AUDIT).is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name == FACTS_NAME:
                path.unlink(missing_ok=True)
        for log in (child / 'logs').glob('*.log'):
            if not log.stat().st_size:
                log.unlink(missing_ok=True)
        for empty in (child / 'logs', child):
            with contextlib.suppress(OSError):
                empty.rmdir()
    with contextlib.suppress(OSError):
        folder.rmdir()


