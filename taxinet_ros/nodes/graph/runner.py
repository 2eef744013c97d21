"""The graph of a campaign: composed in one process, or one process per node.

Both start the same node classes on a private ROS domain, with discovery on this machine only.
"""

from __future__ import annotations

import contextlib
import functools
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from rclpy.clock import Clock, ClockType
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter

from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.system import System
from taxinet_ros.core.user_code import is_node_elsewhere, node_command
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.node_process import NodeProcess
from taxinet_ros.nodes.ground_truth_perception import GroundTruthPerception
from taxinet_ros.nodes.lockstep.sampler import ScenarioSampler
from taxinet_ros.nodes.mtl_monitor import MtlMonitor
from taxinet_ros.nodes.names import perception_executable
from taxinet_ros.nodes.recorder import Recorder
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.executor import NodeExecutor
from taxinet_ros.nodes.running.node_main import spin_until
from taxinet_ros.nodes.simulator import Simulator
from taxinet_ros.nodes.steering_controller import SteeringController
from taxinet_ros.nodes.taxinet_perception import TaxinetPerception
from taxinet_ros.processes.child import end_all
from taxinet_ros.registry import KMWH
from taxinet_ros.trials.options import CampaignOptions

NodeClass = type[Any]
OnResult = Callable[[RunRequest, RunResult], bool]
_POLL_S = 0.1
_PERCEPTIONS: dict[str, NodeClass] = {
    'ground_truth_perception': GroundTruthPerception, 'taxinet_perception': TaxinetPerception,
}


@dataclass(frozen=True, kw_only=True)
class GraphOptions(System):
    """A system that runs as a graph of nodes.

    Attributes:
        out: folder for the bags, one folder per run.
        make_out: whether to create a missing ``out``. A campaign creates its own, so if it is
            missing, it was moved or deleted and must not be replaced.
        images: runs whose camera frames are recorded: ``all``, ``failures`` or ``none``.
        timeouts: the simulator's ``answer_timeout`` and ``ready_timeout`` [s], if not default.
        patience: the sampler's ``server_timeout`` and ``silence_timeout`` [s], if not default.
    """

    out: Path
    make_out: bool = True
    images: str = 'all'
    timeouts: Mapping[str, float] = field(default_factory=dict)
    patience: Mapping[str, float] = field(default_factory=dict)

    def nodes(self) -> dict[str, tuple[NodeClass, dict[str, Any]]]:
        """Class and parameters of every node of this package except the sampler, by node name."""
        executable, parameters = perception_executable(self.perception)
        perception = (_PERCEPTIONS[executable], parameters)
        steering = {} if self.controller == STEERING else {
            'controller': self.controller, 'controller_sha256': self.controller_sha256,
        }
        every: dict[str, tuple[NodeClass, dict[str, Any]]] = {
            interface.SIMULATOR: (Simulator, {**self.timeouts, **self._simulator()}),
            interface.PERCEPTION: perception,
            interface.STEERING_CONTROLLER: (SteeringController, {**self.gains, **steering}),
            interface.MTL_MONITOR: (MtlMonitor, {}),
            interface.RECORDER: (Recorder, {
                'out': str(self.out), 'make_out': self.make_out, 'images': self.images,
            }),
        }
        return {name: node for name, node in every.items() if name not in self.elsewhere}

    def _simulator(self) -> dict[str, Any]:
        there = {} if self.world == KMWH else {
            'world': self.world, 'world_sha256': self.world_sha256,
        }
        if self.timing.free:
            return {**there, 'lockstep': False, 'real_time_factor': self.timing.factor}
        return {**there, 'latency': self.timing.latency} if self.timing.laws else there

    @property
    def elsewhere(self) -> dict[str, str]:
        """Words of :mod:`taxinet_ros.core.user_code` by the name of the node they replace."""
        words = {
            interface.PERCEPTION: self.perception, interface.STEERING_CONTROLLER: self.controller,
        }
        return {name: word for name, word in words.items() if is_node_elsewhere(word)}

    def commands(self, remaps: Sequence[str] = ()) -> dict[str, list[str]]:
        """Program and arguments of every user command, by node name.

        The node gets its name in the graph and ``remaps`` of the form ``FROM:=TO``.
        """
        found = {name: node_command(word, name, remaps) for name, word in self.elsewhere.items()}
        return {name: words for name, words in found.items() if words}


def campaign_graph(campaign: CampaignOptions, system: System) -> GraphOptions:
    """Options of the graphs of a campaign whose folder exists, with its recorded system."""
    return GraphOptions(
        **vars(system), out=campaign.out, make_out=False, images=campaign.images
    )


