"""Base class of nodes that observe a graph without disturbing it.

Lockstep nodes wait until all their subscribers are matched, and count them: an early observer would
be counted as one of them, and a message sent too soon. So it subscribes after the run has started,
with best effort, so that no node ever waits for it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from taxinet_msgs.msg import RunStatus

from taxinet_ros.core import topics
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic

_LOOK_PERIOD_S = 0.1
AT_LEISURE = interface.qos_profile(topics.LOOKING_ON)


class Observer(Node):
    """A node that observes a graph driven by a simulator or ``bag_player``."""

    def __init__(self, name: str, **node: Any) -> None:
        """Create the node; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(name, **node)
        self._waiting: list[tuple[Topic, Callable[[Any], None], bool]] = []
        # Latched messages reach late subscribers, so being counted is harmless there.
        self._found = False
        self._status = self.create_subscription(
            RunStatus, interface.RUN_STATUS.name, self._on_run_status, interface.RUN_STATUS.qos
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._looking = self.create_timer(_LOOK_PERIOD_S, self._look, clock=steady)

    def watch(self, topic: Topic, callback: Callable[[Any], None], *, raw: bool = False) -> None:
        """Subscribe to a topic of the table as soon as this disturbs no node."""
        if topic.quality.latched:
            self.create_subscription(topic.type, topic.name, callback, topic.qos, raw=raw)
        else:
            self._waiting.append((topic, callback, raw))

    def found(self) -> None:
        """Called once, when a graph was found."""

    def waits_for(self) -> list[str]:
        """The missing driver of a graph, see :class:`.node_main.Waiting`."""
        return [] if self._found else [f'{interface.SIMULATOR} or bag_player']

    def close(self) -> None:
        """Stop observing; called once before the node is destroyed."""
        self._looking.cancel()

    def _on_run_status(self, status: RunStatus) -> None:
        if status.state == RunStatus.RUNNING:
            self._join()

    def _look(self) -> None:
        """Join at once if a player drives the graph, which counts no subscribers."""
        if not self._found and self._status.get_publisher_count():
            self._found = True
            self.found()
        topic = self.resolve_topic_name(interface.ODOMETRY.name)
        speakers = {info.node_name for info in self.get_publishers_info_by_topic(topic)}
        if speakers and interface.SIMULATOR not in speakers:
            self._join()

    def _join(self) -> None:
        if self._found:
            self._looking.cancel()
        for topic, callback, raw in self._waiting:
            self.create_subscription(topic.type, topic.name, callback, AT_LEISURE, raw=raw)
        self._waiting.clear()
