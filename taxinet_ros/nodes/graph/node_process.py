"""One node of a graph as a process of its own: one of this package, or somebody's command."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import psutil
import yaml

from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.nodes.graph.command_wrapper import (
    CHILDREN_LEFT,
    SIGINT_GRACE_S,
    SIGTERM_GRACE_S,
    wrapped_command,
)
from taxinet_ros.processes.child import ChildProcess, child_environment, end_all, module_command


class NodeProcess(ChildProcess):
    """A node's process.

    Attributes:
        log: file that takes what it prints, one start after the other.
    """

    log: Path

    def __init__(
        self, name: str, command: Sequence[str], *, domain: int, log: Path, ours: bool = False
    ) -> None:
        """Start it.

        Args:
            name: of the node.
            command: program and arguments.
            domain: ROS domain that it joins.
            log: file that takes what it prints.
            ours: whether it is a node of this package.
        """
        self._ours = ours
        super().__init__(
            name, command, log=log, killed_with_parent=ours, signals_held=ours,
            environment={
                **child_environment(), 'ROS_DOMAIN_ID': str(domain), 'PYTHONUNBUFFERED': '1',
            },
        )

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
        scratch: Path, remaps: Sequence[str] = (),
    ) -> Self:
        """Start a node of this package; Linux kills it when its parent goes.

        Args:
            name: of the node.
            kind: node class whose module is the program.
            parameters: the node's ROS parameters.
            domain: ROS domain that it joins.
            log: file that takes what it prints.
            scratch: folder of its parameter file, which must last as long as the process.
            remaps: rules, ``FROM:=TO``.
        """
        words = node_command(kind.__module__)
        options = [part for rule in remaps for part in ('-r', rule)]
        if parameters:
            file = scratch / f'{name}.yaml'
            file.write_text(yaml.safe_dump({'/**': {'ros__parameters': parameters}}))
            options += ['--params-file', str(file)]
        if options:
            words += ['--ros-args', *options]
        return cls(name, words, domain=domain, log=log, ours=True)

    def kill(self) -> None:
        """Kill it and all that it has started, in whatever session that is."""
        with contextlib.suppress(psutil.NoSuchProcess):
            # Nobody else would know of what a keeper has adopted, so it is the last to go.
            for process in psutil.Process(self.process.pid).children(recursive=True):
                with contextlib.suppress(psutil.NoSuchProcess):
                    process.kill()
        super().kill()

    def last_line(self, but: str | None = CHILDREN_LEFT) -> str:
        """The last line that it printed itself, or ''."""
        return super().last_line(but)

    @property
    def refused(self) -> str:
        """What a node of ours said before it left for a mistake of the user's, or ''."""
        if not self._ours or self.code != ExitCode.USAGE:
            return ''
        return self.how_it_ended().split('error: ', 1)[-1]


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
    """What runs a node of this package, which holds signals back until it can answer them."""
    return module_command('taxinet_ros.cli.start', module)
