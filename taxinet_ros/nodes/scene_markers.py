"""Executable ``scene_markers``: runway, aircraft and path as markers, for RViz and other viewers.

It runs beside any graph, or beside ``bag_player``, and takes no part in either.
"""

from __future__ import annotations

from typing import Any

from nav_msgs.msg import Odometry

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.main import run_node
from taxinet_ros.nodes.onlooker import Onlooker
from taxinet_ros.nodes.parameters import refuse_unknown
from taxinet_ros.nodes.scene import Aircraft, runway_markers
from taxinet_ros.nodes.usage import Usage, spoken

USAGE = Usage(
    executable=interface.SCENE_MARKERS,
    does='Draws runway, aircraft and path as markers for RViz and other viewers, beside any graph '
    'or bag_player.',
    publishes=spoken(interface.SCENE_MARKERS),
    subscribes=(interface.RUN_STATUS.name, interface.ODOMETRY.name),
)


class SceneMarkers(Onlooker):
    """Draws what odometry tells."""

    def __init__(self, **node: Any) -> None:
        """Publish what stands still; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(interface.SCENE_MARKERS, **node)
        refuse_unknown(self)
        self._speakers = {
            topic.name: self.create_publisher(topic.type, topic.name, topic.qos)
            for topic in interface.SCENE
        }
        self._aircraft = Aircraft()
        self._say(interface.SCENE_RUNWAY, runway_markers())
        self.watch(interface.ODOMETRY, self._draw)

    def _draw(self, odometry: Odometry) -> None:
        self._say(interface.SCENE_AIRCRAFT, self._aircraft.markers(odometry))

    def _say(self, topic: Topic, message: Any) -> None:
        self._speakers[topic.name].publish(message)


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros scene_markers``."""
    run_node(SceneMarkers, usage=USAGE)


if __name__ == '__main__':
    main()
