"""The graph as separate processes: spawned, watched and ended by the campaign's process."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import rclpy
import yaml
from rclpy.clock import Clock, ClockType
from rclpy.context import Context

from taxinet_ros.core.errors import UsageError
from taxinet_ros.nodes.graph import Graph, GraphOptions, SampledGraph, own_domain
from taxinet_ros.nodes.scenario_sampler import ScenarioSampler

_POLL_S = 0.1
_GRACE_S = 5.0
_PR_SET_PDEATHSIG = 1


@contextlib.contextmanager
def process_graph(options: GraphOptions, logs: Path) -> Iterator[Graph]:
    """Every node but the sampler as a process of its own; ``logs`` takes what they print."""
    logs.mkdir(parents=True, exist_ok=True)
    with own_domain() as domain, tempfile.TemporaryDirectory(prefix='taxinet-') as scratch:
        children = [
            _Child(name, kind, parameters, domain, logs, Path(scratch))
            for name, (kind, parameters) in options.nodes().items()
        ]
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        graph = _Processes(context, children)
        try:
            yield graph
        finally:
            graph.close()
            rclpy.try_shutdown(context=context)
            _end(children)


class _Child:
    """One node's process."""

    def __init__(
        self, name: str, kind: type[Any], parameters: dict[str, Any], domain: int, logs: Path,
        scratch: Path,
    ) -> None:
        self.name = name
        self._log = logs / f'{name}.log'
        file = scratch / f'{name}.yaml'
        file.write_text(yaml.safe_dump({'/**': {'ros__parameters': parameters}}))
        environment = {
            **os.environ,
            'ROS_DOMAIN_ID': str(domain),
            'PYTHONUNBUFFERED': '1',
        }
        arguments = ['--ros-args', '--params-file', str(file)] if parameters else []
        with self._log.open('ab') as log:
            self.process = self._spawn([kind.__module__, *arguments], environment, log)

    @staticmethod
    def _spawn(
        module: list[str], environment: dict[str, str], log: IO[bytes]
    ) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, '-m', *module],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            # Ctrl-C in the terminal is for the campaign, which then ends its nodes in order.
            start_new_session=True,
            preexec_fn=die_with_parent,
        )

    def obituary(self) -> str:
        """How it died, in one line."""
        code = self.process.returncode
        how = f'killed by {signal.Signals(-code).name}' if code < 0 else f'exit code {code}'
        lines = self._log.read_text(errors='replace').strip().splitlines()
        return f'{how}: {lines[-1]}' if lines and code > 0 else how


def die_with_parent() -> None:
    """For a child that is being started: Linux ends it when its parent goes, however it goes."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class _Processes(SampledGraph):
    def __init__(self, context: Context, children: list[_Child]) -> None:
        super().__init__(context)
        self.children = children

    def prepare(self, sampler: ScenarioSampler) -> None:
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        sampler.create_timer(_POLL_S, functools.partial(self._watch, sampler), clock=steady)

    def _watch(self, sampler: ScenarioSampler) -> None:
        for child in self.children:
            if child.process.poll() is None:
                continue
            if child.process.returncode == 2:
                raise UsageError(child.obituary().split('error: ', 1)[-1])
            sampler.mourn(child.name, child.obituary())


def _end(children: list[_Child]) -> None:
    """SIGTERM to those still there, a grace period, then SIGKILL: no orphans."""
    for child in children:
        if child.process.poll() is None:
            child.process.terminate()
    deadline = time.monotonic() + _GRACE_S
    for child in children:
        try:
            child.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            child.process.kill()
            child.process.wait()
