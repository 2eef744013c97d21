"""The whole graph for a campaign: composed in one process, or every node a process of its own.

Both start the same node classes on a ROS domain of their own, with discovery on this machine only.
"""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import rclpy
from domain_coordinator import domain_id
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter

from taxinet_ros.core.outcome import RunRequest, RunResult
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.ground_truth_perception import GroundTruthPerception
from taxinet_ros.nodes.mtl_monitor import MtlMonitor
from taxinet_ros.nodes.recorder import Recorder
from taxinet_ros.nodes.scenario_sampler import ScenarioSampler
from taxinet_ros.nodes.simulator import Simulator
from taxinet_ros.nodes.spinning import spin_until
from taxinet_ros.nodes.steering_controller import SteeringController
from taxinet_ros.nodes.taxinet_perception import TaxinetPerception

NodeClass = type[Any]
OnResult = Callable[[RunRequest, RunResult], bool]


@dataclass(frozen=True, kw_only=True)
class GraphOptions:
    """What a graph is made of.

    Attributes:
        perception: ``truth``, ``taxinet``, or a network's file.
        out: folder that takes one bag folder per run.
        images: runs whose camera frames go into the bags: ``all``, ``failures`` or ``none``.
        gains: steering gains that differ from the law's defaults, by parameter name.
        timeouts: the simulator's ``answer_timeout`` and ``ready_timeout`` [s], where not default.
    """

    perception: str
    out: Path
    images: str = 'all'
    gains: Mapping[str, float] = field(default_factory=dict)
    timeouts: Mapping[str, float] = field(default_factory=dict)

    def nodes(self) -> dict[str, tuple[NodeClass, dict[str, Any]]]:
        """Class and parameters of every node but the sampler, by node name."""
        if self.perception == 'truth':
            perception: tuple[NodeClass, dict[str, Any]] = (GroundTruthPerception, {})
        else:
            perception = (TaxinetPerception, {'weights': self.perception})
        return {
            interface.SIMULATOR: (Simulator, dict(self.timeouts)),
            interface.PERCEPTION: perception,
            interface.STEERING_CONTROLLER: (SteeringController, dict(self.gains)),
            interface.MTL_MONITOR: (MtlMonitor, {}),
            interface.RECORDER: (Recorder, {'out': str(self.out), 'images': self.images}),
        }


class Graph(Protocol):
    """A running graph that answers requests."""

    @property
    def domain(self) -> int:
        """The ROS domain id that it has for itself."""

    def run(self, requests: Iterable[RunRequest], on_result: OnResult) -> None:
        """Run the requests one after the other until they end or ``on_result`` says False."""

    def interrupt(self) -> None:
        """End the run at hand as INTERRUPTED and come back from :meth:`run`."""


# Each graph begins where the one before ended, so that none meets what lingers of its predecessor.
_domains = itertools.cycle([*range(1 + os.getpid() % 100, 101), *range(1, 1 + os.getpid() % 100)])


@contextlib.contextmanager
def own_domain() -> Iterator[int]:
    """Reserve a ROS domain id that no other graph on this machine uses, if all of them reserve.

    Discovery stays on this machine unless the user has set another range.
    ``TAXINET_DOMAIN_ID`` sets the domain by hand, to look at the graph with other tools.
    """
    with _localhost():
        yield from _reserved()


def _reserved() -> Iterator[int]:
    fixed = os.environ.get('TAXINET_DOMAIN_ID')
    if fixed:
        yield int(fixed)
        return
    # Entered and left by hand: the library's manager swallows an OSError of its body.
    reservation = domain_id(_domains.__next__)
    number = reservation.__enter__()
    try:
        yield number
    finally:
        reservation.__exit__(None, None, None)


@contextlib.contextmanager
def composed_graph(
    options: GraphOptions, executor: Callable[..., Any] = EventsExecutor
) -> Iterator[SampledGraph]:
    """Every node in this process, on one executor; they still talk only over topics.

    ``executor`` makes another one, from the keyword ``context``.
    """
    with own_domain() as domain:
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        graph = SampledGraph(context, executor)
        try:
            for node, parameters in options.nodes().values():
                overrides = [Parameter(name, value=value) for name, value in parameters.items()]
                graph.add(node(context=context, parameter_overrides=overrides))
            yield graph
        finally:
            graph.close()
            rclpy.try_shutdown(context=context)


@contextlib.contextmanager
def _localhost() -> Iterator[None]:
    """Discovery on this machine only, unless the user has set another range."""
    before = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE')
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    try:
        yield
    finally:
        if before is None:
            del os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE']


class SampledGraph:
    """A graph with a sampler in this process, beside whatever other nodes are added to it."""

    def __init__(
        self, context: Context, executor: Callable[..., Any] = EventsExecutor
    ) -> None:
        """Spin on ``context``, which is the caller's to shut down, with an executor of a kind."""
        self._context = context
        self._executor = executor(context=context)
        self.nodes: list[Any] = []
        self._sampler: ScenarioSampler | None = None

    @property
    def domain(self) -> int:
        """See :class:`Graph`."""
        return int(self._context.get_domain_id())

    @property
    def seq(self) -> int:
        """The control step that the run at hand has reached, as far as the sampler has heard."""
        return self._sampler.seq if self._sampler is not None else -1

    def add(self, node: Any) -> None:
        """Spin a node too, and close it with the graph."""
        self.nodes.append(node)
        self._executor.add_node(node)

    def prepare(self, sampler: ScenarioSampler) -> None:
        """Called with the sampler before a campaign begins."""

    def run(self, requests: Iterable[RunRequest], on_result: OnResult) -> None:
        """See :class:`Graph`."""
        sampler = ScenarioSampler(context=self._context)
        self._sampler = sampler
        self.prepare(sampler)
        self.add(sampler)
        finished = sampler.start(self._executor, requests, on_result)
        spin_until(self._executor, finished)

    def interrupt(self) -> None:
        """See :class:`Graph`."""
        if self._sampler is not None:
            self._sampler.interrupt()

    def close(self) -> None:
        """Take every node out of the graph."""
        for node in reversed(self.nodes):
            node.close()
            self._executor.remove_node(node)
            node.destroy_node()
        self._executor.shutdown()
