"""What peers, networks and people do to a run with X-Plane: one line with a kind for each."""

from __future__ import annotations

import contextlib
import json
import math
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler

import numpy as np
import pytest
from fake_xplane import FakeXPlane
from waiting import wait_for

from taxinet_ros.core.datarefs import checked_value
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.extras.xplane.camera import XPlaneCamera
from taxinet_ros.extras.xplane.connect import XPlaneConnect
from taxinet_ros.extras.xplane.native import NativeUdp, find_simulator
from taxinet_ros.extras.xplane.setup import XPlaneSetup
from taxinet_ros.extras.xplane.simulator import XPlane
from taxinet_ros.extras.xplane.web import WebApi
from taxinet_ros.extras.xplane.world import XPlaneWorld

RAIN = 'sim/weather/region/rain_percent'
CLOUDS = 'sim/weather/region/cloud_type'
NAME = 'sim/aircraft/view/acf_ui_name'
POSITION = 'sim/flightmodel/position/'
SCENE = scenario_from_human({'clouds': 'broken', 'rain_percent': 40, 'duration_s': 2})
AHEAD = TaxiCommand(steering_rad=0.0, speed_mps=5.0)
SHORT_S = 0.3

Handler = BaseHTTPRequestHandler


class FakeScreen:
    def __init__(self, sim: FakeXPlane) -> None:
        self.sim = sim

    def grab(self) -> np.ndarray:
        return self.sim.screen()

    def close(self) -> None:
        pass


@pytest.fixture
def sim() -> Iterator[FakeXPlane]:
    with FakeXPlane() as fake:
        yield fake


def web(sim: FakeXPlane, **more: float) -> WebApi:
    return sim.client(WebApi('127.0.0.1', sim.web_port, **{'timeout_s': 30.0, **more}))


def setup(sim: FakeXPlane, **more: object) -> XPlaneSetup:
    port = sim.connect_port if more.get('wire') == 'connect' else sim.web_port
    return XPlaneSetup(**{'port': port, 'settle_s': 0.1, 'timeout_s': 30.0, **more})


def camera(sim: FakeXPlane, **more: object) -> XPlaneCamera:
    return sim.client(XPlaneCamera(SCENE, setup(sim, **more), lambda *_: FakeScreen(sim)))


def world(sim: FakeXPlane) -> XPlaneWorld:
    return sim.client(XPlaneWorld(
        Scenario(duration_s=2.0), setup=setup(sim), open_screen=lambda *_: FakeScreen(sim)
    ))


def says(data: bytes) -> Callable[[Handler], bool]:
    """A fault: this answer in place of its own."""
    def fault(handler: Handler) -> bool:
        with contextlib.suppress(OSError):
            handler.wfile.write(data)
        handler.close_connection = True
        return True

    return fault


def http(body: bytes, status: bytes = b'200 OK', head: bytes = b'') -> bytes:
    return b'HTTP/1.1 %s\r\nContent-Length: %d\r\n%s\r\n%s' % (status, len(body), head, body)


def answers_of(sim: FakeXPlane, name: str, body: bytes) -> object:
    """What is read where a value is answered by a body."""
    link = web(sim)
    link.read(name)
    sim.http_fault = lambda handler: '/value' in handler.path and says(http(body))(handler)
    return link.read(name)


# What a web server may answer


@pytest.mark.parametrize(('answer', 'words'), [
    (http(b'<html>\n<body>Bad gateway</body>', b'502 Bad Gateway'), r'capabilities: 502'),
    (http(b'<html>\nhello</html>'), 'is answered by'),
    (http(b'', b'301 Moved', b'Location: http://127.0.0.1:1/\r\n'), 'capabilities: 301'),
    (http(b'', b'204 No Content'), 'capabilities: 204'),
    (http(json.dumps({'error_code': 'a\nb', 'error_message': '\x1b[31mred'}).encode(), b'500 X'),
     r'capabilities: 500 a\\nb \\x1b\[31mred'),
    (http(b'{"api": {"versions": "v1"}, "x-plane": {"version": "12"}}'), 'is answered by'),
    (http(b'{"api": {"versions": [{"a": 1}]}, "x-plane": {"version": "12"}}'), 'speaks v3, v2'),
    (http(b'[' * 100_000), 'is answered by'),
    (http(b'{"api": ' + b'9' * 5000 + b'}'), 'is answered by'),
    (b'HTTP/1.1 200 OK\r\nContent-Length: 9999999999\r\n\r\n' + b' ' * (5 << 20),
     'more than 4 MiB'),
    (b'HTTP/1.1 200 OK\r\n' + b''.join(b'X-%d: a\r\n' % one for one in range(300)) + b'\r\n',
     'no valid HTTP'),
    (b'HTTP/1.1 200 OK\r\nX: ' + b'a' * 100_000 + b'\r\n\r\n', 'LineTooLong'),
    (b'HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n', 'IncompleteRead'),
    (bytes(range(256)), 'BadStatusLine'),
], ids=[
    'error page', 'page', 'redirect', 'nothing', 'control characters', 'text for a list',
    'no versions', 'deep', 'long number', 'huge', 'many headers', 'long header', 'bad chunk',
    'binary',
])
def test_a_web_server_that_is_no_x_plane(sim, answer, words):
    sim.http_fault = says(answer)
    with pytest.raises(InfraError, match=f'^protocol: x-plane: .*{words}') as error:
        web(sim)
    assert str(error.value).isprintable()


