"""A standing graph of node processes that waits for an external sampler."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.launch_plan import namespace_remaps
from taxinet_ros.nodes.graph.node_process import NodeProcess
from taxinet_ros.nodes.graph.runner import GraphOptions, node_processes
from taxinet_ros.nodes.graph.supervisor import Restart, Supervisor
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.executor import NodeExecutor
from taxinet_ros.nodes.running.node_main import spin_until
from taxinet_ros.processes.child import IN_ORDER, end_all


@dataclass(frozen=True, kw_only=True)
class UpOptions:
    """Options of a standing graph.

    Attributes:
        graph: graph options; ``out`` also holds the logs.
        record: whether there is a recorder.
        domain: ROS domain; None for a free one.
        namespace: absolute namespace of every name in the graph, including its clock; graphs with
            different namespaces may share a domain set by the user.
        restart: what to do when a node dies.
        silent_s: silence after which a node is reported [s], see :class:`.Supervisor`.
    """

    graph: GraphOptions
    record: bool = True
    domain: int | None = None
    namespace: str = '/'
    restart: Restart = Restart.ON_FAILURE
    silent_s: float = 10.0

    @property
    def logs(self) -> Path:
        """Folder of the nodes' logs."""
        return self.graph.out / 'logs'

    @property
    def remaps(self) -> tuple[str, ...]:
        """Remaps that move each node into the namespace."""
        return namespace_remaps(self.namespace) if self.namespace != '/' else ()

    @property
    def ros_arguments(self) -> list[str]:
        """The remaps as command-line arguments."""
        options = [part for rule in self.remaps for part in ('-r', rule)]
        return ['--ros-args', *options] if options else []

    @property
    def participants(self) -> tuple[str, ...]:
        """Nodes that take part in the lockstep, without the simulator."""
        return tuple(
            name for name in interface.PARTICIPANTS if self.record or name != interface.RECORDER
        )


def run_standing_graph(
    options: UpOptions, say: Callable[[str], None],
    watching: Callable[[Supervisor, int], contextlib.AbstractContextManager[None]],
) -> None:
    """Start a graph and supervise it until stopped.

    A ``KeyboardInterrupt`` at any time kills every node; otherwise they end in order. ``say`` is
    called with a line per event; ``watching``, with the supervisor, which can stop the graph, and
    the domain, is entered while the graph stands.

    Raises:
        UsageError: bad input, or the domain belongs to another graph.
        GraphLostError: the graph could not be kept up.
    """
    without = () if options.record else (interface.RECORDER,)
    with (
        own_domain(options.domain, options.namespace) as domain,
        node_processes(
            options.graph, domain, options.logs, without=without, remaps=options.remaps,
        ) as processes,
        NodeExecutor(domain) as spinning,
        _in_order(processes),
    ):
        supervisor = Supervisor(
            processes, say, restart=options.restart, silent_s=options.silent_s,
            context=spinning.context, cli_args=options.ros_arguments,
        )
        spinning.add(supervisor)
        with watching(supervisor, domain):
            spin_until(spinning.executor, supervisor.ended)


@contextlib.contextmanager
def _in_order(processes: list[NodeProcess]) -> Iterator[None]:
    try:
        yield
        end_all(processes, IN_ORDER)
    except KeyboardInterrupt:
        end_all(processes, ())
        raise
