"""The address of a Dask cluster, and the connection to it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import re
import tempfile
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.errors import UsageError
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_file

if TYPE_CHECKING:
    from distributed import Client

LOCAL = 'local:'
MOST_LOCAL = 256
_FORMS = 'tcp://HOST:PORT, tls://HOST:PORT or local:N'
_ADDRESS = re.compile(r'(tcp|tls)://(\[[0-9a-fA-F:.%]+\]|[A-Za-z0-9._-]+):(\d{1,5})')
_ENCRYPTED_OR_HERE = re.compile(r'tls:|tcp://(127\.|localhost:|\[::1\])')
_CONNECT_S = 10.0

Tell = Callable[[str], None]


def check_cluster(where: str) -> str:
    """Check the form of an address: ``local:N``, ``tcp://…``, ``tls://…``, or a scheduler file.

    Returns:
        The address, or ``local:N``.

    Raises:
        UsageError: it is none, or the file is no scheduler file.
    """
    named, address = f'--cluster {where}', where
    if where.startswith(LOCAL):
        count = where.removeprefix(LOCAL)
        if not (count.isascii() and count.isdigit() and 1 <= int(count) <= MOST_LOCAL):
            raise UsageError(f'{named}: expected local:N with N within 1..{MOST_LOCAL}')
        return where
    if '://' not in where:
        try:
            address = str(json.loads(read_file(Path(where), MAX_TEXT_BYTES))['address'])
        except OSError as error:
            raise UsageError(
                f'{named}: {error.strerror}; expected {_FORMS}, or the file of dask scheduler '
                '--scheduler-file'
            ) from error
        except (ValueError, LookupError, TypeError, RecursionError) as error:
            raise UsageError(
                f'{named}: no scheduler file, as dask scheduler --scheduler-file writes'
            ) from error
        named += f': its address {address:.80}'
    match = _ADDRESS.fullmatch(address)
    if not match or not 0 < int(match[3]) < 65536:
        raise UsageError(f'{named}: expected {_FORMS}')
    return address


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
            f"--cluster {where}: needs a package; pip install 'taxinet_ros[cluster]' ({error})"
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
            f'--cluster {where}: no Dask scheduler answers there, or it has other TLS settings '
            f'({one_line(error)})'
        ) from error
    here = get_versions()['packages']
    for name in ('python', 'distributed'):
        if there[name] != here[name]:
            raise UsageError(
                f'--cluster {where}: the scheduler has {name} {there[name]}, here it is '
                f'{here[name]}; start it in the same environment as here'
            )


def one_line(error: BaseException | None) -> str:
    """The first cause of an error, on one line."""
    while error is not None and error.__cause__ is not None:
        error = error.__cause__
    text = ' '.join(str(error).split())
    return f'{type(error).__name__}: {text:.300}' if text else type(error).__name__
