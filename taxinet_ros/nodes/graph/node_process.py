"""One node as a process of its own: how it is started, how it died, how several are ended."""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import psutil
import yaml

from taxinet_ros.errors import UsageError
from taxinet_ros.nodes.graph.command_wrapper import (
    CHILDREN_LEFT,
    SIGINT_GRACE_S,
    SIGTERM_GRACE_S,
    wrapped_command,
)
from taxinet_ros.processes.child import child_environment, die_with_parent

_LAST_GRACE_S = 10.0
_LAST_BYTES = 4096

SOFT = ((signal.SIGTERM, 5.0),)
"""Ends nodes that have nothing to lose: signal, and grace [s] before the next step."""

IN_ORDER = ((signal.SIGINT, 5.0), (signal.SIGTERM, 2.0))
"""Ends nodes as a person would."""


class NodeProcess:
    """A node's process.

    Attributes:
        name: of the node.
        ours: whether it is a node of this package, whose exit code 2 is a mistake of the user's.
        process: the one that runs now, or ran last.
        log: file that takes what it prints, one start after the other.
    """

    def __init__(
        self, name: str, command: Sequence[str], *, domain: int, log: Path,
        before: Callable[[], None] | None = None,
    ) -> None:
        """Start it.

        Args:
            name: of the node.
            command: program and arguments.
            domain: ROS domain that it joins.
            log: file that takes what it prints.
            before: called in the new process before the program.
        """
        self.name = name
        self.log = log
        self._command = list(command)
        self._environment = {
            **child_environment(), 'ROS_DOMAIN_ID': str(domain), 'PYTHONUNBUFFERED': '1',
        }
        self._before = before
        self.ours = before is not None
        self.start()

    @classmethod
    def of_command(
        cls, name: str, command: list[str], *, domain: int, log: Path,
        graces_s: tuple[float, float] = (SIGINT_GRACE_S, SIGTERM_GRACE_S),
    ) -> Self:
        """Start somebody's command, which is to be a node, whatever it starts in turn.

        Args:
            name: of the node.
            command: program and arguments.
            domain: ROS domain that it joins.
            log: file that takes what it prints.
            graces_s: what is left to it after SIGINT, and after SIGTERM [s].

        Raises:
            UsageError: there is no such program.
        """
        if shutil.which(command[0]) is None:
            raise UsageError(f'{name}: {command[0]}: no such program')
        words = wrapped_command(command, os.getpid(), *graces_s)
        return cls(name, words, domain=domain, log=log)  # the keeper looks after its parent's death

    @classmethod
    def of_ours(
        cls, name: str, kind: type[Any], parameters: dict[str, Any], *, domain: int, log: Path,
        scratch: Path,
    ) -> Self:
        """Start a node of this package.

        Args:
            name: of the node.
            kind: node class whose module is the program.
            parameters: the node's ROS parameters.
            domain: ROS domain that it joins.
            log: file that takes what it prints.
            scratch: folder of its parameter file, which must last as long as the process.
        """
        words = node_command(kind.__module__)
        if parameters:
            file = scratch / f'{name}.yaml'
            file.write_text(yaml.safe_dump({'/**': {'ros__parameters': parameters}}))
            words += ['--ros-args', '--params-file', str(file)]
        return cls(
            name, words, domain=domain, log=log, before=dying_with_parent()
        )

    def start(self) -> None:
        """Start it, or start it again."""
        with self.log.open('ab') as log:
            self.process = subprocess.Popen(
                self._command, env=self._environment, stdin=subprocess.DEVNULL, stdout=log,
                stderr=subprocess.STDOUT,
                # Ctrl-C in the terminal is for the parent, which then ends its nodes in order.
                start_new_session=True, preexec_fn=self._before,
            )

    def send(self, number: signal.Signals) -> None:
        """Send a signal to it and to all of its group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    def kill(self) -> None:
        """Kill it and all that it has started, in whatever session that is."""
        with contextlib.suppress(psutil.NoSuchProcess):
            # Nobody else would know of what a keeper has adopted, so it is the last to go.
            for process in psutil.Process(self.process.pid).children(recursive=True):
                with contextlib.suppress(psutil.NoSuchProcess):
                    process.kill()
        self.send(signal.SIGKILL)

    @property
    def dead(self) -> bool:
        """Whether it has ended, by whatever."""
        return self.process.poll() is not None

    def obituary(self) -> str:
        """How it died, in one line."""
        code = self.process.returncode
        how = f'killed by {_signal_name(-code)}' if code < 0 else f'exit code {code}'
        said = self.last_words()
        return f'{how}: {said}' if said and code > 0 else how

    def last_words(self) -> str:
        """The last line that it printed, or ''."""
        with self.log.open('rb') as log:
            log.seek(max(0, self.log.stat().st_size - _LAST_BYTES))
            lines = log.read().decode(errors='replace').strip().splitlines()
        own = [line for line in lines if not line.startswith(CHILDREN_LEFT)]
        return own[-1] if own else ''

    def complaint(self) -> str:
        """What it said before it left for a mistake of the user's, exit code 2."""
        return self.obituary().split('error: ', 1)[-1]


