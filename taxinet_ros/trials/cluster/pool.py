"""The workers of a Dask cluster as the pool of a campaign, behind the seam of :class:`.Executor`.

Each run is one task of Dask, which gives the runs of a lost or silent worker to others and counts
how many workers a run has cost. A bag is moved into the campaign's folder with its result.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import logging
import re
import shutil
import sys
import tempfile
import time
import uuid
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from taxinet_ros.core.provenance import Provenance, stack_id
from taxinet_ros.core.topics import RECORDER
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.files.atomic import disk_error
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_file
from taxinet_ros.trials.cluster.machine import PYTHON, describe, ignored_facts
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.worker_pool import Answer

if TYPE_CHECKING:
    from distributed import Client, Future

    from taxinet_ros.trials.cluster.task import Done, Job

LOCAL = 'local:'
MOST_LOCAL = 256
_FORMS = 'tcp://HOST:PORT, tls://HOST:PORT, local:N, or the file of dask scheduler --scheduler-file'
_ADDRESS = re.compile(r'(tcp|tls)://(\[[0-9a-fA-F:.%]+\]|[A-Za-z0-9._-]+):(\d{1,5})')
_ENCRYPTED_OR_HERE = re.compile(r'tls:|tcp://(127\.|localhost:|\[::1\])')
_CONNECT_S = 10.0
_QUEUED = 2
"""Runs for each thread of a worker: one is made while another waits."""
_WORKERS_S = 120.0
"""Time limit for a first worker, and for the checks of those that are there."""
_PATIENCE_S = 300.0
"""Time without a fit worker after which the campaign ends."""
_LOOK_S = 1.0
_POLL_S = 0.005
_END_S = 10.0

Tell = Callable[[str], None]


def check_cluster(where: str) -> str:
    """Check the form of an address: ``local:N``, ``tcp://…``, ``tls://…``, or a scheduler file.

    Returns:
        The address, or ``local:N``.

    Raises:
        UsageError: it is none, or the file is no scheduler file.
    """
    named, address = f'cluster {where}', where
    if where.startswith(LOCAL):
        count = where.removeprefix(LOCAL)
        if not (count.isascii() and count.isdigit() and 1 <= int(count) <= MOST_LOCAL):
            raise UsageError(f'{named}: expected local:N with N within 1..{MOST_LOCAL}')
        return where
    if '://' not in where:
        try:
            address = str(json.loads(read_file(Path(where), MAX_TEXT_BYTES))['address'])
        except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
            reason = getattr(error, 'strerror', None) or 'no scheduler file'
            raise UsageError(f'{named}: {reason}; expected {_FORMS}') from error
        named += f': its address {address:.80}'
    match = _ADDRESS.fullmatch(address)
    if not match or not 0 < int(match[3]) < 65536:
        raise UsageError(f'{named}: expected {_FORMS}')
    return address


@contextlib.contextmanager
def campaign_cluster(
    campaign: CampaignOptions, where: str, *, tell: Tell = lambda line: None
) -> Iterator[ClusterPool]:
    """Context of a connected cluster, of which a worker may make runs of a campaign.

    Args:
        campaign: the campaign, whose folder need not exist yet.
        where: result of :func:`check_cluster`.
        tell: called with lines on what happens to the cluster.

    Raises:
        UsageError: Dask is missing, nothing answers at the address, or no worker is fit.
    """
    out = campaign.out.absolute()
    with contextlib.ExitStack() as opened:
        client = opened.enter_context(connection(where, tell))
        from taxinet_ros.trials.cluster.task import Job, check_worker

        probe = None
        if campaign.bags:  # by which workers see that they have the folder where ``out`` will be
            parent = next(path for path in (out, *out.parents) if path.is_dir())
            try:
                probe = Path(opened.enter_context(tempfile.TemporaryDirectory(
                    prefix='.taxinet-', dir=parent, ignore_cleanup_errors=True
                )))
            except OSError as error:
                raise UsageError(f'out {out}: cannot be written: {error.strerror}') from error
        job = Job(
            campaign=f'taxinet-{uuid.uuid4().hex[:12]}', folder=Path.cwd(),
            bags=out / 'logs' / 'cluster' if campaign.bags else None,
        )
        gains = json.dumps(dict(campaign.gains))
        parts = [campaign.perception, campaign.controller, gains, campaign.world]
        check = partial(
            check_worker, job, parts, None if where.startswith(LOCAL) else describe(parts, None),
            ignored_facts(campaign), probe,
        )
        pool = ClusterPool(client, where, out, job, check, tell)
        pool.wait_for_workers()
        yield pool


@contextlib.contextmanager
def connection(where: str, tell: Tell) -> Iterator[Client]:
    """Context of the client of a cluster.

    Args:
        where: result of :func:`check_cluster`.
        tell: called with a warning if the connection is open to others.

    Raises:
        UsageError: Dask is missing, or no scheduler answers.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise UsageError(
            f"cluster {where}: needs a package; pip install 'taxinet_ros[cluster]' ({error})"
        ) from error
    warnings.filterwarnings('ignore', module=r'distributed\.')  # such as of other versions
    # Of a busy machine; it names another module.
    warnings.filterwarnings('ignore', message='Creating scratch directories')
    for logger in list(logging.root.manager.loggerDict):
        if logger.partition('.')[0] in ('distributed', 'tornado'):
            logging.getLogger(logger).setLevel(logging.CRITICAL + 1)
    with contextlib.ExitStack() as opened:
        target: Any = where
        if where.startswith(LOCAL):
            scratch = tempfile.TemporaryDirectory(prefix='taxinet-', ignore_cleanup_errors=True)
            folder = opened.enter_context(scratch)
            opened.enter_context(dask.config.set({'temporary-directory': folder}))
            # Threads of this process: no port by which others of this machine could run programs.
            target = opened.enter_context(LocalCluster(
                n_workers=int(where.removeprefix(LOCAL)), threads_per_worker=1, processes=False,
                protocol='inproc://', dashboard_address='127.0.0.1:0',
                worker_dashboard_address='127.0.0.1:0', silence_logs=logging.CRITICAL + 1,
            ))
        else:
            _check_scheduler(where)
            if not _ENCRYPTED_OR_HERE.match(where):
                tell(
                    f'{where}: neither encrypted nor authenticated: whoever reaches it can run '
                    'programs on its workers and here; see docs/scaling.md for TLS'
                )
        yield opened.enter_context(Client(target, timeout=_CONNECT_S, set_as_default=False))


