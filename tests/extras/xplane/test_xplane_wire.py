"""The clients of X-Plane's two interfaces, against a fake one that is well, dead, slow or wrong."""

from __future__ import annotations

import socket
import threading
from contextlib import closing

import pytest
from fake_xplane import FakeXPlane

from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.extras.xplane.connect import XPlaneConnect, parse_rows
from taxinet_ros.extras.xplane.web import WebApi

RAIN = 'sim/weather/region/rain_percent'
CLOUDS = 'sim/weather/region/cloud_type'
SHORT_S = 0.05


def plugin(sim: FakeXPlane, **more: float) -> XPlaneConnect:
    return sim.client(
        XPlaneConnect('127.0.0.1', sim.connect_port, **{'timeout_s': 30.0, **more})
    )


def web(sim: FakeXPlane, **more: float) -> WebApi:
    return sim.client(WebApi('127.0.0.1', sim.web_port, **{'timeout_s': 30.0, **more}))


def closed_port(kind: int = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(('127.0.0.1', 0))
        return one.getsockname()[1]


both = pytest.mark.parametrize('make', [plugin, web])


@both
def test_what_is_written_is_read(sim, make):
    link = make(sim)
    link.write(RAIN, 0.25)
    link.write(f'{CLOUDS}[1]', 2.0)
    assert link.read(RAIN, f'{CLOUDS}[1]', f'{CLOUDS}[0]') == [0.25, 2.0, 0.0]
    assert sim.values[CLOUDS] == [0.0, 2.0, 0.0]
    link.write(CLOUDS, (1.0, 2.0, 3.0))
    assert link.read(CLOUDS) == [(1.0, 2.0, 3.0)]


@both
def test_names_of_x_plane_11_that_end_in_an_index_are_names(sim, make):
    link = make(sim)
    link.write('sim/weather/cloud_type[0]', 4.0)
    assert link.read('sim/weather/cloud_type[0]') == [4.0]
    assert sim.values['sim/weather/cloud_type[0]'] == 4


@both
def test_a_command_is_executed_once(sim, make):
    link = make(sim)
    link.command('sim/operation/regen_weather')
    link.read(RAIN)
    assert sim.commands == ['sim/operation/regen_weather']


@both
def test_an_unknown_host(make):
    client = {plugin: XPlaneConnect, web: WebApi}[make]
    for host in ('no such host', '', 'a\0b'):
        with pytest.raises(UsageError, match=r'x-plane: host .* is unknown'):
            client(host)


@both
def test_a_number_that_is_none_is_refused(sim, make):
    sim.values[RAIN] = float('nan')
    with pytest.raises(InfraError, match=r'(?i)^protocol: x-plane: .*nan'):
        make(sim).read(RAIN)


# The plug-in


def test_a_lost_packet_is_asked_for_again(sim):
    sim.values[RAIN] = 0.5
    lost = iter([True, False])
    sim.udp_fault = lambda packet: [] if next(lost, False) else [packet]
    assert plugin(sim, timeout_s=SHORT_S, tries=100).read(RAIN) == [0.5]


def test_a_repeated_packet_answers_no_later_question(sim):
    sim.udp_fault = lambda packet: [packet] * 3
    link = plugin(sim)
    assert link.read(RAIN) == [0.0]
    link.write(RAIN, 1.0)
    assert [link.read(RAIN), link.read(RAIN)] == [[1.0], [1.0]]


def test_a_plug_in_that_never_answers():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(('127.0.0.1', 0))
        for port in (silent.getsockname()[1], closed_port(socket.SOCK_DGRAM)):
            link = XPlaneConnect('127.0.0.1', port, timeout_s=SHORT_S, tries=2)
            with closing(link), pytest.raises(
                InfraError, match=f'^timeout: x-plane: .*{port}: no answer to GETD after 2'
            ):
                link.read(RAIN)


def test_the_plug_in_tells_where_the_aircraft_is_to_the_centimetre(sim):
    sim.values.update({f'sim/flightmodel/position/local_{axis}': 5432.1 for axis in 'xz'})
    sim.frame()
    latitude, longitude, _, _, heading = plugin(sim).position()
    for name, value, within in (
        ('latitude', latitude, 1e-9), ('longitude', longitude, 1e-9), ('true_psi', heading, 1e-5)
    ):
        assert value == pytest.approx(sim.values[f'sim/flightmodel/position/{name}'], abs=within)


def test_an_older_plug_in_tells_positions_to_a_metre_and_is_refused(sim):
    sim.udp_fault = lambda packet: [packet[:34]]
    with pytest.raises(InfraError, match=r'34 bytes .* expected POSI in 46 bytes, as of plug-in 1'):
        plugin(sim).position()


def test_the_plug_in_names_what_it_does_not_know(sim):
    with pytest.raises(InfraError, match=r'protocol: x-plane: .* no value of sim/no/such'):
        plugin(sim).read('sim/no/such')


@pytest.mark.parametrize('reply', [b'', b'RESP', b'RESP\0\1', b'RESP\0\1\2' + bytes(4),
                                   b'RESP\0\2\1' + bytes(4), b'POSI\0\1\1' + bytes(4)])
def test_replies_to_getd_are_whole(reply):
    with pytest.raises(InfraError, match=r'^protocol: x-plane: XPlaneConnect: .* 1 whole rows'):
        parse_rows(reply, 1)


# The web API


@pytest.mark.parametrize(('versions', 'version'), [
    (('v1', 'v2'), '12.1.4'), (('v1', 'v2', 'v3'), '12.4.0'),
])
def test_the_best_version_that_both_speak(versions, version):
    with FakeXPlane(versions=versions) as sim:
        link = web(sim)
        assert (link.words.split()[2], link.version) == (versions[-1], version)
        assert link.read(RAIN) == [0.0]


@pytest.mark.parametrize(('versions', 'words'), [
    (('v7',), r"offers the versions \['v7'\]; the client speaks v3, v2"),
    (('v1',), r'no /api/capabilities; X-Plane 12\.1\.4 or newer is needed'),
])
def test_no_common_version(versions, words):
    with FakeXPlane(versions=versions) as sim, pytest.raises(
        InfraError, match=f'^protocol: x-plane: .*{words}'
    ):
        web(sim)


def test_text_is_decoded(sim):
    assert web(sim).read('sim/aircraft/view/acf_ui_name') == ['Cessna 208B Grand Caravan']


def test_what_cannot_be_written_is_told_beforehand(sim):
    link = web(sim)
    assert link.trouble(RAIN) == ''
    assert 'read-only' in link.trouble('sim/time/paused')
    assert 'has no dataref sim/no/such' in link.trouble('sim/no/such')
    assert 'no array' in link.trouble(f'{RAIN}[0]')
    with pytest.raises(InfraError, match='sim/time/paused is read-only'):
        link.write('sim/time/paused', 1.0)


@pytest.mark.parametrize(('name', 'value', 'words'), [
    (f'{CLOUDS}[9]', 1.0, 'index_out_of_range'), (RAIN, (1.0, 2.0), 'incompatible_data'),
])
def test_refusals_are_told_in_the_words_of_the_api(sim, name, value, words):
    with pytest.raises(InfraError, match=f'protocol: x-plane: .*{words}'):
        web(sim).write(name, value)


def test_traffic_that_is_disabled(sim):
    sim.refuse_traffic = True
    with pytest.raises(InfraError, match=r'not_ready: x-plane: .* allow incoming traffic'):
        web(sim)


def test_a_simulator_that_is_gone(sim):
    with pytest.raises(InfraError, match=r'not_ready: x-plane: .*nothing listens there'):
        WebApi('127.0.0.1', closed_port())
    link = web(sim, tries=2)
    link.read(RAIN)
    link.close()
    sim.close_web()
    with pytest.raises(InfraError, match='died: x-plane'):
        link.read(RAIN)


def test_a_closed_connection_is_opened_again_and_ids_are_asked_for_anew(sim):
    link = web(sim)
    assert link.read(RAIN) == [0.0]
    sim.restart()
    link.write(RAIN, 0.5)
    assert link.read(RAIN) == [0.5]


def test_a_command_is_never_sent_twice(sim):
    link = web(sim)
    asked: list[str] = []

    def gone(handler: object) -> bool:
        if handler.command == 'POST':
            asked.append(handler.path)
            handler.close_connection = True
            return True
        return False

    sim.http_fault = gone
    with pytest.raises(InfraError, match=r'died: x-plane: .* after 1 request'):
        link.command('sim/operation/regen_weather')
    assert len(asked) == 1


def test_a_web_server_that_hangs(sim):
    link = web(sim, tries=2)
    link.close()
    link._connection.timeout = link._timeout_s = SHORT_S
    free = threading.Event()
    sim.http_fault = lambda handler: free.wait()
    try:
        with pytest.raises(InfraError, match=r'timeout: x-plane: .* no answer after 2 requests'):
            link.read(RAIN)
    finally:
        free.set()


@pytest.mark.parametrize(('answer', 'words'), [
    (b'HTTP/1.1 200 OK\r\nContent-Length: 3\r\n\r\n{"d', 'is answered by'),
    (b'HTTP/1.1 200 OK\r\nContent-Length: 15\r\n\r\n<html>Hi</html>', 'is answered by'),
    (b'HTTP/1.1 200 OK\r\nContent-Length: 12\r\n\r\n{"data":NaN}', 'is answered by'),
    (b'HTTP/1.1 502 Bad\r\nContent-Length: 0\r\n\r\n', r'value: 502'),
    (b'SSH-2.0-OpenSSH\r\n\r\n', 'BadStatusLine'),
], ids=['cut', 'page', 'nan', 'error', 'not http'])
def test_malformed_answers(sim, answer, words):
    link = web(sim)
    link.read(RAIN)

    def say(handler: object) -> bool:
        if '/value' in handler.path or answer[:4] != b'HTTP':
            handler.wfile.write(answer)
            handler.close_connection = True
            return True
        return False

    sim.http_fault = say
    with pytest.raises(InfraError, match=f'^protocol: x-plane: .*{words}') as error:
        link.read(RAIN)
    assert error.value.kind == InfraKind.PROTOCOL
    assert '\n' not in str(error.value)
