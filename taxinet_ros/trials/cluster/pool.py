"""The workers of a cluster as the pool of a campaign, behind the seam of :class:`.Executor`.

Each run is one task of Dask. Its bag is moved into the campaign's folder with its result, so what a
worker that was given up still writes is never taken.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from taxinet_ros.core.provenance import Provenance, stack_id
from taxinet_ros.core.topics import RECORDER
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.errors import InfraKind, UsageError
from taxinet_ros.files.atomic import disk_error
from taxinet_ros.trials.cluster.connection import Cluster, Tell
from taxinet_ros.trials.cluster.machine import Needs
from taxinet_ros.trials.cluster.task import PYTHON, run_task
from taxinet_ros.trials.options import AUDIT, GRAPH, CampaignOptions
from taxinet_ros.trials.record.facts import read_facts
from taxinet_ros.trials.worker_pool import Answer, request_to_json, result_from_json

if TYPE_CHECKING:
    from distributed import Future

_QUEUED = 2
"""Runs for each thread of a worker: one is made while another waits."""
_INTERRUPT_S = 30.0
_MOVE_S = 10.0
_POLL_S = 0.01
CLUSTER_FOLDER = Path('logs') / 'cluster'
"""Folder within a campaign's for bags whose results are not taken yet."""


def campaign_cluster(
    campaign: CampaignOptions, where: str, *, tell: Tell = lambda line: None
) -> Cluster:
    """The cluster for a campaign, not yet connected.

    Args:
        campaign: the campaign, whose folder need not exist yet.
        where: result of :func:`.connection.check_cluster`.
        tell: called with lines on what happens to the cluster.
    """
    needs = Needs(
        perception=campaign.perception, controller=campaign.controller, world=campaign.world,
        gains=campaign.gains, folder=os.getcwd(),
        graph=campaign.engine == GRAPH or (campaign.bags and campaign.audit_percent > 0),
    )
    return Cluster(where, needs, out=campaign.out if campaign.bags else None, tell=tell)


class ClusterPool:
    """The pool of a connected cluster; a context manager.

    Attributes:
        interrupted: whether :meth:`interrupt` was called.
    """

    def __init__(
        self, cluster: Cluster, command: Sequence[str], out: Path, *, fingerprint: str = '',
        on_machine: Callable[[Provenance], None] = lambda record: None,
    ) -> None:
        """Create it.

        Args:
            cluster: the cluster, within its ``with``.
            command: command of a child, whose folder of bags is :data:`.task.OUT`.
            out: folder of the campaign, which exists.
            fingerprint: SHA-256 of the perception that every result must name, or ''.
            on_machine: called with the provenance of each other machine before its first result.
        """
        from distributed import as_completed

        self.interrupted = False
        self._cluster, self._out = cluster, out.absolute()
        self._fingerprint, self._on_machine = fingerprint, on_machine
        self._folder = self._out / CLUSTER_FOLDER if cluster.shares_folder else None
        self._job = json.dumps(dataclasses.asdict(dataclasses.replace(
            cluster.job, command=[word.replace(sys.executable, PYTHON) for word in command],
            folder='' if self._folder is None else str(self._folder),
            facts=json.dumps(read_facts(self._out)),
        )))
        self._runs: dict[Future[str], RunRequest] = {}
        self._ended = as_completed(loop=cluster.client.loop)
        self._machines: set[str] = set()
        self._interrupted_s = math.inf

    def __enter__(self) -> Self:
        """Make the folder of bags; what a lost session left there is removed.

        Raises:
            UsageError: it cannot be made.
        """
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
        if self._runs:
            self._cluster.stop()
            with contextlib.suppress(Exception):  # the cluster may be gone
                self._cluster.client.cancel(list(self._runs))
        if self._folder is not None:
            _clear(self._folder)

    @property
    def busy(self) -> int:
        """Number of runs in flight."""
        return len(self._runs)

    @property
    def free(self) -> bool:
        """Whether one more run can be started."""
        return not self.interrupted and self.busy < _QUEUED * self._cluster.threads

    def give(self, request: RunRequest) -> None:
        """Start a run."""
        future = self._cluster.submit(run_task, self._job, json.dumps(request_to_json(request)))
        self._runs[future] = request
        self._ended.add(future)

    def answers(self, timeout_s: float) -> list[Answer]:
        """The runs finished since the last call; waits for one, at most ``timeout_s``.

        Raises:
            InfraError: the cluster is gone.
        """
        if not self.interrupted:  # when ending, nobody is waited for
            self._cluster.look()
        deadline = time.monotonic() + timeout_s
        while not (ended := self._ended.next_batch(block=False)) and time.monotonic() < deadline:
            time.sleep(_POLL_S)
        found = [
            answer for future in ended if future in self._runs
            for answer in self._taken(self._runs.pop(future), future)
        ]
        if time.monotonic() - self._interrupted_s > _INTERRUPT_S:
            self._runs.clear()
        return found

    def interrupt(self) -> None:
        """Request an orderly end of current runs; those not begun are made after a resume."""
        self.interrupted = True
        self._interrupted_s = time.monotonic()
        self._cluster.stop()

    def _taken(self, request: RunRequest, future: Future[str]) -> list[Answer]:
        """The answer of a task that has ended; none if its run is to be made again, or never."""
        from distributed import KilledWorker

        try:
            told = json.loads(future.result())
        except KilledWorker as error:
            detail = f'{error.allowed_failures + 1} workers of the cluster were lost with it'
            return [(request, RunResult.infra_error(InfraKind.DIED, 'worker', detail, -1))]
        except (Exception, asyncio.CancelledError) as error:
            if self.interrupted:
                return []
            raise self._cluster.gone(f'has lost run {request.index} ({error})') from error
        unfit, result = str(told['unfit']), None
        if not unfit and told['result'] is not None:
            result = result_from_json(told['result'])
            if self._fingerprint and result.fingerprint not in ('', self._fingerprint):
                unfit = f'has another perception now (sha256 {result.fingerprint[:12]}…)'
        if unfit:
            self._cluster.set_aside(told['worker'], unfit)
            if not self.interrupted:
                self.give(request)
            return []
        if result is None:
            return []
        stack = self._stack(told['record'])
        return [(request, self._with_bag(request, result, told['bag'], stack))]

    def _stack(self, record: Mapping[str, str]) -> str:
        if not record:
            return ''
        stack = stack_id(record)
        if stack not in self._machines:
            self._machines.add(stack)
            self._on_machine(record)
        return stack

    def _with_bag(
        self, request: RunRequest, result: RunResult, bag: str, stack: str
    ) -> RunResult:
        """The result, once its bag is in the campaign's folder."""
        result = dataclasses.replace(result, stack=stack)
        if not bag or result.kind == AUDIT:  # its text names the bag of the graph, beside this one
            return result
        folder = self._out / request.run_id
        try:
            _move(Path(bag), folder)
        except FileNotFoundError:
            detail = f'its bag is not at {bag}'
            broken = RunResult.infra_error(InfraKind.BAG, RECORDER, detail, result.last_seq)
            return dataclasses.replace(broken, stack=stack)
        except OSError as error:
            raise disk_error(folder, error) from error
        return result


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
    """Remove what children left, unless their logs say something, such as of an audit."""
    for child in folder.iterdir() if folder.is_dir() else ():
        logs = (child / 'logs').rglob('*')
        if not any(path.is_dir() or path.stat().st_size for path in logs):
            shutil.rmtree(child, ignore_errors=True)
    with contextlib.suppress(OSError):
        folder.rmdir()
