"""Start-up times: ``taxinet run`` to the first step on disk, a node to its discovery.

Processes are polled from outside every few milliseconds; Python files and libraries are in the
system's cache after the first start.
"""

from __future__ import annotations

import struct
import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import rclpy
from processes import LIMIT_S, POLL_S, TAXINET, VERDICTS, Amounts, peak_memory, wait_for
from rclpy.context import Context
from rclpy.node import Node

from taxinet_ros.bench.measure import Subject
from taxinet_ros.errors import InfraError, InfraKind
from taxinet_ros.nodes import interface, steering_controller
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.leave import leave_graph
from taxinet_ros.processes.child import ChildProcess, module_command, package_environment

_NAME = 'start-up'
_RUN = (
    'run', 's_falsif', '--perception', 'taxinet', '--images', 'none', '--set', 'duration_s=1',
)
_MAGIC_BYTES, _CHUNK = 8, 6
_HEAD = struct.Struct('<BQ')


def subjects(stack: ExitStack, amounts: Amounts) -> list[Subject]:
    """A run of one simulated second from the command line, and a single node.

    Args:
        stack: removes their files.
        amounts: receives the peak memory of ``taxinet run``.
    """
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='taxinet-start-')))
    peaks = [0]
    amounts['memory: taxinet run'] = lambda: max(peaks)
    domain = stack.enter_context(own_domain())
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    stack.callback(rclpy.try_shutdown, context=context)
    onlooker = Node('bench_onlooker', context=context)
    stack.callback(leave_graph, onlooker)
    return [
        Subject(
            name=_NAME, run=partial(_start_run, folder, peaks), warm_ups=0, most=3
        ),
        Subject(name=_NAME, run=partial(_start_node, onlooker), warm_ups=0, most=3),
    ]


def holds_step(mcap: Path) -> bool:
    """Whether a bag's file holds a whole chunk; the recorder's first chunk is the first step."""
    try:
        data = mcap.read_bytes()
    except FileNotFoundError:
        return False
    at = _MAGIC_BYTES
    while at + _HEAD.size <= len(data):
        kind, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size + length
        if kind == _CHUNK:
            return at <= len(data)
    return False


def _start_run(folder: Path, peaks: list[int]) -> Mapping[str, int]:
    out = folder / f'run-{len(peaks)}'
    peaks.append(0)

    def on_disk() -> bool:
        peaks[-1] = max(peaks[-1], peak_memory([process.pid]))
        return any(holds_step(mcap) for mcap in out.glob('*/*.mcap'))

    start = time.perf_counter_ns()
    with ChildProcess(
        'taxinet run', [*TAXINET, *_RUN, '--out', str(out)], log=folder / f'{out.name}.txt',
        environment=package_environment(),
    ) as process:
        first = wait_for(process, on_disk) - start
        while not process.dead:
            on_disk()
            time.sleep(POLL_S)
        whole = time.perf_counter_ns() - start
        if process.code not in VERDICTS:
            raise InfraError(InfraKind.DIED, process.name, -1, process.how_it_ended())
    return {'taxinet run, first step': first, 'taxinet run of 1 s': whole}


def _start_node(onlooker: Node) -> Mapping[str, int]:
    domain = str(onlooker.context.get_domain_id())
    deadline = time.monotonic() + LIMIT_S
    while _seen(onlooker) and time.monotonic() < deadline:
        time.sleep(POLL_S)  # the previous node is still known
    start = time.perf_counter_ns()
    with tempfile.TemporaryDirectory() as folder, ChildProcess(
        'node', module_command(steering_controller.__name__), log=Path(folder) / 'printed.txt',
        environment={**package_environment(), 'ROS_DOMAIN_ID': domain},
    ) as process:
        seen = wait_for(process, partial(_seen, onlooker)) - start
        process.end()
    return {'node, seen': seen}


def _seen(onlooker: Node) -> bool:
    return interface.STEERING_CONTROLLER in onlooker.get_node_names()
