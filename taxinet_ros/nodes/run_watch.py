"""What somebody beside a graph hears of its runs, without a part in them."""

from __future__ import annotations

import collections
import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from taxinet_msgs.msg import NodeStatus, RunStatus

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.notices import lost_run, obituary
from taxinet_ros.nodes.onlooker import AT_LEISURE
from taxinet_ros.nodes.presence import End

_CANCEL = interface.RUN_SCENARIO_TYPE.Impl.CancelGoalService


class RunWatch:
    """Follows the runs of a graph, tells it of a death, and can have the run at hand ended.

    Listens only to what is latched and to the action's feedback: no node counts such ears.

    Attributes:
        run_id: the run at hand, or ''.
        running: whether it has begun.
        seq: the control step that it has reached.
        heard_s: when the simulator was heard last, by the monotonic clock [s].
        last_run: the run that ended last, or ''.
        outcomes: how many runs ended how.
    """

    def __init__(self, node: Node, say: Callable[[str], None]) -> None:
        """Listen and speak through ``node``; ``say`` takes a line when a run has ended."""
        self._say = say
        self._node = node
        self._deaths: dict[str, tuple[str, set[End]]] = {}
        self._told: set[tuple[str, str]] = set()
        self.run_id = self.last_run = ''
        self.running = self.closed = False
        self.seq = 0
        self.heard_s = 0.0
        self.outcomes: collections.Counter[str] = collections.Counter()
        status, run_status = interface.NODE_STATUS, interface.RUN_STATUS
        node.create_subscription(RunStatus, run_status.name, self._on_run, run_status.qos)
        node.create_subscription(NodeStatus, status.name, self._on_status, status.qos)
        node.create_subscription(
            interface.RUN_SCENARIO_TYPE.Impl.FeedbackMessage,
            f'{interface.RUN_SCENARIO}/_action/feedback', self._on_feedback, AT_LEISURE,
        )
        obituaries = interface.OBITUARY
        node.create_subscription(NodeStatus, obituaries.name, self._on_obituary, obituaries.qos)
        self._obituaries = node.create_publisher(NodeStatus, obituaries.name, obituaries.qos)
        self._cancel = node.create_client(_CANCEL, f'{interface.RUN_SCENARIO}/_action/cancel_goal')

    def mourn(self, name: str, detail: str) -> None:
        """A node's process is dead: have the run at hand end at once, with the reason.

        A run is at hand as soon as one is begun, though it may be heard of only after the death.
        """
        self._deaths[name] = detail, self._in_graph()
        if self.run_id:
            self._tell(name, detail)

    def _tell(self, name: str, detail: str) -> None:
        if (self.run_id, name) not in self._told:
            self._told.add((self.run_id, name))
            self._obituaries.publish(obituary(self.run_id, name, detail, seq=self.seq))

    def interrupt(self) -> bool:
        """Have the run at hand ended as INTERRUPTED, whoever asked for it; False if there is none.

        An empty request means all goals, by the definition of the action's cancel service.
        """
        if not self.run_id or not self._cancel.service_is_ready():
            return False
        self._cancel.call_async(_CANCEL.Request())
        return True

    def _follow(self, run_id: str, *, running: bool) -> None:
        """A run is heard of: it is told of deaths that are none of the past for it.

        Since a death nobody new has come to the graph: then a run of the dead simulator is at hand,
        or one that had begun with the dead node among those who were ready.
        """
        self.run_id = run_id
        for name, (detail, others) in self._deaths.items():
            if (running or name == interface.SIMULATOR) and self._in_graph() <= others:
                self._tell(name, detail)

    def _in_graph(self) -> set[End]:
        """Ends by which the simulator and the nodes of the lockstep speak of runs."""
        return {
            tuple(end.endpoint_gid) for topic in (interface.RUN_STATUS, interface.NODE_STATUS)
            for end in self._node.get_publishers_info_by_topic(topic.name)
        }

    def _on_run(self, status: RunStatus) -> None:
        if status.state != RunStatus.ENDED:
            self.running = status.state == RunStatus.RUNNING
            self.seq, self.closed = status.seq, False
            self._follow(status.run_id, running=self.running)
        else:
            self._end(status)

    def _end(self, status: RunStatus) -> None:
        if status.run_id == self.run_id:
            self.run_id, self.last_run, self.running = '', status.run_id, False
            self.outcomes[str(status.outcome)] += 1
            words = [str(status.outcome), status.kind, status.who, status.detail]
            self._say(f'run {status.run_id}: {" ".join(word for word in words if word)}')

    def _on_obituary(self, notice: NodeStatus) -> None:
        if notice.node == interface.SIMULATOR:
            self._end(lost_run(notice))

    def _on_status(self, status: NodeStatus) -> None:
        # What the simulator said of the run may have been lost with it: others are ready for it.
        if status.state == NodeStatus.READY and not self.run_id and status.run_id != self.last_run:
            self._follow(status.run_id, running=False)
        if status.state == NodeStatus.DONE and status.run_id in (self.run_id, self.last_run):
            self.closed = True

    def _on_feedback(self, message: Any) -> None:
        self.heard_s = time.monotonic()
        if self.run_id:
            self.seq = message.feedback.seq
