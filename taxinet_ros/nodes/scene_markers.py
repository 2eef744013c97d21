"""Executable ``scene_markers``: publish ground, aircraft and others as markers for 3-D viewers.

It works with any graph or ``bag_player`` without taking part. The Foxglove server publishes the
same markers.
"""

from __future__ import annotations

from typing import Any

from nav_msgs.msg import Odometry

from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.lockstep.observer import Observer
from taxinet_ros.nodes.messages.markers import MovingMarkers, ground_markers
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import Usage, published_topics, refuse_unknown

USAGE = Usage(
    executable=interface.SCENE_MARKERS,
    does='Draws ground, aircraft, path and others as markers for RViz and other viewers, beside '
    'any graph or bag_player.',
    publishes=published_topics(interface.SCENE_MARKERS),
    subscribes=(interface.RUN_STATUS.name, interface.ODOMETRY.name, interface.SCENARIO.name),
)


class SceneMarkers(Observer):
    """Publishes markers from odometry."""

    def __init__(self, **node: Any) -> None:
        """Publish the static markers; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(interface.SCENE_MARKERS, **node)
        refuse_unknown(self)
        self._speakers = {
            topic.name: self.create_publisher(topic.type, topic.name, topic.qos)
            for topic in interface.SCENE
        }
        self._moving = MovingMarkers()
        self._say(interface.SCENE_RUNWAY, ground_markers(Scenario()))
        self.watch(interface.ODOMETRY, self._draw)
        self.watch(interface.SCENARIO, self._change_scene)

    def _change_scene(self, message: Any) -> None:
        if (ground := self._moving.change(scenario_of(message))) is not None:
            self._say(interface.SCENE_RUNWAY, ground)

    def _draw(self, odometry: Odometry) -> None:
        self._say(interface.SCENE_AIRCRAFT, self._moving.markers(odometry))

    def _say(self, topic: Topic, message: Any) -> None:
        self._speakers[topic.name].publish(message)


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros scene_markers``."""
    run_node(SceneMarkers, usage=USAGE)

if __name__ == '__main__':
    main()
