"""A Dask cluster of processes on loopback."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from waiting import wait_for


def free_port() -> int:
    with socket.create_server(('127.0.0.1', 0)) as server:
        return int(server.getsockname()[1])


def reachable(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(('127.0.0.1', port)):
        return True
    return False


class DaskProcesses:
    """A scheduler and workers of one thread each; a context manager that leaves none behind."""

    def __init__(self, folder: Path, protocol: str = 'tcp', **environment: str) -> None:
        self.folder, self.port, self.protocol = folder, free_port(), protocol
        self._environment = environment
        self._all: list[subprocess.Popen[bytes]] = []
        self._logs: dict[int, Path] = {}

    def __enter__(self) -> DaskProcesses:
        self.start_scheduler()
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._all:
            kill(process)

    @property
    def address(self) -> str:
        return f'{self.protocol}://127.0.0.1:{self.port}'

    def start_scheduler(self, *words: str) -> None:
        self.scheduler = self._start(
            'scheduler', '--host', '127.0.0.1', '--port', str(self.port),
            '--protocol', self.protocol, *words,
        )
        wait_for(lambda: reachable(self.port))

    def add_worker(
        self, address: str = '', words: Sequence[str] = (), **environment: str
    ) -> subprocess.Popen[bytes]:
        worker = self._start(
            'worker', address or self.address, '--host', '127.0.0.1', '--nthreads', '1',
            '--no-nanny', '--memory-limit', '0', '--local-directory', str(self.folder), *words,
            **environment,
        )
        log = self._logs[worker.pid]
        wait_for(lambda: b'Registered to' in log.read_bytes(), log.read_text)
        return worker

    def _start(self, *words: str, **environment: str) -> subprocess.Popen[bytes]:
        file = self.folder / f'{words[0]}-{len(self._all)}.log'
        with file.open('wb') as log:
            process = subprocess.Popen(
                [str(Path(sys.executable).with_name('dask')), *words, '--no-dashboard'],
                stdout=log, stderr=subprocess.STDOUT, cwd=self.folder, start_new_session=True,
                env={**os.environ, **self._environment, **environment},
            )
        self._all.append(process)
        self._logs[process.pid] = file
        return process


def kill(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()
