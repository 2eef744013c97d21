"""A standing graph, each node a process, that waits for a sampler from elsewhere."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.launch_plan import namespace_remaps
from taxinet_ros.nodes.graph.node_process import NodeProcess
from taxinet_ros.nodes.graph.runner import GraphOptions, node_processes
from taxinet_ros.nodes.graph.supervisor import SupervisionOptions, Supervisor
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.executor import NodeExecutor
from taxinet_ros.nodes.running.node_main import spin_until
from taxinet_ros.processes.child import IN_ORDER, end_all


@dataclass(frozen=True, kw_only=True)
class UpOptions:
    """A standing graph.

    Attributes:
        graph: what it is made of; its ``out`` takes the logs too.
        record: whether there is a recorder.
        domain: ROS domain; None for one of its own.
        namespace: absolute, of every name of the graph, its clock included; graphs with namespaces
            of their own may share a domain that is set.
        care: how it is looked after.
    """

    graph: GraphOptions
    record: bool = True
    domain: int | None = None
    namespace: str = '/'
    care: SupervisionOptions = field(default_factory=SupervisionOptions)

    @property
    def logs(self) -> Path:
        """Folder of the nodes' logs."""
        return self.graph.out / 'logs'

    @property
    def remaps(self) -> tuple[str, ...]:
        """What puts each node into the namespace."""
        return namespace_remaps(self.namespace) if self.namespace != '/' else ()

    @property
    def ros_arguments(self) -> list[str]:
        """The same on a command line."""
        options = [part for rule in self.remaps for part in ('-r', rule)]
        return ['--ros-args', *options] if options else []

    @property
    def participants(self) -> tuple[str, ...]:
        """Nodes that take part in the lockstep beside the simulator."""
        return tuple(
            name for name in interface.PARTICIPANTS if self.record or name != interface.RECORDER
        )


class GraphDisplay(Protocol):
    """Whoever shows a standing graph to people."""

    def say(self, line: str) -> None:
        """Take a line about something that happened."""

    def watching(
        self, supervisor: Supervisor, domain: int
    ) -> contextlib.AbstractContextManager[None]:
        """Show the graph as it is while the ``with`` lasts."""


def run_standing_graph(
    options: UpOptions, shown: GraphDisplay, on_stop: Callable[[Callable[[], None]], None]
) -> None:
    """Start a graph, and look after it until it is told to stop.

    A ``KeyboardInterrupt``, whenever it comes, kills every node; else they end in order.

    Args:
        options: what to start.
        shown: who shows it.
        on_stop: is given the function that ends it in order, as soon as there is one.

    Raises:
        UsageError: bad input, or the domain belongs to another graph.
        GraphLostError: the graph could not be kept up.
    """
    without = () if options.record else (interface.RECORDER,)
    with (
        own_domain(options.domain, options.namespace) as domain,
        node_processes(options.graph, domain, options.logs, without, options.remaps) as processes,
        NodeExecutor(domain) as spinning,
        _in_order(processes),
    ):
        supervisor = Supervisor(
            processes, options.care, shown.say, context=spinning.context,
            cli_args=options.ros_arguments,
        )
        spinning.add(supervisor)
        on_stop(supervisor.stop)
        with shown.watching(supervisor, domain):
            spin_until(spinning.executor, supervisor.ended)


@contextlib.contextmanager
def _in_order(processes: list[NodeProcess]) -> Iterator[None]:
    try:
        yield
        end_all(processes, IN_ORDER)
    except KeyboardInterrupt:
        end_all(processes, ())
        raise