def _check_scheduler(where: str) -> None:
    """Check that a scheduler of this version answers; Dask's client would wait for ever."""
    from distributed import Security, rpc
    from distributed.versions import get_versions

    async def versions() -> Any:
        arguments = Security().get_connection_args('client')
        async with rpc(where, connection_args=arguments) as scheduler:
            return await asyncio.wait_for(scheduler.versions(), _CONNECT_S)

    try:
        with ThreadPoolExecutor(1) as thread:  # this one may run an event loop of its own
            there = thread.submit(asyncio.run, versions()).result()['packages']
    except Exception as error:  # whatever answers there may make Dask raise anything
        raise UsageError(
            f'cluster {where}: no Dask scheduler answers there, or it has other TLS settings '
            f'({_one_line(error)})'
        ) from error
    here = get_versions()['packages']
    for name in ('python', 'distributed'):
        if there[name] != here[name]:
            raise UsageError(
                f'cluster {where}: the scheduler has {name} {there[name]}, here it is '
                f'{here[name]}; start it in the same environment as here'
            )


def _one_line(error: BaseException | None) -> str:
    """The first cause of an error, on one line."""
    while error is not None and error.__cause__ is not None:
        error = error.__cause__
    text = ' '.join(str(error).split())
    return f'{type(error).__name__}: {text:.300}' if text else type(error).__name__


