"""Run one node of a graph in its own process: a node of this package or a user's command."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Sequence
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
from taxinet_ros.nodes.running.domain import require_discovery
from taxinet_ros.processes.child import ChildProcess, child_environment, module_command


class NodeProcess(ChildProcess):
    """A node's process.

    Attributes:
        log: file for its output, one start after the other.
    """

    log: Path

    def __init__(
        self, name: str, command: Sequence[str], *, domain: int, log: Path, ours: bool = False
    ) -> None:
        """Start it.

        Args:
            name: name of the node.
            command: program and arguments.
            domain: ROS domain to join.
            log: file for its output.
            ours: whether it is a node of this package.
        """
        require_discovery()
        self._ours = ours
        super().__init__(
            name, command, log=log, killed_with_parent=ours,
            environment={
                **child_environment(), 'ROS_DOMAIN_ID': str(domain), 'PYTHONUNBUFFERED': '1',
                # Else rclpy sends an int in a float field as another number (own_nodes.md).
                **({} if ours else {'ROS_PYTHON_CHECK_FIELDS': '1'}),
            },
        )

    @classmethod
    def of_command(
        cls, name: str, command: list[str], *, domain: int, log: Path,
        graces_s: tuple[float, float] = (SIGINT_GRACE_S, SIGTERM_GRACE_S),
    ) -> Self:
        """Start a user's command as a node, including its child processes.

        Raises:
            UsageError: the program does not exist.
        """
        if shutil.which(command[0]) is None:
            raise UsageError(f'{name}: {command[0]}: no such program')
        words = wrapped_command(command, os.getpid(), *graces_s)
        return cls(name, words, domain=domain, log=log)  # the wrapper watches for its parent's
        # death

    @classmethod
    def of_ours(
        cls, name: str, kind: type[Any], parameters: dict[str, Any], *, domain: int, log: Path,
        scratch: Path, remaps: Sequence[str] = (),
    ) -> Self:
        """Start a node of this package; Linux kills it when its parent dies.

        Args:
            name: name of the node.
            kind: node class whose module is the program.
            parameters: the node's ROS parameters.
            domain: ROS domain to join.
            log: file for its output.
            scratch: folder for its parameter file; must outlive the process.
            remaps: remap rules, ``FROM:=TO``.
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
        """Kill the process and its descendants in any session."""
        with contextlib.suppress(psutil.NoSuchProcess):
            # Only the wrapper knows the processes it adopted, so it is killed last.
            for process in psutil.Process(self.process.pid).children(recursive=True):
                with contextlib.suppress(psutil.NoSuchProcess):
                    process.kill()
        super().kill()

    def last_line(self, but: str | None = CHILDREN_LEFT) -> str:
        """The last line printed by the process itself, or ''."""
        return super().last_line(but)

    @property
    def refused(self) -> str:
        """Usage error printed by a node of this package before it exited, or ''."""
        if not self._ours or self.code != ExitCode.USAGE:
            return ''
        return self.how_it_ended().split('error: ', 1)[-1]


def node_command(module: str) -> list[str]:
    """Command line of a node of this package; it blocks signals until it can handle them."""
    return module_command('taxinet_ros.cli.start', module)
