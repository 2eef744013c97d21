"""What a peer in FlightGear's place may answer: one line with a kind for each."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator

import pytest

from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.renderer import ChosenRenderer, find_renderer
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.extras.flightgear import camera as flightgear_camera
from taxinet_ros.extras.flightgear import client
from taxinet_ros.extras.flightgear.scene import weather_of
from tests.extras.flightgear.flightgear_peer import FlightGearPeer, serving

SCENE = Scenario(place='bikf_10', time_of_day_s=13 * 3600.0, cross_track_m=2.0, distance_m=600.0)
STATE = Aircraft(SCENE).state
VERSION = '/json/sim/version'
PICTURE = '/screenshot'


@pytest.fixture
def peer(monkeypatch: pytest.MonkeyPatch) -> Iterator[FlightGearPeer]:
    peer = FlightGearPeer()
    peer.properties['/sun'] = weather_of(SCENE).sun_angle_rad
    monkeypatch.setattr(flightgear_camera, '_POLLS', 12)
    monkeypatch.setattr(flightgear_camera, '_GROUNDS', {})
    with serving(peer) as (host, port):
        monkeypatch.setenv(client.ADDRESS, f'{host}:{port}')
        yield peer
        flightgear_camera._connection((host, port)).close()


@pytest.fixture
def renderer() -> ChosenRenderer:
    found = find_renderer('flightgear')
    assert found is not None
    return found


@pytest.mark.parametrize(('path', 'status', 'body', 'said'), [
    (VERSION, 200, b'<html>', 'does not answer like FlightGear'),
    (VERSION, 200, b'[1]', 'does not answer like FlightGear'),
    (VERSION, 200, b'[' * 100_000, 'does not answer like FlightGear'),
    (VERSION, 200, b'{"value": ' + b'9' * 5000 + b'}', 'does not answer like FlightGear'),
    (VERSION, 200, b'{"value": {"a": 1}}', "is FlightGear {'a': 1}; known is 2020.3"),
    (VERSION, 302, b'', 'answered 302'),
    ('/json/sim/aircraft', 200, b'{"value": "\\u001b[31m\\nx"}', r'has the aircraft \\x1b\[31m\\n'),
    (PICTURE, 200, b'P6\n0 0\n255\n', 'no whole picture'),
    (PICTURE, 200, b'P6\n0 288\n255\n', 'no whole picture'),
    (PICTURE, 200, b'P6\n' + b'9' * 5000 + b' 1\n255\n', 'no whole picture'),
    (PICTURE, 200, b'P6\n9 9\n65535\n' + bytes(486), 'no whole picture'),
], ids=['page', 'list', 'deep', 'long', 'version', 'redirect', 'escapes', 'no pixels', 'no width',
        'digits', 'two bytes'])
def test_an_answer_that_is_none_at_the_start(
    path: str, status: int, body: bytes, said: str, peer: FlightGearPeer, renderer: ChosenRenderer
) -> None:
    peer.answers[path] = lambda: (status, body)
    with pytest.raises(InfraError, match=f'^protocol: .*{said}') as error:
        renderer.make(SCENE)
    assert str(error.value).isprintable()


def told(text: str) -> Callable[[FlightGearPeer], None]:
    """What its frame loop tells from now on."""
    def change(peer: FlightGearPeer) -> None:
        peer.answers['/json/taxinet/told'] = lambda: (200, b'{"value": %s}' % text.encode())

    return change


def pictures(body: bytes) -> Callable[[FlightGearPeer], None]:
    def change(peer: FlightGearPeer) -> None:
        peer.answers[PICTURE] = lambda: (200, body)

    return change


@pytest.mark.parametrize(('change', 'said'), [
    (told('"r 5 nan nan nan nan nan nan nan nan x nan nan few nan"'), '^sim: .*does not take up'),
    (told('[1, 2]'), '^protocol: .*its frame loop told'),
    (told('null'), "^protocol: .*its frame loop told 'None'"),
    (told('"r ' + '9' * 5000 + ' 1 1 1 1 1 1 1 1 x 1 1 few 1"'), '^protocol: .*frame loop told'),
    (told('"\\u001b[31m"'), '^protocol: .*its frame loop told'),
    (pictures(b'P6\n480 288\n255\n' + bytes(480 * 288 * 3)), '^sim: .*its picture has one colour'),
    (pictures(b'P6\n0 0\n255\n'), '^protocol: .*no whole picture'),
], ids=['numbers that are none', 'list', 'restarted', 'digits', 'escapes', 'black', 'no pixels'])
def test_an_answer_that_is_none_during_a_run(
    change: Callable[[FlightGearPeer], None], said: str, peer: FlightGearPeer,
    renderer: ChosenRenderer,
) -> None:
    camera = renderer.make(SCENE)
    change(peer)
    with pytest.raises(InfraError, match=said) as error:
        camera.render(STATE, 100_000_000)
    assert error.value.step == 1
    assert str(error.value).isprintable()


@pytest.mark.parametrize(('out', 'said'), [
    ('10 a b;28 c d;', 'its runways are'), ('10 nan nan;28 1 2;', 'its runways are'),
    ('10 1;28 2;', 'its runways are'),
])
def test_runways_that_are_none(
    out: str, said: str, peer: FlightGearPeer, renderer: ChosenRenderer,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain = peer.run

    def run(script: str) -> None:
        plain(script)
        peer.properties['/taxinet/out'] = out

    monkeypatch.setattr(peer, 'run', run)
    with pytest.raises(InfraError, match=f'^protocol: .*{said}'):
        renderer.make(SCENE)


@pytest.mark.parametrize(('height', 'kind', 'said'), [
    ('x', InfraError, '^protocol: .*ground heights'), ('', InfraError, '^protocol: .*0 ground hei'),
    ('nan', UsageError, 'has no terrain'),
])
def test_heights_that_are_none(
    height: str, kind: type[Exception], said: str, peer: FlightGearPeer, renderer: ChosenRenderer,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(peer, 'height', lambda *_: height)
    with pytest.raises(kind, match=said):
        renderer.make(SCENE)


def test_an_answer_that_comes_drop_by_drop_is_limited_in_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(client, '_ANSWER_S', 0.3)
    free = threading.Event()
    with socket.create_server(('127.0.0.1', 0)) as server:
        def drip() -> None:
            there, _ = server.accept()
            with there, contextlib.suppress(OSError):
                there.sendall(b'HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n')
                while not free.wait(0.05):
                    there.sendall(b' ')

        thread = threading.Thread(target=drip)
        thread.start()
        flightgear = client.FlightGear(server.getsockname())
        try:
            with pytest.raises(InfraError, match=r'^timeout: .* has not answered for 0.3 s'):
                flightgear.value('/sim/aircraft')
        finally:
            free.set()
            thread.join()
            flightgear.close()
