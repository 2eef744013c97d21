"""What a worker of a Dask cluster does: a run of a campaign, in a child process.

Each thread of a Dask worker drives one child like those of a local pool
(:class:`.worker_pool.WorkerPool`), so a run has the same environment as on one machine, and its
crash costs a run. The child stays for the next task of its campaign, and ends when it is idle.
Bags go to a folder of the child's own; the campaign takes them from there with their result, so
what a lost worker still writes never meets the bag that counts.
"""

from __future__ import annotations

import atexit
import contextlib
import dataclasses
import json
import platform
import shutil
import sys
import tempfile
import threading
import uuid
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.trials.cluster.machine import Machine, Needs, describe, difference
from taxinet_ros.trials.options import AUDIT
from taxinet_ros.trials.record.facts import FACTS
from taxinet_ros.trials.worker_pool import (
    SILENCE_S,
    WorkerPool,
    request_from_json,
    result_to_json,
)

PYTHON, OUT = '@PYTHON@', '@OUT@'
"""Words in the command of a child for this machine's Python, and for the folder of its bags."""
_IDLE_S = 60.0
_LOOK_S = 0.2


@dataclass(frozen=True, kw_only=True)
class Job:
    """What the tasks of a campaign have in common.

    Attributes:
        campaign: unique name of this session of the campaign.
        command: command of a child, with :data:`PYTHON` and :data:`OUT`.
        facts: facts of the campaign, as JSON.
        needs: text of :class:`.Needs`.
        here: text of the :class:`.Machine` on which the campaign is led.
        folder: where children make their folders, seen by all machines; '' for any local place.
        probe: file in a folder that all machines must see, with its content; ('', '') for none.
    """

    campaign: str
    command: Sequence[str] = ()
    facts: str = ''
    needs: str
    here: str
    folder: str = ''
    probe: Sequence[str] = ('', '')


def check_worker(job: str) -> str:
    """Check that this worker may make runs.

    Args:
        job: :class:`Job` as JSON.

    Returns:
        JSON: ``unfit``, the reason why not or ''; and ``record``, the provenance of this machine if
        it is not that of the campaign's.
    """
    asked = Job(**json.loads(job))
    try:
        there = describe(asked.needs)
    except UsageError as error:
        return json.dumps({'unfit': str(error)})
    here = Machine(**json.loads(asked.here))
    unfit = difference(here, there, Needs(**json.loads(asked.needs))) or _unseen(asked.probe)
    record = {} if there.record == here.record else dict(there.record)
    return json.dumps({'unfit': unfit, 'record': record})


def _unseen(probe: Sequence[str]) -> str:
    name, text = probe
    if not name:
        return ''
    with contextlib.suppress(OSError):
        if Path(name).read_text(encoding='utf-8') == text:
            return ''
    return (
        f'does not see {Path(name).parent}, where the bags go; use an --out that all machines share'
    )


def run_task(job: str, request: str) -> str:
    """Make a run.

    Args:
        job: :class:`Job` as JSON.
        request: the request as JSON.

    Returns:
        JSON: as :func:`check_worker`; and ``worker``, this worker's address; ``result``, None if
        the run was not made; and ``bag``, its folder, or ''.
    """
    from distributed import get_worker

    told = {**json.loads(check_worker(job)), 'worker': get_worker().address, 'result': None}
    asked = Job(**json.loads(job))
    if told['unfit'] or asked.campaign in _STOPPED:
        return json.dumps(told)
    bench = None
    try:
        bench = _take_bench(asked)
        told |= bench.run(json.loads(request))
    except UsageError as error:
        told['unfit'] = str(error)
    finally:
        if bench is not None:
            _put_back(bench)
    return json.dumps(told)


def stop_runs(campaign: str) -> None:
    """End the runs of a campaign on this worker in order; those that wait are not begun."""
    _STOPPED.add(campaign)


class _Bench:
    """A child process, and the folder of its bags.

    Attributes:
        job: its campaign.
        runs: number of runs that it was given.
    """

    def __init__(self, job: Job) -> None:
        self.job, self.runs, self._kept = job, 0, False
        place = Path(job.folder) if job.folder else Path(_local_folder())
        try:
            self._folder = place / f'{job.campaign}-{uuid.uuid4().hex[:8]}'
            self._folder.mkdir(parents=True)
            with Record(self._folder / RECORD_NAME) as record:  # whence bags get the program's text
                record.put(FACTS, '', json.loads(job.facts))
        except OSError as error:
            raise UsageError(f'{self._folder}: cannot be written: {error.strerror}') from error
        command = [
            word.replace(PYTHON, sys.executable).replace(OUT, str(self._folder))
            for word in job.command
        ]
        working = str(json.loads(job.needs)['folder'])
        self._pool = WorkerPool(
            command, 1, self._folder / 'logs', SILENCE_S,
            folder=Path(working) if Path(working).is_dir() else None,
        ).__enter__()

    def run(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Make one run; see :func:`run_task`."""
        self.runs += 1
        request = request_from_json(values)
        bag = self._folder / request.run_id
        shutil.rmtree(bag, ignore_errors=True)
        self._pool.give(request)
        while not (answers := self._pool.answers(_LOOK_S)):
            if self.job.campaign in _STOPPED and not self._pool.interrupted:
                self._pool.interrupt()
        (_, result), = answers
        if result.kind == AUDIT:  # both bags stay for whoever looks into it
            self._kept = True
            where = f'{result.detail} (on {platform.node()})'
            result = dataclasses.replace(result, detail=where)
        shared = self.job.folder and bag.is_dir()
        return {'result': result_to_json(result), 'bag': str(bag) if shared else ''}

    def end(self) -> None:
        """End the child; remove its folder unless others see it."""
        self._pool.__exit__(None, None, None)
        if not (self.job.folder or self._kept):
            shutil.rmtree(self._folder, ignore_errors=True)


_STOPPED: set[str] = set()
_IDLE: dict[str, list[_Bench]] = defaultdict(list)
_LOCK = threading.Lock()


def _take_bench(job: Job) -> _Bench:
    with _LOCK:
        if _IDLE[job.campaign]:
            return _IDLE[job.campaign].pop()
    return _Bench(job)


def _put_back(bench: _Bench) -> None:
    campaign = bench.job.campaign
    if campaign in _STOPPED:
        bench.end()
        return
    with _LOCK:
        _IDLE[campaign].append(bench)
    # The leader of the campaign may have been lost, and nobody else would end it.
    timer = threading.Timer(_IDLE_S, _end_if_idle, (bench, bench.runs))
    timer.daemon = True
    timer.start()


def _end_if_idle(bench: _Bench, runs: int) -> None:
    with _LOCK:
        idle = _IDLE[bench.job.campaign]
        if bench not in idle or bench.runs != runs:
            return
        idle.remove(bench)
    bench.end()


def end_children(campaign: str = '') -> None:
    """End the idle children of a campaign, or of all."""
    with _LOCK:
        benches = [
            bench for name in ([campaign] if campaign else list(_IDLE))
            for bench in _IDLE.pop(name, ())
        ]
    for bench in benches:
        bench.end()


atexit.register(end_children)


def _local_folder() -> str:
    """Folder of this Dask worker, which Dask removes after it; else one for temporary files."""
    from distributed import get_worker

    with contextlib.suppress(ValueError):
        return str(get_worker().local_directory)
    return tempfile.gettempdir()
