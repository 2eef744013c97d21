"""The connection to a Dask cluster: its address, and which of its workers are fit for the runs.

Dask does the rest: it gives the runs of a lost or silent worker to others, and counts how many
workers a run has cost.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import logging
import os
import queue
import re
import tempfile
import threading
import time
import uuid
import warnings
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlsplit

from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_file
from taxinet_ros.trials.cluster.machine import Needs, describe, to_json
from taxinet_ros.trials.cluster.task import Job, check_worker, end_children, stop_runs

if TYPE_CHECKING:
    from distributed import Client, Future

LOCAL = 'local:'
MOST_LOCAL = 256
_ADDRESS = re.compile(r'(tcp|tls)://(\[[0-9a-fA-F:.%]+\]|[A-Za-z0-9._-]+):(\d{1,5})')
_CONNECT_S = 10.0
_WORKERS_S = 120.0
"""Time limit for a first worker."""
_PATIENCE_S = 300.0
"""Time without a fit worker after which the campaign ends."""
_LOOK_S = 1.0
_SHOWN = 3

Tell = Callable[[str], None]


def check_cluster(where: str) -> str:
    """Check the form of an address: ``local:N``, ``tcp://…``, ``tls://…``, or a scheduler file.

    Returns:
        The address, or ``local:N``.

    Raises:
        UsageError: it is none, or the file is no scheduler file.
    """
    if where.startswith(LOCAL):
        count = where.removeprefix(LOCAL)
        if not (count.isascii() and count.isdigit() and 1 <= int(count) <= MOST_LOCAL):
            raise UsageError(f'--cluster {where}: expected local:N with N within 1..{MOST_LOCAL}')
        return where
    if '://' in where:
        return _checked_address(where, f'--cluster {where}')
    path = Path(where)
    try:
        address = json.loads(read_file(path, MAX_TEXT_BYTES))['address']
    except OSError as error:
        raise UsageError(
            f'--cluster {where}: {error.strerror}; expected tcp://HOST:PORT, tls://HOST:PORT, '
            'local:N, or the file of dask scheduler --scheduler-file'
        ) from error
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise UsageError(
            f'--cluster {where}: no scheduler file, as dask scheduler --scheduler-file writes'
        ) from error
    return _checked_address(str(address), f'--cluster {where}: its address {address!s:.80}')


def _checked_address(address: str, named: str) -> str:
    match = _ADDRESS.fullmatch(address)
    if not match or not 0 < int(match[3]) < 65536:
        raise UsageError(f'{named}: expected tcp://HOST:PORT, tls://HOST:PORT or local:N')
    return address


class Cluster:
    """A connected cluster; a context manager.

    Attributes:
        name: unique name of this session of the campaign.
        job: what the tasks have in common; within the ``with``.
        client: Dask's; within the ``with``.
        threads: number of runs at a time of all fit workers.
        shares_folder: whether workers write bags below the campaign's folder.
    """

    job: Job
    client: Client

    def __init__(
        self, where: str, needs: Needs, *, out: Path | None, tell: Tell = lambda line: None
    ) -> None:
        """Create it; nothing is contacted before the ``with``.

        Args:
            where: result of :func:`check_cluster`.
            needs: what a worker needs.
            out: folder of the campaign if workers write bags below it, else None.
            tell: called with lines on what happens to the cluster.
        """
        self.name = f'taxinet-{uuid.uuid4().hex[:12]}'
        self.threads = 0
        self.shares_folder = out is not None
        self._where, self._needs, self._tell = where, needs, tell
        self._out = None if out is None else out.absolute()
        self._unfit: dict[str, str] = {}
        self._fit: list[str] = []
        self._looked_s = self._fit_s = 0.0
        self._opened = contextlib.ExitStack()

    def __enter__(self) -> Self:
        """Connect, and check the workers that are there.

        Raises:
            UsageError: Dask is missing, nothing answers at the address, or no worker is fit.
        """
        with contextlib.ExitStack() as opened:
            self.client = self._connected(opened)
            needs = to_json(self._needs)
            self.job = Job(
                campaign=self.name, needs=needs, here=to_json(describe(needs)),
                probe=self._probe(opened),
            )
            self._check_workers()
            self._opened = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Disconnect. Children on other machines end when they have been idle for a while."""
        end_children(self.name)  # of a local cluster
        self._opened.close()

    def submit(self, function: Callable[..., str], *words: str) -> Future[str]:
        """Start a task, on a fit worker if there is one: it checks that itself."""
        return self.client.submit(
            function, *words, pure=False, workers=self._fit or None,
            allow_other_workers=bool(self._fit),
        )

    def set_aside(self, worker: str, reason: str) -> None:
        """Give no more runs to a worker."""
        if worker not in self._unfit:
            self._unfit[worker] = reason
            self._tell(f'{worker}: {reason}; it gets no runs')
        self._looked_s = 0.0
        self.look()
        if not self._fit:
            time.sleep(_LOOK_S)  # else its runs would go there and back at once

    def look(self) -> None:
        """Take note of workers that came or went.

        Raises:
            InfraError: the scheduler is gone, or has had no fit worker for too long.
        """
        now = time.monotonic()
        if now - self._looked_s < _LOOK_S:
            return
        self._looked_s = now
        try:
            workers: dict[str, Any] = self.client.scheduler_info()['workers']
        except Exception as error:  # of tornado, asyncio, or the operating system
            raise self.gone(f'has been lost ({_one_line(error)})') from error
        self._fit = [address for address in workers if address not in self._unfit]
        self.threads = sum(int(workers[address]['nthreads']) for address in self._fit)
        if self._fit:
            self._fit_s = now
        elif now - self._fit_s > _PATIENCE_S:
            why = f' ({"; ".join(self._reasons)})' if self._unfit else ''
            raise self.gone(f'has had no fit worker for {now - self._fit_s:.0f} s{why}')

    @property
    def _reasons(self) -> list[str]:
        return [f'{worker}: {reason}' for worker, reason in self._unfit.items()][:_SHOWN]

    def stop(self) -> None:
        """Ask all workers to end their current runs in order; without waiting for an answer."""
        with contextlib.suppress(Exception):
            self.client.run(stop_runs, self.name, wait=False, on_error='ignore')

    def gone(self, what: str) -> InfraError:
        """The error for a cluster that can make no more runs."""
        return InfraError(
            InfraKind.DIED, f'cluster {self._where}', -1,
            f'{what}; all finished runs are recorded, continue with --resume',
        )

    # Connecting --------------------------------------------------------------------------------

    def _connected(self, opened: contextlib.ExitStack) -> Client:
        named = f'--cluster {self._where}'
        try:
            import dask
            import distributed
        except ImportError as error:
            raise UsageError(
                f"{named}: needs a package; pip install 'taxinet_ros[cluster]' ({error})"
            ) from error
        warnings.filterwarnings('ignore', module=r'distributed\.')  # versions are checked here
        # Of a busy machine; it names another module.
        warnings.filterwarnings('ignore', message='Creating scratch directories')
        for logger in list(logging.root.manager.loggerDict):
            if logger.partition('.')[0] in ('distributed', 'tornado'):
                logging.getLogger(logger).setLevel(logging.CRITICAL + 1)
        target: Any = self._where
        if self._where.startswith(LOCAL):
            scratch = opened.enter_context(tempfile.TemporaryDirectory(
                prefix='taxinet-dask-', ignore_cleanup_errors=True
            ))
            opened.enter_context(dask.config.set({'temporary-directory': scratch}))
            # Threads of this process: no port by which others of this machine could run programs.
            target = opened.enter_context(distributed.LocalCluster(
                n_workers=int(self._where.removeprefix(LOCAL)), threads_per_worker=1,
                processes=False, protocol='inproc://', dashboard_address='127.0.0.1:0',
                worker_dashboard_address='127.0.0.1:0', silence_logs=logging.CRITICAL + 1,
            ))
        elif not _loopback(self._where) and self._where.startswith('tcp:'):
            self._tell(
                f'{self._where}: neither encrypted nor authenticated: whoever reaches it can run '
                'programs on its workers and here; see docs/scaling.md for TLS'
            )
        try:
            client = opened.enter_context(_client(target))
            there, here = (client.get_versions()[each] for each in ('scheduler', 'client'))
        except Exception as error:  # whatever answers there may make Dask raise anything
            raise UsageError(
                f'{named}: no Dask scheduler answers there, or it has another version or other '
                f'TLS settings ({_one_line(error)})'
            ) from error
        for name in ('python', 'distributed'):
            one, other = ({**each['host'], **each['packages']}[name] for each in (here, there))
            if one != other:
                raise UsageError(
                    f'{named}: the scheduler has {name} {other}, here it is {one}; start it in '
                    'the same environment as here'
                )
        return client

    def _probe(self, opened: contextlib.ExitStack) -> tuple[str, str]:
        """Write a file that tells whether workers see the folder in which the campaign will be."""
        if self._out is None:
            return '', ''
        folder = next(path for path in (self._out, *self._out.parents) if path.is_dir())
        try:
            descriptor, name = tempfile.mkstemp(prefix='.taxinet-', dir=folder)
            opened.callback(Path(name).unlink, missing_ok=True)
            os.chmod(name, 0o644)  # workers may be other users
            with open(descriptor, 'w', encoding='utf-8') as file:
                file.write(self.name)
        except OSError as error:
            raise UsageError(f'--out {self._out}: cannot be written: {error.strerror}') from error
        return name, self.name

    def _check_workers(self) -> None:
        """Check all workers that are there; wait for one."""
        named = f'--cluster {self._where}'
        try:
            self.client.wait_for_workers(1, timeout=_WORKERS_S)
        except TimeoutError as error:
            raise UsageError(
                f'{named}: has no workers; start some with dask worker {self._where}'
            ) from error
        self._fit_s = time.monotonic()
        job = json.dumps(dataclasses.asdict(self.job))
        answers = self.client.run(check_worker, job, on_error='return')
        for worker, answer in answers.items():
            if reason := _unfit(answer):
                self.set_aside(worker, reason)
        self._looked_s = 0.0
        self.look()
        if not self._fit:
            raise UsageError(f'{named}: no worker is fit: {"; ".join(self._reasons)}')