@pytest.mark.parametrize('drops', [
    b'HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n', b'HTTP/1.1 200 OK\r\nX: ',
    b'HTTP/1.1 100 Continue\r\n\r\n',
], ids=['body', 'head', 'continue'])
def test_an_answer_that_comes_drop_by_drop_is_limited_in_all(sim, drops):
    free = threading.Event()

    def drip(handler: Handler) -> bool:
        with contextlib.suppress(OSError):
            handler.wfile.write(drops)
            while not free.wait(SHORT_S / 6):
                handler.wfile.write(drops if b'100' in drops else b' ')
        handler.close_connection = True
        return True

    sim.http_fault = drip
    try:
        with pytest.raises(InfraError, match=r'^timeout: x-plane: .* no answer after 1 request of'):
            web(sim, timeout_s=SHORT_S, tries=1)
    finally:
        free.set()


@pytest.mark.parametrize(('name', 'body'), [
    (RAIN, b'{"data": 1' + b'0' * 400 + b'}'), (RAIN, b'{"data": 1e999}'),
    (RAIN, b'{"data": true}'), (RAIN, b'{"data": null}'), (RAIN, b'{"data": "0.5"}'),
    (CLOUDS, b'{"data": [1, NaN, 3]}'), (CLOUDS, b'{"data": [1, 1' + b'0' * 400 + b', 3]}'),
    (CLOUDS, b'{"data": 1}'), (NAME, b'{"data": "###"}'), (NAME, '{"data": "ä"}'.encode()),
])
def test_a_value_that_is_none(sim, name, body):
    with pytest.raises(InfraError, match=rf'^protocol: x-plane: .*{name} \(\w+\) is answered by'):
        answers_of(sim, name, body)


@pytest.mark.parametrize('told', [
    {'id': -1}, {'id': '../../x'}, {'id': 10**400}, {'id': True}, {'value_type': ['float']},
    {'value_type': 'vec3'}, {'is_writable': 1},
])
def test_an_account_of_a_dataref_that_is_none(sim, told):
    link = web(sim)
    known = {'id': 1, 'name': RAIN, 'value_type': 'float', 'is_writable': True}
    sim.http_fault = says(http(json.dumps({'data': [{**known, **told}]}).encode()))
    with pytest.raises(InfraError, match=r'^protocol: x-plane: .*is answered by'):
        link.read(RAIN)


def test_a_server_that_ignores_what_it_is_asked_for(sim):
    link = web(sim)
    other = {'id': 1, 'name': 'sim/x/y', 'value_type': 'float', 'is_writable': True}
    sim.http_fault = says(http(json.dumps({'data': [other]}).encode()))
    with pytest.raises(InfraError, match='has no dataref sim/weather/region/rain_percent'):
        link.read(RAIN)


@pytest.mark.parametrize(('name', 'value'), [
    (RAIN, math.nan), (RAIN, 1e300), (CLOUDS, (1.0, math.inf, 0.0)),
    ('sim/time/sim_speed', math.inf), ('sim/time/sim_speed', 3e9),
])
def test_a_number_that_a_dataref_cannot_hold_is_not_sent(sim, name, value):
    links = (web(sim), sim.client(XPlaneConnect('127.0.0.1', sim.connect_port)),
             sim.client(NativeUdp('127.0.0.1', sim.native_port)))
    for link in links if value != 3e9 else links[:1]:
        with pytest.raises(InfraError, match=rf'^protocol: .*{name}.* cannot be'):
            link.write(name, value)
    if value != 3e9:
        with pytest.raises(UsageError, match='expected a finite number'):
            checked_value(name, value)


