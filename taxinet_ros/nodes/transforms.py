"""The simulator's, or a player's, word on where the frames are, for RViz, Foxglove and tf2."""

from __future__ import annotations

from rclpy.node import Node

from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.bag.transforms import OdometryTransforms, camera_transform
from taxinet_ros.nodes import interface


class TransformBroadcaster:
    """Publishes ``tf_static`` once, for whoever comes, and ``tf`` with each odometry."""

    def __init__(
        self, node: Node, *, prefix: str = '', odometry: TopicInfo | None = None
    ) -> None:
        """Say where the camera is.

        Args:
            node: who speaks.
            prefix: what is put before the names of the topics, with its slash.
            odometry: as in :class:`.OdometryTransforms`.
        """
        static, moving = (
            node.create_publisher(topic.type, prefix + topic.name, topic.qos)
            for topic in interface.TRANSFORMS
        )
        self._moving = moving
        self._transform_of = OdometryTransforms(odometry)
        static.publish(camera_transform())

    def follow(self, odometry: bytes) -> None:
        """Say where ``base_link`` is by serialised odometry, if anybody listens.

        Raises:
            BagCorrupt: the bytes are no odometry.
        """
        if self._moving.get_subscription_count():
            self._moving.publish(self._transform_of(odometry))