class ClusterPool:
    """The workers of a connected cluster that are fit for a campaign.

    Attributes:
        interrupted: whether :meth:`interrupt` was called.
        threads: number of runs at a time of all fit workers.
    """

    def __init__(
        self, client: Client, where: str, out: Path, job: Job, check: Callable[[], None],
        tell: Tell,
    ) -> None:
        from distributed import as_completed

        self.interrupted = False
        self.threads = 0
        self._client, self._where, self._out, self._job = client, where, out, job
        self._check, self._tell = check, tell
        self._on_machine: Callable[[Provenance], None] = lambda record: None
        self._checks: dict[str, Future[None]] = {}
        self._unfit: dict[str, str] = {}
        self._fit: frozenset[str] = frozenset()
        self._looked_s = self._fit_s = time.monotonic()
        self._runs: dict[Future[Done], tuple[RunRequest, frozenset[str]]] = {}
        self._completed = as_completed((), loop=client.loop, with_results=True, raise_errors=False)

    @contextlib.contextmanager
    def making(
        self, command: Sequence[str], facts: Mapping[str, Any],
        on_machine: Callable[[Provenance], None] = lambda record: None,
    ) -> Iterator[Self]:
        """Context in which runs are made, in the campaign's folder, which exists.

        Args:
            command: command of a child, whose folder of bags is :data:`.OUT`.
            facts: facts of the campaign.
            on_machine: called with the provenance of another machine before each of its results.

        Raises:
            UsageError: the folder of bags cannot be made.
        """
        self._on_machine = on_machine
        command = [word.replace(sys.executable, PYTHON) for word in command]
        self._job = dataclasses.replace(self._job, command=command, facts=dict(facts))
        bags = self._job.bags
        if bags is not None:
            _clear(bags)  # of a lost session
            try:
                bags.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise UsageError(f'{bags}: cannot be written: {error.strerror}') from error
        try:
            yield self
        finally:
            self._cancel()
            self._wait_for_children()
            if bags is not None:
                _clear(bags)

    def _cancel(self) -> None:
        with contextlib.suppress(Exception):  # of a lost cluster
            self._client.cancel(list(self._runs))
        self._runs.clear()

    def _wait_for_children(self) -> None:
        from taxinet_ros.trials.cluster.task import end_runs

        with contextlib.suppress(Exception):  # of a lost cluster, or a silent worker
            self._client.run(
                end_runs, self._job.campaign, on_error='ignore', callback_timeout=_END_S
            )

    @property
    def busy(self) -> int:
        """Number of runs in flight."""
        return len(self._runs)

    @property
    def free(self) -> bool:
        """Whether one more run can be started."""
        return not self.interrupted and self.busy < max(1, _QUEUED * self.threads)

    def give(self, request: RunRequest) -> None:
        """Start a run, on one of the workers that are fit now."""
        from taxinet_ros.trials.cluster.task import run_task

        future = self._client.submit(
            run_task, self._job, request, pure=False, workers=list(self._fit)
        )
        self._runs[future] = request, self._fit
        self._completed.add(future)

    def answers(self, timeout_s: float) -> list[Answer]:
        """The runs finished since the last call; waits for one, at most ``timeout_s``.

        Raises:
            InfraError: the cluster is gone.
        """
        now_s = time.monotonic()
        if now_s - self._looked_s > _LOOK_S:
            self._look()
        while not self._completed.has_ready() and time.monotonic() - now_s < timeout_s:
            time.sleep(_POLL_S)
        ended = self._completed.next_batch(block=False)
        answers = [answer for future, done in ended for answer in self._taken(future, done)]
        # What fails when it is made again, its result being lost with a worker, is not among them.
        failed = [future for future in self._runs if future.status == 'error']
        return answers + [
            answer for future in failed for answer in self._taken(future, future.exception())
        ]

    def interrupt(self) -> None:
        """Give up all runs in flight, which are made after a resume."""
        self.interrupted = True
        self._cancel()

    # Workers -----------------------------------------------------------------------------------

    def wait_for_workers(self) -> None:
        """Wait until the workers that are there are checked, and one of them is fit.

        Raises:
            UsageError: there is none.
        """
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < _WORKERS_S:
            self._look()
            if self._checks and all(check.done() for check in self._checks.values()):
                break
            time.sleep(_POLL_S)
        if not self._fit:
            raise UsageError(f'cluster {self._where}: ' + (
                f'no worker is fit: {self._reasons}' if self._unfit else
                f'has no workers; start some with dask worker {self._where}'
            ))

    def _look(self) -> None:
        """Take note of workers that came or went, and of those that are unfit."""
        scheduler = self._client.scheduler
        if scheduler is None:
            raise self._gone('has been lost')
        try:
            # What Client.scheduler_info() gives may be another question's answer, without workers.
            asked = self._client.sync(scheduler.identity)
            threads = {worker: info['nthreads'] for worker, info in asked['workers'].items()}
        except Exception as error:  # of tornado, asyncio, or the operating system
            raise self._gone(f'has been lost ({_one_line(error)})') from error
        for worker in self._checks.keys() - threads.keys():
            del self._checks[worker]
            self._unfit.pop(worker, None)
        for worker in threads.keys() - self._checks.keys():
            self._checks[worker] = self._client.submit(
                self._check, workers=[worker], priority=1, pure=False
            )
        for worker, check in self._checks.items():
            if check.status == 'error':
                cause = check.exception()
                self._set_aside(worker, str(cause) if isinstance(cause, UsageError) else
                                f'cannot be checked: {_one_line(cause)}')
        self._fit = frozenset(
            worker for worker, check in self._checks.items()
            if check.status == 'finished' and worker not in self._unfit
        )
        self.threads = sum(threads[worker] for worker in self._fit)
        self._looked_s = time.monotonic()
        if self._fit:
            self._fit_s = self._looked_s
            self._give_again()
        elif self._looked_s - self._fit_s > _PATIENCE_S:
            raise self._gone(f'has had no fit worker for {_PATIENCE_S:.0f} s'
                             + (f' ({self._reasons})' if self._unfit else ''))

    def _give_again(self) -> None:
        """Start runs anew that would wait for workers that are gone."""
        for future, (request, possible) in list(self._runs.items()):
            if not self._fit & possible:
                del self._runs[future]
                future.cancel()
                self.give(request)

    def _set_aside(self, worker: str, reason: str) -> None:
        if worker not in self._unfit:
            self._unfit[worker] = reason
            self._tell(f'{worker}: {reason}; it gets no runs')
        self._fit -= {worker}

    @property
    def _reasons(self) -> str:
        return '; '.join(f'{worker}: {reason}' for worker, reason in self._unfit.items())

    def _gone(self, what: str) -> InfraError:
        return InfraError(
            InfraKind.DIED, f'cluster {self._where}', -1,
            f'{what}; resume it: all finished runs are recorded',
        )

    # Results -----------------------------------------------------------------------------------

    def _taken(self, future: Future[Done], done: Any) -> Iterator[Answer]:
        """The answer of a task that has ended with ``done``, unless its run is made again."""
        from distributed import KilledWorker

        from taxinet_ros.trials.cluster.task import UnfitError

        if future not in self._runs:  # it was cancelled
            return
        request, _ = self._runs.pop(future)
        # Dask gives an exception also as a tuple with its class.
        error = done if isinstance(done, BaseException) else done[1]
        if not isinstance(error, BaseException):
            yield request, self._in_place(request, *done)
            return
        if isinstance(error, UnfitError):
            self._set_aside(*error.args)
            self.give(request)
        elif isinstance(error, KilledWorker):
            detail = f'{error.allowed_failures + 1} workers of the cluster were lost with it'
            yield request, RunResult.infra_error(InfraKind.DIED, 'worker', detail, -1)
        else:
            raise self._gone(f'has lost run {request.index} ({_one_line(error)})')

    def _in_place(
        self, request: RunRequest, result: RunResult, bag: Path | None, record: Provenance
    ) -> RunResult:
        """A result with the name of its machine, once its bag is in the campaign's folder."""
        if record:
            self._on_machine(record)
            result = dataclasses.replace(result, stack=stack_id(record))
        if bag is None:
            return result
        folder = self._out / request.run_id
        try:
            bag.rename(folder)
        except FileNotFoundError:
            detail = f'its bag is not at {bag}'
            broken = RunResult.infra_error(InfraKind.BAG, RECORDER, detail, result.last_seq)
            return dataclasses.replace(broken, stack=result.stack)
        except OSError as error:
            raise disk_error(folder, error) from error
        return result


def _clear(folder: Path) -> None:
    """Remove what children left, unless their logs say something, such as of an audit."""
    for child in folder.iterdir() if folder.is_dir() else ():
        logs = (child / 'logs').rglob('*')
        if not any(path.is_dir() or path.stat().st_size for path in logs):
            shutil.rmtree(child, ignore_errors=True)
    with contextlib.suppress(OSError):
        folder.rmdir()
