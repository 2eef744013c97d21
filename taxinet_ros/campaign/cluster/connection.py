"""The connection to a Dask cluster: its address, its workers, and what becomes of them.

Dask carries tasks and results; which worker gets which runs is decided here, so that a worker that
is lost, silent or unfit is known by name. A scheduler that restarts, or a connection that was cut,
is waited for; whatever was in flight then is given out again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import logging
import os
import platform
import re
import socket
import tempfile
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlsplit

from taxinet_ros.campaign.cluster.machine import Needs, describe, to_json
from taxinet_ros.campaign.cluster.task import Job, check_worker, end_children, stop_runs
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_file

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

LOCAL = 'local:'
MOST_LOCAL = 256
_ADDRESS = re.compile(r'(tcp|tls)://(\[[0-9a-fA-F:.%]+\]|[A-Za-z0-9._-]+):(\d{1,5})')
_ANSWER_S = 5.0
_AGAIN_S = 1.0
_SHOWN = 3

Tell = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Limits:
    """How long a cluster is waited for [s].

    Attributes:
        silence_s: without a sign of life, a worker is put aside.
        patience_s: without a scheduler or a fit worker, the campaign ends.
        begin_s: without a fit worker at the start, it does not begin.
        connect_s: for a scheduler to answer at first.
    """

    silence_s: float = 30.0
    patience_s: float = 300.0
    begin_s: float = 120.0
    connect_s: float = 10.0


LIMITS = Limits()


@dataclass
class _Worker:
    """A worker of the cluster, as far as it is known.

    Attributes:
        threads: number of runs at a time.
        checked: its pending check, or None.
        fit: whether it gets runs; None before its check.
        last_seen: when the scheduler last heard of it, by the scheduler's clock [s].
        changed_s: when that was last noticed here, on the monotonic clock [s].
        silent: whether it was put aside for its silence.
    """

    threads: int
    last_seen: float
    changed_s: float
    checked: Future[str] | None = None
    fit: bool | None = None
    silent: bool = False


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
        workers: number of runs at a time of each fit worker, by address.
        connection: counts connections; tasks of an earlier one are lost.
        job: what the tasks have in common; within the ``with``.
    """

    def __init__(
        self, where: str, needs: Needs, *, out: Path | None,
        tell: Tell = lambda line: None, limits: Limits = LIMITS,
    ) -> None:
        """Create it; nothing is contacted before the ``with``.

        Args:
            where: result of :func:`check_cluster`.
            needs: what a worker needs.
            out: folder of the campaign if workers write bags below it, else None.
            tell: called with lines on what happens to the cluster.
            limits: how long to wait.
        """
        self.name = f'taxinet-{uuid.uuid4().hex[:12]}'
        self.workers: dict[str, int] = {}
        self.connection = 0
        self.job: Job
        self._where, self._needs, self._tell, self._limits = where, needs, tell, limits
        self._out = None if out is None else out.absolute()
        self._known: dict[str, _Worker] = {}
        self._client: Client | None = None
        self._local: LocalCluster | None = None
        self._looked_s = self._fit_s = -1e9
        self._left = contextlib.ExitStack()
        self._reason = self._scheduler = ''

    def __enter__(self) -> Self:
        """Connect, and check the workers that are there.

        Raises:
            UsageError: Dask is missing, nothing answers at the address, or no worker is fit.
        """
        with contextlib.ExitStack() as left:
            if self._where.startswith(LOCAL):
                left.enter_context(_scratch())
            left.callback(self._close)
            self._connect_first()
            needs = to_json(self._needs)
            self.job = Job(
                campaign=self.name, needs=needs, here=to_json(describe(needs)),
                probe=self._probe(left),
            )
            self._await_workers()
            self._left = left.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the campaign's children on the workers, and disconnect."""
        self._left.close()

    @property
    def shares_folder(self) -> bool:
        """Whether workers write bags below the campaign's folder."""
        return self._out is not None

    @property
    def threads(self) -> int:
        """Number of runs at a time of all fit workers."""
        return sum(self.workers.values())

    def submit(self, worker: str, function: Callable[..., str], *words: str) -> tuple[str, Any]:
        """Start a task on a worker; return its key and its future."""
        assert self._client is not None
        key = f'{self.name}-{uuid.uuid4().hex}'
        future = self._client.submit(
            function, *words, key=key, workers=[worker], allow_other_workers=False, pure=False,
        )
        return key, future

    def take_aside(self, worker: str, reason: str) -> None:
        """Give no more runs to a worker."""
        if worker in self.workers:
            del self.workers[worker]
            self._known[worker].fit = False
            self._reason = f'{worker}: {reason}'
            self._tell(f'{worker}: {reason}; it gets no runs')

    def note_cut(self) -> None:
        """Take note that Dask has lost its tasks, as it does when it has to connect again."""
        self.connection += 1
        self._tell(f'{self._where}: the connection was lost; runs in flight are given out again')

    def stop(self) -> None:
        """Ask all workers to end their current runs in order; at once, and without an answer."""
        self._tell_workers(stop_runs)

    def watch(self) -> None:
        """Take note of workers that came, went, are silent, or were checked.

        Raises:
            InfraError: the scheduler, or every fit worker, has been gone for too long.
        """
        now = time.monotonic()
        if now - self._looked_s < _AGAIN_S * max(1.0, len(self._known) / 100):
            return
        census = self._census()
        if census is None:
            self._reconnect()
        else:
            self._take_census(census)
        self._take_checks()
        self._looked_s = time.monotonic()
        if self.workers:
            self._fit_s = self._looked_s
        elif (waited_s := self._looked_s - self._fit_s) > self._limits.patience_s:
            why = f' ({self._reason})' if self._reason else ''
            raise self._gone(f'has had no fit worker for {waited_s:.0f} s{why}')

    # Connecting --------------------------------------------------------------------------------

    def _connect_first(self) -> None:
        named = f'--cluster {self._where}'
        try:
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
        if self._where.startswith(LOCAL):
            # Threads of this process: no port by which others of this machine could run programs.
            self._local = distributed.LocalCluster(
                n_workers=int(self._where.removeprefix(LOCAL)), threads_per_worker=1,
                processes=False, protocol='inproc://', dashboard_address='127.0.0.1:0',
                worker_dashboard_address='127.0.0.1:0', silence_logs=logging.CRITICAL + 1,
            )
        elif not _loopback(self._where) and self._where.startswith('tcp:'):
            self._tell(
                f'{self._where}: neither encrypted nor authenticated: whoever reaches it can run '
                'programs on its workers and here; see docs/scaling.md for TLS'
            )
        if self._local is None:
            self._check_answers(named)
        try:
            self._client = self._connected(self._limits.connect_s)
        except _NotConnectedError as error:
            raise UsageError(
                f'{named}: what answers there is no Dask scheduler, or has other TLS settings '
                f'({error})'
            ) from error
        self._check_scheduler(named)

    def _check_answers(self, named: str) -> None:
        """Check that somebody listens at the address, which Dask would say late and vaguely."""
        place = urlsplit(self._where)
        try:
            with socket.create_connection(
                (place.hostname or '', place.port or 0), self._limits.connect_s
            ):
                pass
        except OSError as error:
            raise UsageError(
                f'{named}: nobody answers there ({error.strerror or error}); start it with dask '
                'scheduler'
            ) from error

    def _connected(self, timeout_s: float) -> Client:
        """A new client; a server of another kind may never answer, or with anything."""
        from distributed import Client

        made: list[Client] = []
        failed: list[BaseException] = []
        target: Any = self._local or self._where

        def connect() -> None:
            try:
                made.append(Client(target, timeout=timeout_s, set_as_default=False))
            except BaseException as error:
                failed.append(error)

        thread = threading.Thread(target=connect, name='connecting', daemon=True)
        thread.start()
        thread.join(2 * timeout_s)
        if made:
            self.connection += 1
            return made[0]
        raise _NotConnectedError(_one_line(failed[0]) if failed else f'silent for {timeout_s:g} s')

    def _check_scheduler(self, named: str) -> None:
        """Check that the scheduler can read what is sent to it: that it has the same Dask."""
        assert self._client is not None
        here = _versions()
        try:
            there = self._client.run_on_scheduler(_versions)
        except Exception as error:
            raise UsageError(
                f'{named}: the scheduler cannot read what taxinet_ros sends ({_one_line(error)}); '
                'start it in the same environment as here'
            ) from error
        for name, version in here.items():
            if there[name] != version:
                raise UsageError(
                    f'{named}: the scheduler has {name} {there[name]}, here it is {version}; start '
                    'it in the same environment as here'
                )

    def _probe(self, left: contextlib.ExitStack) -> Sequence[str]:
        """Write a file that tells whether workers see the folder in which the campaign will be."""
        if self._out is None:
            return ('', '')
        folder = next(path for path in (self._out, *self._out.parents) if path.is_dir())
        try:
            descriptor, name = tempfile.mkstemp(prefix='.taxinet-', dir=folder)
            left.callback(Path(name).unlink, missing_ok=True)
            os.chmod(name, 0o644)  # workers may be other users
            with open(descriptor, 'w', encoding='utf-8') as file:
                file.write(self.name)
        except OSError as error:
            raise UsageError(f'--out {self._out}: cannot be written: {error.strerror}') from error
        return (name, self.name)

    def _await_workers(self) -> None:
        """Wait for a fit worker, and for the checks of all that are there."""
        begun_s = time.monotonic()
        self._fit_s = begun_s
        waiting = False
        while True:
            self._looked_s = -1e9
            self.watch()
            checking = [one for one in self._known.values() if one.checked is not None]
            if self.workers and not checking:
                return
            if self._known and not self.workers and not checking:
                raise UsageError(f'--cluster {self._where}: no worker is fit: {self._reason}')
            if time.monotonic() - begun_s > self._limits.begin_s:
                if self.workers:
                    return
                raise UsageError(
                    f'--cluster {self._where}: ' + (
                        f'no answer of its workers for {self._limits.begin_s:g} s' if checking else
                        f'has no workers; start some with dask worker {self._where}'
                    )
                )
            if not self._known and not waiting:
                waiting = True
                self._tell(f'{self._where}: waiting for workers')
            time.sleep(0.1)

    # Watching ----------------------------------------------------------------------------------

    def _census(self) -> dict[str, Any] | None:
        """The scheduler's workers by address; None if it does not answer."""
        client = self._client
        if client is None or client.status != 'running':
            return None
        try:
            scheduler: Any = client.scheduler
            found = client.sync(scheduler.identity, n_workers=-1, callback_timeout=_ANSWER_S)
        except Exception:  # of tornado, asyncio, or the operating system
            return None
        if found['id'] != self._scheduler:
            if self._scheduler and self._known:
                self._tell(
                    f'{self._where}: the scheduler was restarted; all runs in flight are given '
                    'out again'
                )
                self._forget()
            self._scheduler = found['id']
        workers: dict[str, Any] = found['workers']
        return workers

    def _reconnect(self) -> None:
        """Replace the connection, which is lost with all that was in flight.

        Raises:
            InfraError: the scheduler has been gone for too long.
        """
        if self._client is not None:
            self._tell(f'{self._where}: the connection is lost; trying to connect again')
            self._forget()
            self._drop_client()
        try:
            self._client = self._connected(2.0)
            self._tell(f'{self._where}: connected again')
        except _NotConnectedError as error:
            waited_s = time.monotonic() - self._fit_s
            if waited_s > self._limits.patience_s:
                raise self._gone(f'has not answered for {waited_s:.0f} s: {error}') from error

    def _forget(self) -> None:
        """Forget all workers, and with the connection all tasks."""
        self._known.clear()
        self.workers.clear()
        self.connection += 1

    def _take_census(self, census: dict[str, Any]) -> None:
        now = time.monotonic()
        for address in self._known.keys() - census.keys():
            gone = self._known.pop(address)
            if self.workers.pop(address, None) is not None or gone.silent:
                self._tell(f'{address}: lost; its runs are given to others')
        for address, told in census.items():
            worker = self._known.get(address)
            if worker is None:
                worker = self._known[address] = _Worker(
                    threads=int(told['nthreads']), last_seen=told['last_seen'], changed_s=now,
                )
                _, worker.checked = self.submit(address, check_worker, self._job_text())
            elif told['last_seen'] != worker.last_seen:
                worker.last_seen, worker.changed_s = told['last_seen'], now
                if worker.silent:
                    worker.silent = False
                    self.workers[address] = worker.threads
                    self._tell(f'{address}: is back')
            elif now - worker.changed_s > self._limits.silence_s and address in self.workers:
                worker.silent = True
                del self.workers[address]
                self._tell(
                    f'{address}: silent for {self._limits.silence_s:g} s; its runs are given to '
                    'others'
                )

    def _take_checks(self) -> None:
        unfit: dict[str, list[str]] = {}
        for address, worker in list(self._known.items()):
            if worker.checked is None or not worker.checked.done():
                continue
            if worker.checked.status == 'cancelled':  # with the connection: it is checked again
                del self._known[address]
                continue
            future, worker.checked = worker.checked, None
            reason = self._unfit(future)
            worker.fit = not reason
            if reason:
                unfit.setdefault(reason, []).append(address)
            else:
                self.workers[address] = worker.threads
        for reason, addresses in unfit.items():
            shown = ', '.join(addresses[:_SHOWN])
            more = f' and {len(addresses) - _SHOWN} others' if len(addresses) > _SHOWN else ''
            self._reason = f'{shown}{more}: {reason}'
            self._tell(f'{self._reason}; gets no runs')

    @staticmethod
    def _unfit(checked: Future[str]) -> str:
        try:
            return str(json.loads(checked.result(timeout=_ANSWER_S))['unfit'])
        except Exception as error:  # whatever a worker of another version raises
            return f'cannot be checked: {_one_line(error)}'

    def _job_text(self) -> str:
        return json.dumps(dataclasses.asdict(self.job))

    def _gone(self, what: str) -> InfraError:
        return InfraError(
            InfraKind.DIED, f'cluster {self._where}', -1,
            f'{what}; all finished runs are recorded, continue with --resume',
        )

    # Ending ------------------------------------------------------------------------------------

    def _close(self) -> None:
        self._tell_workers(end_children)
        self._drop_client()
        if self._local is not None:
            _briefly(self._local.close)
            self._local = None

    def _tell_workers(self, function: Callable[[str], Any]) -> None:
        """Call a function with the campaign's name on all fit workers; some may not answer."""
        client, workers = self._client, list(self.workers)
        if client is not None and client.status == 'running' and workers:
            _briefly(lambda: client.run(
                function, self.name, workers=workers, on_error='ignore'
            ))

    def _drop_client(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            _briefly(lambda: client.close(timeout=_ANSWER_S))


class _NotConnectedError(Exception):
    """There is no scheduler."""


def _briefly(function: Callable[[], Any]) -> None:
    """Call what may fail, or never return."""
    def call() -> None:
        with contextlib.suppress(Exception):
            function()

    thread = threading.Thread(target=call, name='cluster', daemon=True)
    thread.start()
    thread.join(_ANSWER_S)


@contextlib.contextmanager
def _scratch() -> Iterator[None]:
    """A folder for what Dask's local servers write, which is removed after them."""
    with tempfile.TemporaryDirectory(prefix='taxinet-dask-', ignore_cleanup_errors=True) as folder:
        try:
            import dask
        except ImportError:  # told when Dask is needed
            yield
            return
        with dask.config.set({'temporary-directory': folder}):
            yield


def _versions() -> dict[str, str]:
    return {'python': platform.python_version(), 'distributed': metadata.version('distributed')}


def _loopback(address: str) -> bool:
    host = urlsplit(address).hostname or ''
    return host in ('localhost', '::1') or host.startswith('127.')


def _one_line(error: BaseException) -> str:
    cause = error
    while cause.__cause__ is not None:  # the first reason says most
        cause = cause.__cause__
    text = ' '.join(str(cause).split())
    return f'{type(cause).__name__}: {text:.300}' if text else type(cause).__name__
