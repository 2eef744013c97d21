"""The Scenic server of this process, from which the child of every program is forked.

Importing Scenic takes a second, forking a process that has imported it a hundredth. Little is
imported here, so that a command can start the server before anything else.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import signal
import socket
import threading
import time
from typing import Any

from taxinet_ros.processes.child import ChildProcess, module_command, open_pipe
from taxinet_ros.processes.streams import fill_standard_descriptors

_LOOK_S = 0.01
_MOST_BYTES = 65536
_lock = threading.Lock()


def start_early() -> None:
    """Start the server now, so that Scenic is imported while this process goes on."""
    _server()


class ScenicChild:
    """A child forked for one program.

    Attributes:
        pid: its process id, which its first answer gives; None until then.
    """

    def __init__(self, server: _Server) -> None:
        """Use :func:`fork_child`."""
        self.pid: int | None = None
        self._server = server
        self._status: int | None = None

    def kill(self) -> None:
        """Kill it with its descendants. Without a pid it ends when its pipe is closed."""
        if self.pid is not None and self._status is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)

    def wait(self, timeout_s: float = 60.0) -> int | None:
        """Wait for its end; the exit code, negative for a signal, or None on timeout.

        If the server has died, the exit code is that of the server.
        """
        deadline = time.monotonic() + timeout_s
        while self._status is None:
            try:
                answer = None if self.pid is None else self._server.ask({'wait': self.pid})
                self._status = answer['status'] if answer else self._server.process.code
            except OSError:
                self._status = self._server.process.wait(timeout_s)
            if time.monotonic() > deadline or self.pid is None:
                break
            time.sleep(_LOOK_S)
        return self._status


def fork_child(*, seed: int, memory_bytes: int, timeout_s: float) -> tuple[ScenicChild, int, int]:
    """Fork a child for a program.

    Args:
        seed: seed of the scenes.
        memory_bytes: limit of its address space.
        timeout_s: wall-clock limit of each request [s].

    Returns:
        The child, a descriptor to read its answers from, and one to write requests to.
    """
    folder = ''
    with contextlib.suppress(OSError):  # few programs need the working directory to exist
        folder = os.getcwd()
    message = {'seed': seed, 'memory_bytes': memory_bytes, 'timeout_s': timeout_s, 'folder': folder}
    request_read, request_write = open_pipe()
    response_read, response_write = open_pipe()
    try:
        try:
            server = _server()
            server.send(message, request_read, response_write, 2)
        except OSError:  # it has died meanwhile
            server = _server()
            server.send(message, request_read, response_write, 2)
    finally:
        os.close(request_read)
        os.close(response_write)
    return ScenicChild(server), response_read, request_write


class _Server:
    """The server's process, and the socket on which it is asked; at its end the server ends."""

    def __init__(self) -> None:
        fill_standard_descriptors()
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self.process = ChildProcess(
                'Scenic', module_command(
                    'taxinet_ros.scenes.scenic_child', f'--control-fd={theirs.fileno()}'
                ), stdout=2, descriptors=(theirs.fileno(),),
                # Linux takes the end of the thread for that of the parent.
                killed_with_parent=threading.current_thread() is threading.main_thread(),
            )
        self.owner = os.getpid()

    def close(self) -> None:
        """Close this process's end of the socket."""
        self._control.close()

    def send(self, message: dict[str, Any], *descriptors: int) -> None:
        socket.send_fds(self._control, [json.dumps(message).encode()], descriptors)

    def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        with _lock:
            self.send(message)
            answer = self._control.recv(_MOST_BYTES)
        if not answer:
            raise ConnectionResetError
        return dict(json.loads(answer))


_servers: list[_Server] = []


@atexit.register
def _end_server() -> None:
    if _servers and _servers[0].owner == os.getpid():
        server = _servers.pop()
        server.close()
        server.process.end(())


def _server() -> _Server:
    """The server of this process, started if there is none."""
    with _lock:
        if _servers and (_servers[0].owner != os.getpid() or _servers[0].process.dead):
            _servers.pop().close()
        if not _servers:
            _servers.append(_Server())
        return _servers[0]
