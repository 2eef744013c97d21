"""Sampler on a graph whose nodes others have started, and may end."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

from taxinet_msgs.msg import NodeStatus

from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import InfraKind
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep.sampler import ScenarioSampler
from taxinet_ros.nodes.running.domain import nodes_present
from taxinet_ros.nodes.running.node_main import spin_until
from taxinet_ros.trials.engine import Engine

_SETTLED_S, _RECORDER_S = 0.7, 3.0
"""Times before the first run [s]: since the recorder was found, and at most, without it."""
_RIVAL = (
    'another sampler drives this graph; end it first (a killed one disappears after about 20 s), '
    'or give each graph its own ROS_DOMAIN_ID'
)


class StandingSampler(ScenarioSampler):
    """Makes the runs of a campaign, and says why the graph is unusable if it is.

    Attributes:
        participants: nodes of the lockstep, without the simulator.
        bags: folder in which the recorder writes, as it says; '' if none did.
    """

    participants: tuple[str, ...] = ()

    def __init__(self, **node: Any) -> None:
        """Join the graph; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(**node)
        topic, status = interface.OBITUARY, interface.NODE_STATUS
        self.create_subscription(NodeStatus, topic.name, self._on_death_notice, topic.qos)
        self.create_subscription(NodeStatus, status.name, self._on_status, status.qos)
        self.bags = ''
        self._found_s = 0.0

    def waits_for(self) -> list[str]:
        """The simulator, if not found; see :class:`.node_main.Waiting`."""
        asked = self._request is not None and not self._last_heard
        return [interface.SIMULATOR] if asked else []

    def _may_ask(self) -> bool:
        """Also let the recorder find this node: when it is ready, it says where the bags are."""
        if not super()._may_ask():
            return False
        if self.bags or interface.RECORDER not in self.participants:
            return True
        now = time.monotonic()
        ends = self.get_publishers_info_by_topic(interface.NODE_STATUS.name)
        if not self._found_s and interface.RECORDER in {end.node_name for end in ends}:
            self._found_s = now
        # This node has found the recorder a moment before the recorder has found this node.
        settled = self._found_s and now - self._found_s > _SETTLED_S
        return bool(settled) or now - self._asked > _RECORDER_S

    def drive(self, executor: Any, engine: Engine[Any]) -> str:
        """Make the runs of a campaign one by one; return why the graph is unusable, or ''."""
        if nodes_present(self).count(self.get_name()) > 1:
            return _RIVAL
        broken: set[int] = set()
        trouble = ''

        def take(request: RunRequest, result: RunResult) -> bool:
            nonlocal trouble
            # If the second attempt at a run finds no graph, the run may have broken it, so that is
            # its result.
            if result.outcome is Outcome.INFRA_ERROR and request.index not in broken:
                trouble = self._trouble(result)
                if trouble:
                    return False
                broken.add(request.index)
            recorded = interface.RECORDER in request.participants
            engine.take(request, replace(result, bags=self.bags if recorded else ''))
            return True

        spin_until(executor, self.start(executor, iter(engine.next, None), take))
        return trouble

    def _trouble(self, result: RunResult) -> str:
        """Tell a graph that is unusable from a run that failed: why it is, or ''."""
        if result.kind == InfraKind.BUSY:
            # The simulator may have been found before the sampler that it works for.
            return _RIVAL if nodes_present(self).count(self.get_name()) > 1 else (
                "the simulator is busy with another client's run; wait for its end, or give each "
                'graph its own ROS_DOMAIN_ID'
            )
        if result.kind != InfraKind.NOT_READY:
            return ''
        if result.who == interface.SIMULATOR:
            near = 'the same ROS_DOMAIN_ID and discovery range'
            return f'simulator: {result.detail}; start it with {near}'
        seen = nodes_present(self)
        if absent := ', '.join(name for name in self.participants if name not in seen):
            return f'{absent}: not in the graph; start it, or correct the parameter participants'
        return f'{result.who}: {result.detail}; see their output'

    def _on_death_notice(self, notice: NodeStatus) -> None:
        """The supervisor of the simulator's process reports its death at once."""
        dead = (notice.state, notice.node) == (NodeStatus.DIED, interface.SIMULATOR)
        if dead and self._request is not None and self._request.run_id == notice.run_id:
            self.report_death(notice.node, notice.detail)

    def _on_status(self, status: NodeStatus) -> None:
        # A replay's has no folder.
        if (status.state, status.node) == (NodeStatus.READY, interface.RECORDER) and status.detail:
            self.bags = status.detail
