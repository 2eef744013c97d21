"""A Dask cluster of processes on loopback, and a wire that can be cut between two of them."""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import socket
import subprocess
import sys
import threading
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


class Wire:
    """Forwards connections to a port; once cut, nothing passes and nobody is told."""

    def __init__(self, port: int) -> None:
        self._target, self._cut = port, threading.Event()
        self._server = socket.create_server(('127.0.0.1', 0))
        self.port = int(self._server.getsockname()[1])
        self._sockets: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        self._cut.set()

    def close(self) -> None:
        self._cut.set()
        for one in (self._server, *self._sockets):
            one.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._server.accept()
                far = socket.create_connection(('127.0.0.1', self._target))
                self._sockets += [near, far]
                threading.Thread(target=self._forward, args=(near, far), daemon=True).start()

    def _forward(self, near: socket.socket, far: socket.socket) -> None:
        with contextlib.suppress(OSError, ValueError), selectors.DefaultSelector() as selector:
            selector.register(near, selectors.EVENT_READ, far)
            selector.register(far, selectors.EVENT_READ, near)
            while True:
                for key, _ in selector.select():
                    if self._cut.is_set():
                        return
                    part = key.fileobj.recv(65536)  # type: ignore[union-attr]
                    if not part:
                        near.close()
                        far.close()
                        return
                    key.data.sendall(part)
