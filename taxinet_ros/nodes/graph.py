"""The whole graph for a campaign: composed in one process, or every node a process of its own.

Both start the same node classes on a ROS domain of their own, with discovery on this machine only.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import rclpy
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter

from taxinet_ros.core.outcome import RunRequest, RunResult
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.domain import own_domain
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
        patience: the sampler's ``server_timeout`` and ``silence_timeout`` [s], likewise.
        alone: whether runs are asked for by this process alone, so that no other is recorded.
    """

    perception: str
    out: Path
    images: str = 'all'
    gains: Mapping[str, float] = field(default_factory=dict)
    timeouts: Mapping[str, float] = field(default_factory=dict)
    patience: Mapping[str, float] = field(default_factory=dict)
    alone: bool = True

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
            interface.RECORDER: (Recorder, {
                'out': str(self.out), 'images': self.images, 'alone': self.alone,
            }),
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

    def give_up(self) -> bool:
        """Have :meth:`run` raise KeyboardInterrupt now; False where it does not run."""


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
        graph = SampledGraph(context, executor, options.patience)
        try:
            for node, parameters in options.nodes().values():
                graph.add(node(context=context, parameter_overrides=_overrides(parameters)))
            yield graph
        finally:
            graph.close()
            rclpy.try_shutdown(context=context)


def _overrides(parameters: Mapping[str, Any]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in parameters.items()]


class SampledGraph:
    """A graph with a sampler in this process, beside whatever other nodes are added to it."""

    def __init__(
        self, context: Context, executor: Callable[..., Any] = EventsExecutor,
        patience: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """Spin on ``context``, which is the caller's to shut down, with an executor of a kind.

        ``patience`` holds parameters of the sampler.
        """
        self._context = context
        self._patience = patience
        self._interrupted = False
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
        overrides = _overrides(self._patience)
        sampler = ScenarioSampler(context=self._context, parameter_overrides=overrides)
        self._sampler = sampler
        sampler.one_simulator = True
        if self._interrupted:
            sampler.interrupt()
        self.prepare(sampler)
        self.add(sampler)
        finished = sampler.start(self._executor, requests, on_result)
        spin_until(self._executor, finished)

    def interrupt(self) -> None:
        """See :class:`Graph`."""
        self._interrupted = True
        if self._sampler is not None:
            self._sampler.interrupt()

    def give_up(self) -> bool:
        """See :class:`Graph`."""
        return self._sampler is not None and self._sampler.give_up()

    def close(self) -> None:
        """Take every node out of the graph."""
        for node in reversed(self.nodes):
            node.close()
            self._executor.remove_node(node)
            node.destroy_node()
        self._executor.shutdown()
