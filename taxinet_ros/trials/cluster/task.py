"""What a worker of a Dask cluster does: the runs of a campaign, in child processes.

Each thread of a worker drives one child like those of a local pool (:class:`.WorkerPool`), so a run
has the same environment as on one machine, and its crash costs a run. Bags go to a folder of the
child's own; the campaign takes them from there with their result, so what a lost worker still
writes never meets the bag that counts.
"""

from __future__ import annotations

import asyncio
import dataclasses
import platform
import shutil
import sys
import time
import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from distributed import Reschedule, Worker, WorkerPlugin, get_worker
from distributed.utils import sync

from taxinet_ros.core.provenance import NAMES
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.trials.cluster.machine import OUT, PYTHON, describe, difference
from taxinet_ros.trials.options import AUDIT
from taxinet_ros.trials.record.facts import FACTS
from taxinet_ros.trials.worker_pool import WorkerPool

_LOOK_S = 0.2
_RETURN_S = 0.5
Done = tuple[RunResult, Path | None, Mapping[str, str]]
"""A result, where its bag is, and the provenance of its machine unless it is the campaign's."""


class UnfitError(Exception):
    """A worker may make no more runs of a campaign; its address, and why."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """What the runs of a campaign have in common.

    Attributes:
        campaign: unique name of this session of the campaign.
        folder: its working directory.
        bags: where children make their folders, seen by all machines; None for any local place.
        command: command of a child, with :data:`.PYTHON` and :data:`.OUT`.
        facts: facts of the campaign.
    """

    campaign: str
    folder: Path
    bags: Path | None
    command: Sequence[str] = ()
    facts: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def working(self) -> Path | None:
        """The working directory, if this machine has it."""
        return self.folder if self.folder.is_dir() else None


def check_worker(
    job: Job, parts: Sequence[str], here: Mapping[str, str] | None, ignored: Collection[str],
    probe: Path | None,
) -> None:
    """Check that this worker may make runs, and let it; the task is pinned to it.

    Args:
        job: what the runs have in common.
        parts: as for :func:`.describe`.
        here: facts of the machine on which the campaign is led; None if this is it.
        ignored: facts in which this machine may differ.
        probe: a folder that all machines must see, or None.

    Raises:
        UsageError: it may make none.
    """
    record: dict[str, str] = {}
    if here is not None:
        there = describe(parts, job.working)
        if unfit := difference(here, there, ignored):
            raise UsageError(unfit)
        if probe is not None and not probe.exists():
            raise UsageError(
                f'does not see {probe.parent}, where the bags go; use a folder that all machines '
                'share'
            )
        if any(there.get(name) != here.get(name) for name in NAMES):
            record = {name: there[name] for name in NAMES if name in there}
    worker = get_worker()
    runs = Runs(job.campaign, str(worker.get_current_task()), record)
    sync(worker.loop, worker.plugin_add, plugin=runs, name=job.campaign)


def run_task(job: Job, request: RunRequest) -> Done:
    """Make a run.

    Raises:
        UnfitError: this worker may make no more runs.
    """
    worker = get_worker()
    runs: Any = worker.plugins.get(job.campaign)
    if runs is None:  # restarted at the same address, or about to leave
        time.sleep(_RETURN_S)
        raise Reschedule
    try:
        done: Done = runs.run(job, request)
    except UsageError as error:
        raise UnfitError(worker.address, str(error)) from error
    return done


async def end_runs(campaign: str, dask_worker: Worker) -> None:
    """End the runs of a campaign on this worker, and its children."""
    if campaign in dask_worker.plugins:
        await dask_worker.plugin_remove(campaign)


class Runs(WorkerPlugin):
    """The child processes of a campaign on a worker that may make its runs.

    The campaign keeps the result of :func:`check_worker`. If the campaign's process is gone, Dask
    releases that, and children end.

    Attributes:
        ended: whether runs are to be given up.
    """

    def __init__(self, campaign: str, check: str, record: Mapping[str, str]) -> None:
        self.ended = False
        self._campaign, self._check, self._record = campaign, check, record
        self._idle: list[_Child] = []
        self._busy: set[_Child] = set()

    def setup(self, worker: Worker) -> None:
        """Take note of the worker; Dask calls this when it gets the plugin."""
        self._worker = worker

    def transition(self, key: Any, start: str, finish: str, **more: Any) -> None:
        """End when the check is released; Dask calls this with each change of a task."""
        if key == self._check and finish == 'released':
            self._worker.loop.add_callback(end_runs, self._campaign, self._worker)

    async def teardown(self, worker: Worker) -> None:
        """End the children; Dask calls this when the worker ends, too."""
        self.ended = True
        while self._busy:  # their threads end them
            await asyncio.sleep(_LOOK_S)
        await asyncio.gather(*(asyncio.to_thread(child.end) for child in self._idle))

    def run(self, job: Job, request: RunRequest) -> Done:
        """Make one run; see :func:`run_task`."""
        try:
            child = self._idle.pop()
        except IndexError:
            child = _Child(job)
        self._busy.add(child)
        try:
            result, bag = child.run(request, self)
            expected = job.facts.get('perception_sha256')
            if result.fingerprint and expected and result.fingerprint != expected:
                raise UsageError(f'has another perception now (sha256 {result.fingerprint[:12]}…)')
            self._idle.append(child)
        except BaseException:
            child.end()
            raise
        finally:
            self._busy.discard(child)
        return result, bag, self._record


class _Child:
    """A child process, and the folder of its bags."""

    def __init__(self, job: Job) -> None:
        self._shared = job.bags is not None
        folder = job.bags or Path(get_worker().local_directory)
        self._folder = folder / f'{job.campaign}-{uuid.uuid4().hex[:8]}'
        try:
            self._folder.mkdir(parents=True)
            with Record(self._folder / RECORD_NAME) as record:  # whence bags get the program's text
                record.put(FACTS, '', job.facts)
        except OSError as error:
            raise UsageError(f'{self._folder}: cannot be written: {error.strerror}') from error
        command = [
            word.replace(PYTHON, sys.executable).replace(OUT, str(self._folder))
            for word in job.command
        ]
        self._pool = WorkerPool(command, 1, self._folder / 'logs', folder=job.working)
        self._pool.__enter__()

    def run(self, request: RunRequest, runs: Runs) -> tuple[RunResult, Path | None]:
        """Make one run; its result, and its bag if others see that."""
        bag = self._folder / request.run_id
        shutil.rmtree(bag, ignore_errors=True)
        self._pool.give(request)
        while not (answers := self._pool.answers(_LOOK_S)):
            if runs.ended:
                raise Reschedule
        (_, result), = answers
        if result.kind == AUDIT:  # both bags stay for whoever looks into it
            detail = f'{result.detail} (on {platform.node()})'
            return dataclasses.replace(result, detail=detail), None
        return result, bag if self._shared and bag.is_dir() else None

    def end(self) -> None:
        """End the child; remove its folder unless others see it."""
        self._pool.__exit__(None, None, None)
        if not self._shared:
            shutil.rmtree(self._folder, ignore_errors=True)