@contextlib.contextmanager
def command_processes(
    commands: Mapping[str, list[str]], domain: int, logs: Path
) -> Iterator[list[NodeProcess]]:
    """Start somebody's commands as nodes of a graph; none of them outlasts the ``with``.

    Args:
        commands: program and arguments by the node's name.
        domain: ROS domain that the nodes join.
        logs: folder that takes what each of them prints.

    Raises:
        UsageError: there is no such program.
    """
    children: list[NodeProcess] = []
    try:
        for name, command in commands.items():
            logs.mkdir(exist_ok=True)
            log = logs / f'{name}-{domain}.log'
            children.append(NodeProcess.of_command(name, command, domain=domain, log=log))
        yield children
    finally:
        end_all(children)


def node_command(module: str) -> list[str]:
    """What starts a node of ours: it hears signals from its first line on, and leaves at once."""
    # -P: a module in the user's folder must not stand in for one of ours.
    return [sys.executable, '-P', '-m', 'taxinet_ros.cli.start', module]


def dying_with_parent() -> functools.partial[None]:
    """For a :func:`node_command` to be started now: Linux kills it when its parent goes.

    It is killed and not asked, for one that hangs or is stopped would not hear; a bag is on disk
    after each step.
    """
    return functools.partial(_die_with, os.getpid())


def _die_with(parent: int) -> None:
    # Python has no better answer than a traceback to what comes while it starts.
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
    die_with_parent(signal.SIGKILL)
    if os.getppid() != parent:  # It went before we asked.
        os.kill(os.getpid(), signal.SIGKILL)


def end_all(
    nodes: Iterable[NodeProcess], ladder: Sequence[tuple[signal.Signals, float]] = SOFT
) -> list[str]:
    """Have nodes end, with signal after signal, and SIGKILL in the end: no orphans.

    Args:
        nodes: all that are to end.
        ladder: signals, each with the grace that follows it [s].

    Returns:
        Names of those that had to be killed.
    """
    left = [node for node in nodes if not node.dead]
    for number, grace_s in ladder:
        for node in left:
            node.send(number)
            node.send(signal.SIGCONT)  # One that is stopped hears nothing else.
        left = _outlasting(left, grace_s)
    for node in left:
        node.kill()
    _outlasting(left, _LAST_GRACE_S)
    return [node.name for node in left]


def _outlasting(nodes: list[NodeProcess], grace_s: float) -> list[NodeProcess]:
    """Those that are still there after a time."""
    deadline = time.monotonic() + grace_s
    left = []
    for node in nodes:
        try:
            node.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            left.append(node)
    return left


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f'signal {number}'  # Real-time signals have no names of their own.
