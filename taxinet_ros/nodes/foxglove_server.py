"""Executable ``foxglove_server``: stream the graph's topics live to the Foxglove app.

Messages are forwarded as received, with their ROS definitions and simulated time, including the
markers of ``scene_markers``. The server listens on 127.0.0.1 only.
"""

from __future__ import annotations

import functools
from collections import deque
from typing import TYPE_CHECKING, Any

from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from taxinet_msgs.msg import Scenario

from taxinet_ros.bag.cdr.alignment import stamp_of_cdr
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.bag.topics import message_definition
from taxinet_ros.core.scenario import Scenario as Scene
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.lockstep.observer import Observer
from taxinet_ros.nodes.messages.markers import MovingMarkers, ground_markers
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import Parameter, Usage, declare_all, refuse_unknown

if TYPE_CHECKING:
    from foxglove import Channel
    from foxglove.websocket import WebSocketServer

HOST, PORT = '127.0.0.1', 8765
LOOKING_ON = 'looking on'
"""Line printed on stdout when a graph or a player was found."""

_STATIC_HELD = 100
"""Number of static transform messages kept for repetition, from all publishers."""

NOT_INSTALLED = 'foxglove-sdk is not installed; pip install -c constraints.txt foxglove-sdk'

USAGE = Usage(
    executable='foxglove_server',
    does='Streams every topic of the graph live to the Foxglove app on this machine.',
    subscribes=tuple(
        topic.name for topic in interface.TOPICS if topic is not interface.PROGRESS
    ),
    parameters=(
        Parameter(
            name='port', default=PORT, limits=(0, 65535),
            description='TCP port on 127.0.0.1; 0: any',
        ),
    ),
)


class FoxgloveServer(Observer):
    """Node that forwards every topic of the table to connected clients.

    Attributes:
        port: port it listens on.
    """

    def __init__(self, **node: Any) -> None:
        """Open the server; ``node`` goes to :class:`rclpy.node.Node`.

        Raises:
            UsageError: foxglove-sdk is not installed, or the port is taken.
        """
        super().__init__('foxglove_server', **node)
        port = declare_all(self, USAGE.parameters)['port']
        refuse_unknown(self)
        self._held: dict[str, deque[tuple[int, bytes]]] = {}
        self._now_ns = 0
        self._moving = MovingMarkers()
        self._server = self._open(port)
        self.port = int(self._server.port)
        topics = [topic for topic in interface.TOPICS if topic is not interface.PROGRESS]
        topics += interface.TRANSFORMS
        self._channels = {topic.name: self._channel(topic) for topic in (*topics, *interface.SCENE)}
        self._say(interface.SCENE_RUNWAY, serialize_message(ground_markers(Scene())), 0)
        for topic in topics:
            self.watch(topic, functools.partial(self._pass_on, topic), raw=True)
        print(f'listening on ws://{HOST}:{self.port}', flush=True)

    def found(self) -> None:
        """See :class:`.Onlooker`."""
        print(LOOKING_ON, flush=True)

    def close(self) -> None:
        """Close the server."""
        super().close()
        self._server.stop()

    def _open(self, port: int) -> WebSocketServer:
        try:
            import foxglove
            from foxglove.websocket import Capability
        except ImportError:
            raise UsageError(f'foxglove_server: {NOT_INSTALLED}') from None
        self._sinks = foxglove.Context()
        try:
            return foxglove.start_server(
                name='taxinet_ros', host=HOST, port=port, capabilities=[Capability.Time],
                server_listener=_Latecomers(self), context=self._sinks,
            )
        except RuntimeError as error:
            raise UsageError(
                f'foxglove_server: port {port}: {" ".join(str(error).split())}; choose another one'
            ) from error

    def _channel(self, topic: Topic) -> Channel:
        from foxglove import Channel, Schema

        definition = message_definition(topic.type_name).encode()
        return Channel(
            self.resolve_topic_name(topic.name), message_encoding='cdr', context=self._sinks,
            schema=Schema(name=topic.type_name, encoding='ros2msg', data=definition),
        )

    def repeat(self, path: str) -> None:
        """Send the last message of a latched topic again; ``name`` is its full name."""
        for name, held in list(self._held.items()):
            if self._channels[name].topic() == path:
                for stamp_ns, cdr in list(held):
                    self._channels[name].log(cdr, log_time=stamp_ns)

    def _pass_on(self, topic: Topic, cdr: bytes) -> None:
        if topic in interface.TRANSFORMS:
            # From any publisher, with stamps of any clock, including the wall clock.
            self._say(topic, cdr, self._now_ns)
            return
        stamp_ns = stamp_of_cdr(cdr)
        if topic in (interface.CLOCK, interface.SCENARIO):
            self._now_ns = stamp_ns
            self._server.broadcast_time(stamp_ns)
        if topic is interface.SCENARIO:
            self._change_scene(cdr)
            # A new run: time jumps back, and the app drops its earlier messages.
            for still in (interface.SCENE_RUNWAY, interface.TF_STATIC):
                self.repeat(self._channels[still.name].topic())
        self._say(topic, cdr, stamp_ns)
        if topic is interface.ODOMETRY:
            markers = self._moving.markers(deserialize_message(cdr, Odometry))
            self._say(interface.SCENE_AIRCRAFT, serialize_message(markers), stamp_ns)

    def _change_scene(self, cdr: bytes) -> None:
        ground = self._moving.change(scenario_of(deserialize_message(cdr, Scenario)))
        if ground is not None:
            self._say(interface.SCENE_RUNWAY, serialize_message(ground), 0)

    def _say(self, topic: Topic, cdr: bytes, stamp_ns: int) -> None:
        if topic.quality.latched:
            many = topic is interface.TF_STATIC
            held = self._held.setdefault(topic.name, deque(maxlen=_STATIC_HELD if many else 1))
            if not many or cdr not in (before for _, before in held):
                held.append((stamp_ns, cdr))
        self._channels[topic.name].log(cdr, log_time=stamp_ns)


class _Latecomers:
    """Sends latched messages to late subscribers; called from a server thread."""

    def __init__(self, server: FoxgloveServer) -> None:
        self._server = server

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self._server.repeat(channel.topic)

    def __getattr__(self, name: str) -> Any:
        if name.startswith('on_'):
            return lambda *_: None
        raise AttributeError(name)


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros foxglove_server``."""
    run_node(FoxgloveServer, usage=USAGE)


if __name__ == '__main__':
    main()
