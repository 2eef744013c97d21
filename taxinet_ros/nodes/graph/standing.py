"""A standing graph of node processes that waits for an external sampler."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.launch_plan import namespace_remaps
from taxinet_ros.nodes.graph.node_process import NodeProcess
from taxinet_ros.nodes.graph.runner import GraphOptions, node_processes
from taxinet_ros.nodes.graph.supervisor import Restart, Supervisor
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.executor import NodeExecutor
from taxinet_ros.nodes.running.node_main import spin_until
from taxinet_ros.processes.child import IN_ORDER, end_all


def remaps_into(namespace: str) -> tuple[str, ...]:
    """Remaps that move a node into an absolute namespace."""
    return namespace_remaps(namespace) if namespace != '/' else ()


def run_standing_graph(
    graph: GraphOptions, say: Callable[[str], None],
    watching: Callable[[Supervisor, int], contextlib.AbstractContextManager[None]], *,
    record: bool, domain_id: int | None, namespace: str, restart: Restart,
) -> None:
    """Start a graph and supervise it until stopped.

    A ``KeyboardInterrupt`` at any time kills every node; otherwise they end in order.

    Args:
        graph: graph options; ``out`` also holds the logs.
        say: called with a line per event.
        watching: entered while the graph stands, with the supervisor, which can stop the graph, and
            the domain.
        record: whether there is a recorder.
        domain_id: ROS domain; None for a free one.
        namespace: absolute namespace of every name in the graph, including its clock; graphs with
            different namespaces may share a domain set by the user.
        restart: what to do when a node dies.

    Raises:
        UsageError: bad input, or the domain belongs to another graph.
        GraphLostError: the graph could not be kept up.
    """
    without, remaps = () if record else (interface.RECORDER,), remaps_into(namespace)
    rules = [part for rule in remaps for part in ('-r', rule)]
    with (
        own_domain(domain_id, namespace) as domain,
        node_processes(
            graph, domain, graph.out / 'logs', without=without, remaps=remaps,
        ) as processes,
        NodeExecutor(domain) as spinning,
        _in_order(processes),
    ):
        supervisor = Supervisor(
            processes, say, restart=restart, context=spinning.context,
            cli_args=['--ros-args', *rules] if rules else [],
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
