"""Run the Foxglove server in its own process for the lifetime of a graph.

It is a separate process so that viewers take no CPU time from the run.
"""

from __future__ import annotations

import contextlib
import importlib.util
import socket
import subprocess
import tempfile
from collections.abc import Iterator

from taxinet_ros.errors import UsageError
from taxinet_ros.nodes.foxglove_server import HOST, LOOKING_ON, NOT_INSTALLED
from taxinet_ros.nodes.graph.node_process import node_command
from taxinet_ros.processes.child import ChildProcess, package_environment


def check_port(port: int) -> None:
    """Refuse a port that cannot be opened, before anything is started.

    Raises:
        UsageError: it is in use or out of range, or foxglove-sdk is not installed.
    """
    if importlib.util.find_spec('foxglove') is None:
        raise UsageError(f'foxglove: {NOT_INSTALLED}')
    try:
        with socket.socket() as probe:
            # As in the server: a recently closed port counts as free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((HOST, port))
    except (OSError, OverflowError) as error:
        reason = getattr(error, 'strerror', None) or 'ports range from 1 to 65535'
        raise UsageError(f'foxglove {port}: {reason}; choose another port') from error


@contextlib.contextmanager
def foxglove_view(port: int, domain: int) -> Iterator[None]:
    """Context in which a ROS domain is streamed to ``ws://127.0.0.1:<port>``.

    Entered when the server has found the graph, so that no run is missed.

    Raises:
        UsageError: the server cannot be started.
    """
    command = node_command('taxinet_ros.nodes.foxglove_server')
    command += ['--ros-args', '-p', f'port:={port}']
    with tempfile.TemporaryFile() as errors:
        server = ChildProcess(
            'foxglove', command, stdout=subprocess.PIPE, stderr=errors,
            environment={**package_environment(), 'ROS_DOMAIN_ID': str(domain)},
            killed_with_parent=True,
        )
        try:
            assert server.process.stdout is not None
            if not any(line.startswith(LOOKING_ON.encode()) for line in server.process.stdout):
                errors.seek(0)
                said = errors.read().decode(errors='replace').strip().splitlines()
                last = said[-1] if said else 'it exited without a message'
                raise UsageError(f'foxglove: {last.removeprefix("error: ")}')
            yield
        finally:
            server.end()