def _client(target: Any) -> Client:
    """A new client; what is no scheduler may keep Dask waiting for ever."""
    from distributed import Client

    made: queue.SimpleQueue[Client | BaseException] = queue.SimpleQueue()

    def connect() -> None:
        try:
            made.put(Client(target, timeout=_CONNECT_S, set_as_default=False))
        except BaseException as error:
            made.put(error)

    threading.Thread(target=connect, name='connecting', daemon=True).start()
    try:
        client = made.get(timeout=2 * _CONNECT_S)
    except queue.Empty:
        raise TimeoutError(f'silent for {2 * _CONNECT_S:g} s') from None
    if isinstance(client, BaseException):
        raise client
    return client


def _unfit(answer: str | BaseException) -> str:
    if isinstance(answer, str):
        return str(json.loads(answer)['unfit'])
    return f'cannot be checked: {_one_line(answer)}'  # whatever another version raises


def _loopback(address: str) -> bool:
    host = urlsplit(address).hostname or ''
    return host in ('localhost', '::1') or host.startswith('127.')


def _one_line(error: BaseException) -> str:
    cause = error
    while cause.__cause__ is not None:  # the first reason says most
        cause = cause.__cause__
    text = ' '.join(str(cause).split())
    return f'{type(cause).__name__}: {text:.300}' if text else type(cause).__name__
