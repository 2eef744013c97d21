"""The clients of X-Plane's three network interfaces, against a fake one and its misbehaviour."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import closing

import pytest
from fake_xplane import FakeXPlane
from waiting import wait_for

from taxinet_ros.core.datarefs import checked_value, split_name
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.extras.xplane import native
from taxinet_ros.extras.xplane.connect import Position, XPlaneConnect, parse_rows
from taxinet_ros.extras.xplane.native import NativeUdp, find_simulator, parse_beacon
from taxinet_ros.extras.xplane.web import WebApi

RAIN = 'sim/weather/region/rain_percent'
CLOUDS = 'sim/weather/region/cloud_type'
SHORT_S = 0.05


@pytest.fixture
def sim() -> Iterator[FakeXPlane]:
    with FakeXPlane() as fake:
        yield fake


def udp(sim: FakeXPlane, **more: float) -> NativeUdp:
    return sim.client(NativeUdp('127.0.0.1', sim.native_port, **{'timeout_s': 30.0, **more}))


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


@pytest.mark.parametrize('make', [udp, plugin, web])
def test_what_is_written_is_read(sim, make):
    link = make(sim)
    link.write(RAIN, 0.25)
    link.write(f'{CLOUDS}[1]', 2.0)
    assert link.read(RAIN, f'{CLOUDS}[1]', f'{CLOUDS}[0]') == [0.25, 2.0, 0.0]
    assert sim.values[CLOUDS] == [0.0, 2.0, 0.0]


@pytest.mark.parametrize('make', [udp, plugin, web])
def test_names_of_x_plane_11_that_end_in_an_index_are_names(sim, make):
    link = make(sim)
    link.write('sim/weather/cloud_type[0]', 4.0)
    assert link.read('sim/weather/cloud_type[0]') == [4.0]
    assert sim.values['sim/weather/cloud_type[0]'] == 4


@pytest.mark.parametrize('make', [plugin, web])
def test_whole_arrays_are_read_and_written(sim, make):
    link = make(sim)
    link.write(CLOUDS, (1.0, 2.0, 3.0))
    assert link.read(CLOUDS) == [(1.0, 2.0, 3.0)]


@pytest.mark.parametrize('make', [udp, plugin, web])
def test_a_command_is_executed_once(sim, make):
    link = make(sim)
    link.command('sim/operation/regen_weather')
    link.read(RAIN)
    assert sim.commands == ['sim/operation/regen_weather']


@pytest.mark.parametrize('make', [udp, plugin])
def test_a_lost_packet_is_asked_for_again(sim, make):
    sim.values[RAIN] = 0.5
    lost = iter([True, False])
    sim.udp_fault = lambda packet: [] if next(lost, False) else [packet]
    assert make(sim, timeout_s=SHORT_S, tries=100).read(RAIN) == [0.5]


@pytest.mark.parametrize('make', [udp, plugin])
def test_a_repeated_packet_answers_no_later_question(sim, make):
    sim.udp_fault = lambda packet: [packet] * 3
    link = make(sim)
    assert link.read(RAIN) == [0.0]
    link.write(RAIN, 1.0)
    assert [link.read(RAIN), link.read(RAIN)] == [[1.0], [1.0]]


@pytest.mark.parametrize('make', [udp, plugin])
def test_a_late_packet_answers_no_later_question(sim, make):
    kept: list[bytes] = []

    def late(packet: bytes) -> list[bytes]:
        kept.append(packet)
        # It comes before the answer to the next question, where it has a way to.
        return [] if len(kept) == 1 else [kept[0], packet] if make is udp else [packet]

    link = make(sim, timeout_s=SHORT_S, tries=1)
    sim.udp_fault = late
    with pytest.raises(InfraError):
        link.read(RAIN)
    sim.values[RAIN] = 0.75
    link._timeout_s = 30.0
    assert link.read(RAIN) == [0.75]


def test_values_that_come_in_another_order_and_one_by_one(sim):
    held: list[bytes] = []

    def turned(packet: bytes) -> list[bytes]:
        held.append(packet)
        return held[::-1] if len(held) == 3 else []

    sim.udp_fault = turned
    sim.values[RAIN], sim.values[CLOUDS] = 0.5, [1.0, 2.0, 3.0]
    assert udp(sim).read(RAIN, f'{CLOUDS}[1]', f'{CLOUDS}[2]') == [0.5, 2.0, 3.0]


@pytest.mark.parametrize('make', [udp, plugin])
@pytest.mark.parametrize('cut', [1, 4, 6, 9])
def test_a_truncated_packet_is_no_value(sim, make, cut):
    sim.udp_fault = lambda packet: [packet[:cut]]
    with pytest.raises(InfraError) as error:
        make(sim).read(RAIN)
    assert error.value.kind == InfraKind.PROTOCOL
    assert '\n' not in str(error.value)


@pytest.mark.parametrize('make', [udp, plugin])
def test_a_number_that_is_none_is_refused(sim, make):
    sim.values[RAIN] = float('nan')
    with pytest.raises(InfraError, match=r'protocol: x-plane: .*nan'):
        make(sim).read(RAIN)


def test_who_never_answers_is_named_with_what_was_asked():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(('127.0.0.1', 0))
        port = silent.getsockname()[1]
        for link, words in (
            (NativeUdp('127.0.0.1', port, timeout_s=SHORT_S, tries=2), f'no value of {RAIN}'),
            (XPlaneConnect('127.0.0.1', port, timeout_s=SHORT_S, tries=2), 'no answer to GETD'),
        ):
            with closing(link), pytest.raises(
                InfraError, match=f'timeout: x-plane: .*{port}: {words} after 2'
            ):
                link.read(RAIN)


@pytest.mark.parametrize('client', [NativeUdp, XPlaneConnect])
def test_a_closed_port_is_silence_too(client):
    link = client('127.0.0.1', closed_port(socket.SOCK_DGRAM), timeout_s=SHORT_S, tries=2)
    with closing(link), pytest.raises(InfraError, match='timeout: x-plane'):
        link.read(RAIN)


def test_packets_of_strangers_are_ignored(sim):
    link = udp(sim)
    link.read(RAIN)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        port = link._socket.getsockname()[1]
        stranger.sendto(b'RREF,' + struct.pack('<if', 2, 9.0), ('127.0.0.1', port))
    assert link.read(RAIN) == [0.0]


def test_reading_leaves_no_subscription_behind(sim):
    udp(sim).read(RAIN)
    plugin(sim).read(RAIN)
    wait_for(lambda: len(sim.requests) == 2)
    assert sim.requests == [f'RREF 100 {RAIN}', f'RREF 0 {RAIN}']


def test_the_plug_in_places_an_aircraft_to_the_centimetre(sim):
    link = plugin(sim)
    there = Position(latitude_deg=47.2, longitude_deg=-119.33, altitude_m=365.5, pitch_deg=1.0,
                     roll_deg=-2.0, heading_deg=54.0)
    link.place(there)
    link.read(RAIN)
    now = link.position()
    assert now.latitude_deg == pytest.approx(there.latitude_deg, abs=1e-9)
    assert now.longitude_deg == pytest.approx(there.longitude_deg, abs=1e-9)
    assert now.altitude_m == pytest.approx(there.altitude_m, abs=1e-3)
    assert (now.pitch_deg, now.roll_deg) == (1.0, -2.0)
    assert now.heading_deg == pytest.approx(54.0, abs=1e-5)


def test_the_plug_in_holds_aircraft_and_moves_controls(sim):
    link = plugin(sim)
    link.hold(True)
    link.control(rudder=0.5, throttle=0.25)
    link.read(RAIN)
    assert sim.values['sim/operation/override/override_planepath'] == [1] * 20
    assert sim.requests == ['CTRL (0.5, 0.25)']


def test_an_older_plug_in_tells_positions_to_a_metre_and_is_refused(sim):
    sim.udp_fault = lambda packet: [packet[:34]]
    with pytest.raises(InfraError, match=r'34 bytes .* expected POSI in 46 bytes, as of plug-in 1'):
        plugin(sim).position()


def test_the_plug_in_names_what_it_does_not_know(sim):
    with pytest.raises(InfraError, match=r'protocol: x-plane: .* no value of sim/no/such'):
        plugin(sim).read('sim/no/such')


@pytest.mark.parametrize('reply', [b'', b'RESP', b'RESP\0\1', b'RESP\0\1\2' + bytes(4),
                                   b'RESP\0\1\1' + bytes(5), b'RESP\0\2\1' + bytes(4)])
def test_replies_to_getd_are_whole(reply):
    with pytest.raises(InfraError, match='protocol'):
        parse_rows(reply, 1)


def test_the_beacon_of_the_description(sim):
    found = parse_beacon(sim.beacon(), '10.0.0.7')
    assert (found.host, found.port, found.version) == ('10.0.0.7', sim.native_port, 121400)
    assert (found.role, found.name) == ('master', 'hangar')


def test_beacons_of_other_programs_are_not_x_plane(sim):
    assert parse_beacon(sim.beacon(host=2), '10.0.0.7') is None


@pytest.mark.parametrize('packet', [b'', b'BECN', b'BECN\0' + bytes(16), b'XXXX\0' + bytes(30)])
def test_malformed_beacons_are_refused(packet):
    with pytest.raises(ValueError, match=r'bytes|expected|beacon'):
        parse_beacon(packet, '10.0.0.7')


def test_a_simulator_is_found_by_its_beacon(sim):
    port = closed_port(socket.SOCK_DGRAM)
    done = threading.Event()

    def announce() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            while not done.wait(0.01):
                for packet in (b'BECN\0short', sim.beacon()):
                    one.sendto(packet, (native.BEACON_GROUP, port))

    thread = threading.Thread(target=announce)
    thread.start()
    try:
        assert find_simulator(60.0, port=port).version == 121400
    except InfraError as error:
        if 'cannot be received' in str(error) or 'no X-Plane announced' in str(error):
            pytest.skip('this machine has no multicast')
        raise
    finally:
        done.set()
        thread.join()


def test_without_a_beacon_one_line(sim):
    with pytest.raises(InfraError, match=r'not_ready: x-plane: no .*beacons|announced itself'):
        find_simulator(SHORT_S, port=closed_port(socket.SOCK_DGRAM))


# The web API


@pytest.mark.parametrize(('versions', 'api', 'version'), [
    (('v1',), 'v1', '12.1.1'), (('v1', 'v2'), 'v2', '12.1.4'),
    (('v1', 'v2', 'v3'), 'v3', '12.4.0'), (('v2', 'v9'), 'v2', '12.1.1'),
])
def test_the_best_version_that_both_speak(versions, api, version):
    with FakeXPlane(versions=versions) as sim:
        link = web(sim)
        assert (link.api, link.version) == (api, version)
        assert link.read(RAIN) == [0.0]


def test_no_common_version():
    with FakeXPlane(versions=('v7',)) as sim, pytest.raises(
        InfraError, match=r"protocol: .* offers the versions \['v7'\]; the client speaks v3, v2, v1"
    ):
        web(sim)


def test_version_1_has_no_commands_and_version_2_no_flights():
    with FakeXPlane(versions=('v1',)) as sim, pytest.raises(InfraError, match='need API v2'):
        web(sim).command('sim/operation/regen_weather')
    with FakeXPlane(versions=('v1', 'v2')) as sim, pytest.raises(InfraError, match='need API v3'):
        web(sim).update_flight({})


def test_flights_are_sent_in_an_envelope(sim):
    link = web(sim)
    link.update_flight({'local_time': {'day_of_year': 79, 'time_in_24_hours': 12.5}})
    link.start_flight({'aircraft': {'path': 'Aircraft/C208.acf'}})
    assert sim.flights == [
        ('PATCH', {'data': {'local_time': {'day_of_year': 79, 'time_in_24_hours': 12.5}}}),
        ('POST', {'data': {'aircraft': {'path': 'Aircraft/C208.acf'}}}),
    ]


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


def test_ids_of_another_session_are_a_restart(sim):
    link = web(sim)
    link.read(RAIN)
    sim.restart()
    with pytest.raises(InfraError, match=r'died: x-plane: .* restarted during the run'):
        link.read(RAIN)
    assert web(sim).read(RAIN) == [0.0]


def test_a_simulator_that_is_gone(sim):
    with pytest.raises(InfraError, match=r'not_ready: x-plane: .*nothing listens there'):
        WebApi('127.0.0.1', closed_port())
    link = web(sim, tries=2)
    link.read(RAIN)
    link.close()
    sim.close_web()
    with pytest.raises(InfraError, match='died: x-plane'):
        link.read(RAIN)


def test_a_closed_connection_is_opened_again(sim):
    def gone(handler: object) -> bool:
        handler.close_connection = True
        sim.http_fault = lambda handler: False
        return True

    link = web(sim)
    sim.http_fault = gone
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
    link.read(RAIN)
    link.close()
    link._timeout_s = SHORT_S
    free = threading.Event()

    def hang(handler: object) -> bool:
        free.wait()
        return True

    sim.http_fault = hang
    try:
        with pytest.raises(InfraError, match=r'timeout: x-plane: .* no answer after 2 requests'):
            link.read(RAIN)
    finally:
        free.set()


@pytest.mark.parametrize(('answer', 'words'), [
    (b'HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\n{"da', 'IncompleteRead'),
    (b'HTTP/1.1 200 OK\r\nContent-Length: 3\r\n\r\n{"d', 'is answered by'),
    (b'HTTP/1.1 200 OK\r\nContent-Length: 13\r\n\r\n{"data":"x"}\n', 'is answered by'),
    (b'HTTP/1.1 200 OK\r\nContent-Length: 12\r\n\r\n{"data":NaN}', 'is answered by'),
    (b'SSH-2.0-OpenSSH\r\n\r\n', 'BadStatusLine'),
])
def test_malformed_answers(sim, answer, words):
    link = web(sim)
    link.read(RAIN)

    def say(handler: object) -> bool:
        handler.wfile.write(answer)
        handler.close_connection = True
        return True

    sim.http_fault = say
    with pytest.raises(InfraError, match=f'protocol: x-plane: .*{words}'):
        link.read(RAIN)


@pytest.mark.parametrize('name', ['rain', '', 'sim//rain', 'sim/rain[x]', 'sim/a b', 'sim/ä/b',
                                  f'sim/{"x" * 300}', 'sim/rain\n'])
def test_what_is_no_name(name):
    with pytest.raises(UsageError, match='is no name of a dataref'):
        split_name(name)


@pytest.mark.parametrize(
    'value', ['1', float('nan'), float('inf'), [], [1, 'x'], None, [0.0] * 999]
)
def test_what_is_no_value(value):
    with pytest.raises(UsageError, match='expected a finite number'):
        checked_value('sim/a', value)


def test_an_unknown_host():
    for client in (NativeUdp, XPlaneConnect):
        with pytest.raises(UsageError, match='is unknown'):
            client('no such host')
    with pytest.raises((InfraError, UsageError)):
        WebApi('no such host', 80)


def test_a_whole_reading_takes_no_longer_than_its_limits():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(('127.0.0.1', 0))
        link = NativeUdp('127.0.0.1', silent.getsockname()[1], timeout_s=SHORT_S, tries=3)
        began = time.monotonic()
        with closing(link), pytest.raises(InfraError):
            link.read(RAIN)
        assert time.monotonic() - began >= 3 * SHORT_S