@pytest.mark.parametrize('host', ['no.such.host.invalid', '', 'a\nb', 'a\0b', 'a' * 80 + '.b'])
@pytest.mark.parametrize('client', [WebApi, XPlaneConnect, NativeUdp])
def test_a_host_that_is_none(client, host):
    with pytest.raises(UsageError, match=r'x-plane: host .* is unknown') as error:
        client(host, 1)
    assert str(error.value).isprintable()


def test_hosts_of_ipv6():
    for host in ('::1', '[::1]'):
        with contextlib.suppress(OSError), socket.socket(socket.AF_INET6) as one:
            one.bind(('::1', 0))
            with pytest.raises(InfraError, match=r'not_ready: x-plane: .*::1.*nothing listens'):
                WebApi(host, one.getsockname()[1])
    with pytest.raises(UsageError, match='has no IPv4 address, which UDP goes to'):
        XPlaneConnect('::1')


# Another session


def test_a_connection_that_breaks_and_comes_back_in_the_same_session_goes_on(sim):
    link = web(sim)
    assert link.read(RAIN, CLOUDS) == [0.0, (0.0, 0.0, 0.0)]
    link._connection.sock.shutdown(socket.SHUT_RDWR)
    assert link.read(RAIN, CLOUDS) == [0.0, (0.0, 0.0, 0.0)]
    assert not link._doubtful


def test_ids_that_mean_something_else_after_a_break_are_a_restart(sim):
    link = web(sim)
    link.read(RAIN)
    names = list(sim.values)
    at, other = names.index(RAIN), names.index('sim/weather/rain_percent')
    names[at], names[other] = names[other], names[at]  # both are numbers
    sim.values = {name: sim.values[name] for name in names}
    link._connection.sock.shutdown(socket.SHUT_RDWR)
    with pytest.raises(InfraError, match=r'^died: x-plane: .* another id since the connection'):
        link.read(RAIN)


def test_a_restart_that_keeps_the_ids(sim):
    made = camera(sim)
    sim.values['sim/time/total_running_time_sec'] = 0.0
    with pytest.raises(InfraError, match=r'^died: x-plane: X-Plane has been up for .* restarted'):
        made.render(Aircraft(SCENE).state, 0)


def test_a_version_that_is_none(sim):
    for version in ('twelve', '-1', '12\x1b[31m.x'):
        sim.version = version
        with pytest.raises(InfraError, match=r'^protocol: x-plane: .* is of no known version'):
            XPlane(setup(sim))
    sim.values['sim/version/xplane_internal_version'] = -1
    with pytest.raises(InfraError, match="X-Plane '-1' is of no known version"):
        XPlane(setup(sim, wire='connect'))


# Datagrams


@pytest.mark.parametrize('reply', [
    b'', b'RESP\0\1\1' + struct.pack('<f', math.inf), b'POSI\0\1\1' + bytes(4), b'x' * 20_000,
])
def test_a_datagram_of_the_plug_in_that_is_no_answer(sim, reply):
    link = sim.client(XPlaneConnect('127.0.0.1', sim.connect_port))
    sim.udp_fault = lambda packet: [reply]
    with pytest.raises(InfraError, match=r'^protocol: x-plane: XPlaneConnect: '):
        link.read(RAIN)


@pytest.mark.parametrize('place', [(1e300, 0.0), (0.0, -1e300), (math.nan, 0.0)])
def test_a_position_that_is_nowhere(sim, place):
    link = sim.client(XPlaneConnect('127.0.0.1', sim.connect_port))
    sim.udp_fault = lambda packet: [struct.pack('<4sxBdddffff', b'POSI', 1, *place, *[0.0] * 5)]
    with pytest.raises(InfraError, match=r'^protocol: x-plane: .* is not on Earth, or not finite'):
        link.position()


def test_values_of_another_subscription_are_none_of_ours(sim):
    link = sim.client(NativeUdp('127.0.0.1', sim.native_port))
    late = b'RREF,' + struct.pack('<if', 77, math.nan)
    sim.udp_fault = lambda packet: [late, packet]
    assert link.read(RAIN) == [0.0]
    sim.udp_fault = lambda packet: [late]
    link._timeout_s, link._tries = 0.05, 2
    with pytest.raises(InfraError, match=f'^timeout: x-plane: .*no value of {RAIN} after 2'):
        link.read(RAIN)


