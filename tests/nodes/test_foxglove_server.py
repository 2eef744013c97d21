"""The graph's topics, live, over the protocol of the Foxglove app; the run goes on as ever.

The client here is of the ``websockets`` library: subprotocol ``foxglove.sdk.v1``, control messages
as JSON, messages as a byte 1, the subscription, the time and the payload.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import itertools
import json
import socket
import struct
import threading

import pytest
from rclpy.serialization import deserialize_message

from taxinet_ros.bag.reader import read_messages
from taxinet_ros.bag.topics import message_definition
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.foxglove_view import check_port, foxglove_view
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.running.domain import own_domain

connect = pytest.importorskip('websockets.sync.client').connect
pytest.importorskip('foxglove')
pytestmark = pytest.mark.ros

MESSAGE = struct.Struct('<BIQ')
TOPICS = {
    '/' + topic.name.lstrip('/'): topic
    for topic in (*interface.TOPICS, *interface.TRANSFORMS, *interface.SCENE)
    if topic is not interface.PROGRESS
}


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


class Client(threading.Thread):
    """Subscribes to everything that is offered, and keeps what comes."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.channels: dict[str, dict] = {}
        self.heard: dict[str, list[tuple[int, bytes]]] = {}
        self._topics: dict[int, str] = {}
        self._url = f'ws://127.0.0.1:{port}'

    def seen(self, topics: list[str], times: int) -> bool:
        """Whether each of these was heard so often."""
        return all(len(self.heard.get(f'/{topic}', ())) >= times for topic in topics)

    def run(self) -> None:
        with connect(self._url, subprotocols=['foxglove.sdk.v1'], max_size=None) as server:
            for frame in server:
                if isinstance(frame, str):
                    self._control(server, json.loads(frame))
                elif frame[0] == 1:
                    _, number, stamp_ns = MESSAGE.unpack_from(frame)
                    self.heard[self._topics[number]].append((stamp_ns, frame[MESSAGE.size:]))

    def _control(self, server, message: dict) -> None:
        if message['op'] != 'advertise':
            return
        new = {channel['id']: channel for channel in message['channels']}
        new = {number: c for number, c in new.items() if number not in self._topics}
        self.channels |= {channel['topic']: channel for channel in new.values()}
        self._topics |= {number: channel['topic'] for number, channel in new.items()}
        self.heard |= {channel['topic']: [] for channel in new.values()}
        wanted = [{'id': number, 'channelId': number} for number in new]
        server.send(json.dumps({'op': 'subscribe', 'subscriptions': wanted}))


def test_given_a_client_that_looks_on_when_runs_go_then_it_sees_them_and_they_are_the_same(
    bag, short_request, tmp_path
):
    port = free_port()
    options = GraphOptions(perception='taxinet', out=tmp_path)
    results = []
    client = Client(port)
    drawn = (*interface.TRANSFORMS, *interface.SCENE)
    once = ['camera/image_raw', *(topic.name for topic in drawn)]

    still = ['scene/runway', 'tf_static']

    def asked():
        # Who looks on joins when a run has begun, and a run takes a tenth of a second: so runs go
        # on until there was something to see.
        yield short_request
        for number in itertools.count():
            if client.seen(once, 1) and client.seen(['scenario', *still], 2):
                return
            yield dataclasses.replace(short_request, run_id=f'again-{number}')

    with composed_graph(options) as graph, foxglove_view(port, graph.domain):
        client.start()
        graph.run(asked(), lambda _, result: results.append(result) or True)
    client.join()  # the server has hung up
    assert len(results) >= 2
    assert all(result.outcome.judged for result in results)

    assert {topic: c['schemaName'] for topic, c in client.channels.items()} == {
        topic: of.type_name for topic, of in TOPICS.items()
    }
    image = client.channels['/camera/image_raw']
    assert (image['encoding'], image['schemaEncoding']) == ('cdr', 'ros2msg')
    assert image['schema'] == message_definition('sensor_msgs/msg/Image')

    frames = {m.stamp_ns: m.cdr for m in read_messages(bag, ['/camera/image_raw'])}
    seen = client.heard['/camera/image_raw']
    assert seen
    assert {stamp_ns for stamp_ns, _ in seen} <= frames.keys()
    for stamp_ns, cdr in seen:
        # On its way a message is filled up to four bytes.
        assert cdr[: len(frames[stamp_ns])] == frames[stamp_ns]
    for topic in drawn:
        stamp_ns, cdr = client.heard['/' + topic.name][-1]
        assert deserialize_message(cdr, topic.type)
        assert stamp_ns <= 2_000_000_000
    began = [stamp_ns for stamp_ns, _ in client.heard['/scenario']]
    assert began[-2:] == [0, 0]
    for name in still:
        assert len(client.heard[f'/{name}']) >= 2, 'an app forgets it when time goes back'

    files = [{f.name: f.read_bytes() for f in folder.iterdir()} for folder in
             (bag, tmp_path / 'played')]
    assert files[0] == files[1], 'looking on has changed the bag'


def test_given_a_port_that_is_taken_then_one_line_says_so_and_nothing_is_begun(taxinet, tmp_path):
    with socket.socket() as other:
        other.bind(('127.0.0.1', 0))
        other.listen()
        port = other.getsockname()[1]
        with (
            own_domain() as domain, pytest.raises(UsageError, match='choose another one'),
            foxglove_view(port, domain),
        ):
            raise AssertionError('it should not have begun')
        assert taxinet('run', 'nominal', '--foxglove', port) == (
            2, '', f'taxinet: error: foxglove {port}: Address already in use; choose another '
            'port\n'
        )
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(UsageError, match='1 to 65535'):
        check_port(70_000)


def test_given_no_foxglove_sdk_then_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setattr(importlib.util, 'find_spec', lambda name: None)
    with pytest.raises(UsageError, match='pip install -c constraints'):
        check_port(8765)
