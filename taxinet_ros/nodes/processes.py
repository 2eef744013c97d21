"""The graph as separate processes: spawned, watched and ended by the campaign's process."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

import rclpy
from rclpy.context import Context

from taxinet_ros.nodes.domain import own_domain
from taxinet_ros.nodes.graph import Graph, GraphOptions, SampledGraph
from taxinet_ros.nodes.node_process import NodeProcess, command_processes, end_all


@contextlib.contextmanager
def process_graph(options: GraphOptions, logs: Path) -> Iterator[Graph]:
    """Every node but the sampler as a process of its own; ``logs`` takes what they print."""
    with own_domain() as domain, node_processes(options, domain, logs) as children:
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        graph = SampledGraph(context, patience=options.patience, children=children)
        try:
            yield graph
        finally:
            graph.close()
            rclpy.try_shutdown(context=context)


@contextlib.contextmanager
def node_processes(
    options: GraphOptions, domain: int, logs: Path, without: tuple[str, ...] = ()
) -> Iterator[list[NodeProcess]]:
    """Start every node of a graph but the sampler; none of them outlasts the ``with``.

    Args:
        options: what the graph is made of.
        domain: ROS domain that the nodes join.
        logs: folder that takes what each of them prints.
        without: names of nodes to leave out.
    """
    logs.mkdir(parents=True, exist_ok=True)
    children: list[NodeProcess] = []
    with (
        tempfile.TemporaryDirectory(prefix='taxinet-') as scratch,
        command_processes(options.commands(), domain, logs) as of_others,
    ):
        try:
            for name, (kind, parameters) in options.nodes().items():
                if name not in without:
                    children.append(NodeProcess.of_ours(
                        name, kind, parameters, domain=domain, log=logs / f'{name}.log',
                        scratch=Path(scratch),
                    ))
            yield [*children, *of_others]
        finally:
            end_all(children)