class Graph(Protocol):
    """A running graph that executes requests."""

    @property
    def domain(self) -> int:
        """The private ROS domain id."""

    def run(self, requests: Iterable[RunRequest], on_result: OnResult) -> None:
        """Run the requests in order until they end or ``on_result`` returns False."""

    def interrupt(self) -> None:
        """End the current run as INTERRUPTED and return from :meth:`run`."""


@contextlib.contextmanager
def composed_graph(
    options: GraphOptions, executor: Callable[..., Any] = EventsExecutor
) -> Iterator[SampledGraph]:
    """Run every node in this process on one executor; they still communicate only over topics.

    ``executor`` is an alternative factory, called with the keyword ``context``.
    """
    with (
        own_domain() as domain,
        node_processes(options, domain, options.out / 'logs', ours=False) as children,
        NodeExecutor(domain, executor) as spinning,
    ):
        for node, parameters in options.nodes().values():
            overrides = _overrides(parameters)
            spinning.add(node(context=spinning.context, parameter_overrides=overrides))
        yield SampledGraph(spinning, options.patience, children)


def _overrides(parameters: Mapping[str, Any]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in parameters.items()]


class SampledGraph:
    """A graph with a sampler in this process and any other nodes added to it."""

    def __init__(
        self, spinning: NodeExecutor, patience: Mapping[str, float],
        children: Sequence[NodeProcess],
    ) -> None:
        """Create the sampler; the death of one of the ``children`` ends the run under way."""
        self.children = children
        self._spinning = spinning
        self._patience = patience
        self._interrupted = False
        self._sampler: ScenarioSampler | None = None

    @property
    def domain(self) -> int:
        """See :class:`Graph`."""
        return int(self._spinning.context.get_domain_id())

    @property
    def seq(self) -> int:
        """Latest control step of the current run known to the sampler."""
        return self._sampler.seq if self._sampler is not None else -1

    @property
    def nodes(self) -> Sequence[Any]:
        """The nodes of this process."""
        return self._spinning.nodes

    def run(self, requests: Iterable[RunRequest], on_result: OnResult) -> None:
        """See :class:`Graph`."""
        overrides = _overrides(self._patience)
        sampler = ScenarioSampler(
            context=self._spinning.context, parameter_overrides=overrides
        )
        self._sampler = sampler
        if self._interrupted:
            sampler.interrupt()
        if self.children:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            sampler.create_timer(_POLL_S, functools.partial(self._watch, sampler), clock=steady)
        self._spinning.add(sampler)
        executor = self._spinning.executor
        spin_until(executor, sampler.start(executor, requests, on_result))

    def interrupt(self) -> None:
        """See :class:`Graph`."""
        self._interrupted = True
        if self._sampler is not None:
            self._sampler.interrupt()

    def _watch(self, sampler: ScenarioSampler) -> None:
        for child in self.children:
            if not child.dead:
                continue
            if child.refused:
                raise UsageError(child.refused)
            sampler.report_death(child.name, child.how_it_ended())


@contextlib.contextmanager
def process_graph(options: GraphOptions, logs: Path) -> Iterator[Graph]:
    """Run every node except the sampler in its own process; output goes to ``logs``."""
    with (
        own_domain() as domain, node_processes(options, domain, logs) as children,
        NodeExecutor(domain) as spinning,
    ):
        yield SampledGraph(spinning, options.patience, children)


@contextlib.contextmanager
def node_processes(
    options: GraphOptions, domain: int, logs: Path, *, ours: bool = True,
    without: tuple[str, ...] = (), remaps: Sequence[str] = (),
) -> Iterator[list[NodeProcess]]:
    """Context of the processes of a graph, all ended on exit: users' commands, and nodes of ours.

    Args:
        options: options of the graph.
        domain: ROS domain of the nodes.
        logs: folder for their output.
        ours: whether our nodes, except the sampler, have processes, too.
        without: names of nodes of ours to leave out.
        remaps: remap rules for every node, ``FROM:=TO``.
    """
    commands = options.commands(remaps)
    if ours or commands:
        logs.mkdir(parents=ours, exist_ok=True)
    children: list[NodeProcess] = []
    with tempfile.TemporaryDirectory(prefix='taxinet-') as scratch:
        try:
            for name, command in commands.items():
                log = logs / f'{name}-{domain}.log'
                children.append(NodeProcess.of_command(name, command, domain=domain, log=log))
            for name, (kind, parameters) in options.nodes().items() if ours else ():
                if name not in without:
                    children.append(NodeProcess.of_ours(
                        name, kind, parameters, domain=domain, log=logs / f'{name}.log',
                        scratch=Path(scratch), remaps=remaps,
                    ))
            yield children
        finally:
            end_all(children)