def test_a_port_of_beacons_that_another_program_holds():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(('', 0))
        with pytest.raises(InfraError, match=r'^not_ready: x-plane: no beacons can be received: .*'
                                             r'; name the host'):
            find_simulator(SHORT_S, port=other.getsockname()[1])


# During a run


def test_somebody_who_resumes_the_simulation(sim):
    made = camera(sim)
    sim.values['sim/time/sim_speed'] = 1
    with pytest.raises(InfraError, match=r'^sim: x-plane: its time went on by .* resume it'):
        made.render(Aircraft(SCENE).state, 0)


@pytest.mark.parametrize(('name', 'value'), [
    ('pilots_head_psi', 120.0), ('pilots_head_z', 3.0), ('field_of_view_deg', 20.0),
])
def test_somebody_who_looks_elsewhere(sim, name, value):
    made = camera(sim)
    sim.values[f'sim/graphics/view/{name}'] = value
    with pytest.raises(InfraError, match=r'^sim: x-plane: (the view is|.*field_of_view_deg is 20)'):
        made.render(Aircraft(SCENE).state, 0)


@pytest.mark.parametrize(('name', 'value', 'words'), [
    (RAIN, 0.0, f'{RAIN} is 0 after it was set to 0.4'),
    ('sim/time/zulu_time_sec', 3600.0, 'zulu_time_sec is 3600 after'),
    (NAME, b'Boeing 737\0', "the aircraft is 'Boeing 737', expected '208B'"),
])
def test_somebody_who_changes_weather_hour_or_aircraft(sim, name, value, words):
    made, state = camera(sim, aircraft='208B'), Aircraft(SCENE).state
    made.render(state, 0)
    sim.values[name] = value
    with pytest.raises(InfraError, match=f'^sim: x-plane: .*{words}'):
        # One more thing is looked at with each picture.
        list(map(made.render, [state] * 16, range(16)))


def test_a_window_smaller_than_the_picture(sim):
    sim.size = sim.values['sim/graphics/view/window_width'], 36
    sim.values['sim/graphics/view/window_width'] = 64
    sim.values['sim/graphics/view/window_height'] = 36
    with pytest.raises(UsageError, match=r'window of 64 x 36 .* camera wing; make it 379 x 213'):
        camera(sim)


def test_a_time_that_goes_back(sim):
    made = world(sim)
    made.advance(AHEAD)
    sim.values['sim/time/total_flight_time_sec'] -= 5.0
    with pytest.raises(InfraError, match=r'^sim: x-plane: its time went back from .* replay shown'):
        made.advance(AHEAD)


def test_a_time_that_jumps_ahead(sim):
    made = world(sim)
    sim.values['sim/time/total_flight_time_sec'] += 5.0
    with pytest.raises(InfraError, match=r'^timeout: x-plane: step 1 ended 4\.\d+ s of its time'):
        made.advance(AHEAD)


@pytest.mark.parametrize(('name', 'value'), [('groundspeed', 1e30), ('groundspeed', -3.0)])
def test_a_state_that_no_aircraft_has(sim, name, value):
    made, plain = world(sim), sim.derive

    def derive() -> None:
        plain()
        sim.values[POSITION + name] = value

    sim.derive = derive
    with pytest.raises(InfraError, match=r'^sim: x-plane: the aircraft is at .* no taxiing'):
        made.advance(AHEAD)


def test_two_runs_that_name_the_host_otherwise_take_turns(sim):
    first = XPlane(setup(sim))
    made: list[XPlane] = []
    waiting = threading.Thread(
        target=lambda: made.append(XPlane(setup(sim, host='localhost'))), daemon=True
    )
    waiting.start()
    waiting.join(SHORT_S)
    assert made == []
    first.close()
    wait_for(lambda: made)
    made[0].close()
    waiting.join()


def test_a_simulator_that_goes_wrong_while_it_is_given_back(sim):
    made = camera(sim)
    sim.http_fault = says(http(b'<html>'))
    made.close()
    sim.clients.clear()
    assert made._xplane.link._connection is None


def test_kinds_are_those_of_the_documents():
    assert {'timeout', 'not_ready', 'died', 'protocol', 'sim'} <= {str(one) for one in InfraKind}
