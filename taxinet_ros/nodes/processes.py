"""The graph as separate processes: spawned, watched and ended by the campaign's process."""

from __future__ import annotations

import contextlib
import functools
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.context import Context

from taxinet_ros.core.errors import UsageError
from taxinet_ros.nodes.domain import own_domain
from taxinet_ros.nodes.graph import Graph, GraphOptions, SampledGraph
from taxinet_ros.nodes.node_process import NodeProcess, end_all
from taxinet_ros.nodes.scenario_sampler import ScenarioSampler

_POLL_S = 0.1


@contextlib.contextmanager
def process_graph(options: GraphOptions, logs: Path) -> Iterator[Graph]:
    """Every node but the sampler as a process of its own; ``logs`` takes what they print."""
    with own_domain() as domain, node_processes(options, domain, logs) as children:
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        graph = _Processes(context, children, options.patience)
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
    with tempfile.TemporaryDirectory(prefix='taxinet-') as scratch:
        try:
            for name, (kind, parameters) in options.nodes().items():
                if name not in without:
                    children.append(NodeProcess(
                        name, kind, parameters, domain=domain, logs=logs, scratch=Path(scratch),
                    ))
            yield children
        finally:
            end_all(children)


class _Processes(SampledGraph):
    def __init__(
        self, context: Context, children: list[NodeProcess], patience: Mapping[str, float]
    ) -> None:
        super().__init__(context, patience=patience)
        self.children = children

    def prepare(self, sampler: ScenarioSampler) -> None:
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        sampler.create_timer(_POLL_S, functools.partial(self._watch, sampler), clock=steady)

    def _watch(self, sampler: ScenarioSampler) -> None:
        for child in self.children:
            if not child.dead:
                continue
            if child.process.returncode == 2:
                raise UsageError(child.complaint())
            sampler.mourn(child.name, child.obituary())
