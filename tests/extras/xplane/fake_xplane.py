"""A fake X-Plane for tests: its two network interfaces, a little physics, and a screen.

Written after the published descriptions of the interfaces, not after our clients. One request is
one frame of the simulator, so nothing depends on the clock of the machine.
"""

from __future__ import annotations

import base64
import contextlib
import json
import math
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import pymap3d

from taxinet_ros.extras.xplane.setup import XPlaneSetup

FRAME_S = 1 / 60
REF = 47.25, -119.45
"""Latitude and longitude of the origin of local coordinates [deg]."""
TERRAIN_M = 361.7

INTS = (
    'sim/time/paused', 'sim/time/sim_speed', 'sim/time/use_system_time', 'sim/time/local_date_days',
    'sim/weather/region/change_mode', 'sim/weather/region/update_immediately',
    'sim/graphics/view/window_width', 'sim/graphics/view/window_height',
    'sim/weather/cloud_type[0]', 'sim/weather/cloud_type[1]', 'sim/weather/cloud_type[2]',
    'sim/weather/use_real_weather_bool', 'sim/operation/override/override_wheel_steer',
    'sim/operation/override/override_throttles', 'sim/version/xplane_internal_version',
)
READ_ONLY = (
    'sim/time/paused', 'sim/flightmodel/position/latitude', 'sim/flightmodel/position/longitude',
    'sim/flightmodel/position/elevation', 'sim/flightmodel/position/y_agl',
    'sim/flightmodel/position/true_psi', 'sim/flightmodel/position/groundspeed',
    'sim/graphics/view/window_width', 'sim/graphics/view/window_height',
    'sim/time/total_running_time_sec', 'sim/time/total_flight_time_sec',
    'sim/aircraft/view/acf_ui_name', 'sim/weather/region/weather_source',
)
COMMANDS = (
    'sim/none/none', 'sim/operation/regen_weather', 'sim/operation/fix_all_systems',
    'sim/view/forward_with_nothing',
)


def turned(heading: float, pitch: float, roll: float) -> np.ndarray:
    """Rotation matrix from a turned frame, axes ahead, right, down [deg]."""
    (ch, sh), (cp, sp), (cr, sr) = (
        (math.cos(math.radians(one)), math.sin(math.radians(one))) for one in (heading, pitch, roll)
    )
    return (
        np.array([[ch, -sh, 0], [sh, ch, 0], [0, 0, 1]])
        @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    )


class FakeXPlane:
    """One simulator; ``with FakeXPlane() as sim``."""

    def __init__(self, *, versions: tuple[str, ...] = ('v1', 'v2', 'v3')) -> None:
        self.versions = versions
        self.version = {'v3': '12.4.0', 'v2': '12.1.4'}.get(max(versions, default=''), '12.1.1')
        self.first_id = 2**40
        self.lock = threading.RLock()
        self.requests: list[str] = []
        self.commands: list[str] = []
        self.clients: list[Any] = []
        self.refuse_traffic = False
        self.udp_fault: Callable[[bytes], list[bytes]] = lambda packet: [packet]
        self.http_fault: Callable[[BaseHTTPRequestHandler], bool] = lambda handler: False
        self.frozen_screen = False
        self.size = 1280, 720
        self.view_off = 0.0, 0.0, 0.0
        self.up_while_paused = True
        self.values: dict[str, Any] = dict.fromkeys(INTS, 0)
        self.values.update({
            'sim/time/sim_speed': 1, 'sim/version/xplane_internal_version': 120400,
            'sim/time/total_running_time_sec': 100.0, 'sim/time/total_flight_time_sec': 10.0,
            'sim/time/zulu_time_sec': 0.0, 'sim/time/framerate_period': FRAME_S,
            'sim/flightmodel/position/local_x': 0.0, 'sim/flightmodel/position/local_y': TERRAIN_M,
            'sim/flightmodel/position/local_z': 0.0, 'sim/flightmodel/position/psi': 0.0,
            'sim/flightmodel/position/theta': 0.0, 'sim/flightmodel/position/phi': 0.0,
            'sim/flightmodel/position/q': [1.0, 0.0, 0.0, 0.0],
            'sim/flightmodel/position/local_vx': 0.0, 'sim/flightmodel/position/local_vy': 0.0,
            'sim/flightmodel/position/local_vz': 0.0, 'sim/flightmodel/position/R': 0.0,
            'sim/flightmodel/position/P': 0.0, 'sim/flightmodel/position/Q': 0.0,
            'sim/flightmodel/position/groundspeed': 0.0,
            'sim/operation/override/override_planepath': [0] * 20,
            'sim/flightmodel2/gear/tire_steer_command_deg': [0.0] * 10,
            'sim/cockpit2/engine/actuators/throttle_ratio_all': 0.0,
            'sim/cockpit2/controls/parking_brake_ratio': 0.0,
            'sim/weather/rain_percent': 0.0, 'sim/weather/region/rain_percent': 0.0,
            'sim/weather/region/variability_pct': 0.0, 'sim/weather/region/runway_friction': 0.0,
            'sim/weather/region/cloud_type': [0.0] * 3,
            'sim/weather/region/cloud_coverage_percent': [0.0] * 3,
            'sim/weather/region/cloud_base_msl_m': [0.0] * 3,
            'sim/weather/region/cloud_tops_msl_m': [0.0] * 3,
            'sim/weather/region/wind_speed_msc': [0.0] * 13,
            'sim/weather/region/wind_direction_degt': [0.0] * 13,
            'sim/weather/region/visibility_reported_sm': 20.0,
            'sim/weather/wind_speed_kt[0]': 0.0, 'sim/weather/wind_direction_degt[0]': 0.0,
            'sim/graphics/view/pilots_head_x': 0.0, 'sim/graphics/view/pilots_head_y': 0.0,
            'sim/graphics/view/pilots_head_z': 0.0, 'sim/graphics/view/pilots_head_psi': 0.0,
            'sim/graphics/view/pilots_head_the': 0.0, 'sim/graphics/view/pilots_head_phi': 0.0,
            'sim/graphics/view/field_of_view_deg': 60.0,
            'sim/graphics/view/window_width': 1280, 'sim/graphics/view/window_height': 720,
            'sim/aircraft/view/acf_ui_name': b'Cessna 208B Grand Caravan\0\0\0',
        })
        self.derive()
        self.shown = self.pose()

    # What happens in it

    def pose(self) -> tuple[float, ...]:
        position = 'sim/flightmodel/position/'
        return tuple(
            self.values[position + name]
            for name in ('local_x', 'local_y', 'local_z', 'psi', 'theta', 'phi')
        )

    def derive(self) -> None:
        """What follows from local coordinates, a frame after they were written."""
        position = 'sim/flightmodel/position/'
        x, y, z, psi, _, _ = self.pose()
        latitude, longitude, height = pymap3d.enu2geodetic(x, -z, y, *REF, 0.0)
        bend = (longitude - REF[1]) * math.sin(math.radians(latitude))
        self.values.update({
            position + 'latitude': float(latitude), position + 'longitude': float(longitude),
            position + 'elevation': float(height), position + 'y_agl': float(height) - TERRAIN_M,
            position + 'true_psi': (psi + bend) % 360,
        })
        speed = math.hypot(*(self.values[f'{position}local_v{axis}'] for axis in 'xz'))
        self.values[position + 'groundspeed'] = speed
        self.look()

    def look(self) -> None:
        """Where the view is: turns about down, right and ahead, in axes ahead, right, down."""
        x, y, z, psi, theta, phi = self.pose()
        head = [self.values[f'sim/graphics/view/pilots_head_{one}'] for one in
                ('x', 'y', 'z', 'psi', 'the', 'phi')]
        body = turned(psi, theta, phi)
        right, up, back = head[:3]
        north, east, down = body @ np.array([-back, right, -up]) + np.array(self.view_off)
        view = body @ turned(*head[3:])
        told = {
            'x': x + east, 'y': y - down, 'z': z - north,
            'heading': math.degrees(math.atan2(view[1, 0], view[0, 0])) % 360,
            'pitch': math.degrees(math.asin(-view[2, 0])),
            'roll': math.degrees(math.atan2(view[2, 1], view[2, 2])),
        }
        self.values.update({f'sim/graphics/view/view_{key}': one for key, one in told.items()})

    def frame(self) -> None:
        """One frame; time of the simulation stands still while it is paused."""
        with self.lock:
            value = self.values
            value['sim/time/paused'] = int(value['sim/time/sim_speed'] == 0)
            if self.up_while_paused or not value['sim/time/paused']:
                value['sim/time/total_running_time_sec'] += FRAME_S
            value['sim/time/framerate_period'] = FRAME_S * (1.5 - value['sim/time/paused'])
            value['sim/time/framerate_period'] += 1e-4 * (len(self.requests) % 7)
            if not value['sim/time/paused']:
                value['sim/time/total_flight_time_sec'] += FRAME_S
                if not value['sim/operation/override/override_planepath'][0]:
                    self.roll()
            self.derive()
            if not self.frozen_screen:
                self.shown = self.pose()

    def roll(self) -> None:
        """A bicycle on level ground."""
        position, value = 'sim/flightmodel/position/', self.values
        speed = value[position + 'groundspeed']
        push = value['sim/cockpit2/engine/actuators/throttle_ratio_all'] * 4
        drag = 0.1 * speed + 5 * value['sim/cockpit2/controls/parking_brake_ratio']
        speed = max(0.0, speed + (push - drag) * FRAME_S)
        steer = value['sim/flightmodel2/gear/tire_steer_command_deg'][0]
        rate = math.degrees(speed / 4 * math.tan(math.radians(steer)))
        value[position + 'R'] = rate
        value[position + 'psi'] = (value[position + 'psi'] + rate * FRAME_S) % 360
        heading = math.radians(value[position + 'psi'])
        value[position + 'local_vx'] = speed * math.sin(heading)
        value[position + 'local_vz'] = -speed * math.cos(heading)
        for axis in 'xz':
            value[f'{position}local_{axis}'] += value[f'{position}local_v{axis}'] * FRAME_S

    def restart(self) -> None:
        """Another session: other ids, and open connections end."""
        with self.lock:
            self.first_id += 10**9
            for name in ('total_running_time_sec', 'total_flight_time_sec'):
                self.values[f'sim/time/{name}'] = 0.0

    def screen(self) -> np.ndarray:
        """A picture that depends on where the aircraft is, (height, width, 3) uint8."""
        with self.lock:
            seed = abs(hash(tuple(round(one, 3) for one in self.shown))) % 2**32
        width, height = self.size
        small = np.random.default_rng(seed).integers(0, 256, (9, 16, 3), np.uint8)
        return small.repeat(-(-height // 9), 0)[:height].repeat(-(-width // 16), 1)[:, :width]

    def set(self, name: str, value: Any, index: int | None = None) -> None:
        with self.lock:
            if name in READ_ONLY or name not in self.values:
                return
            if index is not None:
                self.values[name][index] = value
            elif name in INTS:
                self.values[name] = int(value)
            else:
                self.values[name] = value

    # Interfaces

    def __enter__(self) -> FakeXPlane:
        self.connect = self._udp()
        fake = self

        class Handler(_Handler):
            sim = fake

        class Server(ThreadingHTTPServer):
            daemon_threads = True

        self.server = Server(('127.0.0.1', 0), Handler)
        self.web_port = self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()
        self.connect_port = self.connect.getsockname()[1]
        return self

    def client(self, one: Any) -> Any:
        """Keep a client, to be closed in the end."""
        self.clients.append(one)
        return one

    def __exit__(self, *_: object) -> None:
        for client in self.clients:
            client.close()
        self.close_web()
        with contextlib.suppress(OSError):
            self.connect.shutdown(socket.SHUT_RDWR)
        self.connect.close()

    def close_web(self) -> None:
        self.server.shutdown()
        self.server.server_close()

    def _udp(self) -> socket.socket:
        one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        one.bind(('127.0.0.1', 0))

        def serve() -> None:
            while True:
                try:
                    packet, sender = one.recvfrom(4096)
                except OSError:
                    return
                if not packet:
                    return
                with self.lock:
                    self.frame()
                    replies = [
                        made for reply in self._answer(packet) for made in self.udp_fault(reply)
                    ]
                with contextlib.suppress(OSError):  # closed meanwhile
                    for reply in replies:
                        one.sendto(reply, sender)

        threading.Thread(target=serve, daemon=True).start()
        return one

    def _answer(self, packet: bytes) -> Iterator[bytes]:
        tag, body = packet[:4], packet[5:]
        if tag == b'GETD':
            yield self._rows(body)
        elif tag == b'DREF':
            name = body[1:1 + body[0]].decode()
            row = struct.unpack_from(f'<{body[1 + body[0]]}f', body, 2 + body[0])
            array = isinstance(self.values.get(name), list)
            for index, value in enumerate(row):
                self.set(name, value, index if array else None)
        elif tag == b'GETP':
            position = 'sim/flightmodel/position/'
            told = [self.values[position + name] for name in
                    ('latitude', 'longitude', 'elevation', 'theta', 'phi', 'true_psi')]
            yield struct.pack('<4sxBdddffff', b'POSI', 1, *told, 1.0)
        elif tag == b'COMM':
            self.commands.append(body[1:1 + body[0]].decode())

    def _rows(self, body: bytes) -> bytes:
        reply, at = b'RESP\0' + body[:1], 1
        for _ in range(body[0]):
            name = body[at + 1:at + 1 + body[at]].decode()
            at += 1 + body[at]
            value = self.values.get(name, [])
            row = [*value] if isinstance(value, list | bytes) else [value]
            reply += struct.pack(f'<B{len(row)}f', len(row), *row)
        return reply


class _Handler(BaseHTTPRequestHandler):
    """The web API over one connection."""

    sim: FakeXPlane
    protocol_version = 'HTTP/1.1'
    disable_nagle_algorithm = True

    def log_message(self, *_: Any) -> None:
        pass

    def do_GET(self) -> None:
        self.serve('GET')

    def do_PATCH(self) -> None:
        self.serve('PATCH')

    def do_POST(self) -> None:
        self.serve('POST')

    def setup(self) -> None:
        super().setup()
        self.session = self.sim.first_id

    def serve(self, method: str) -> None:
        length = int(self.headers.get('Content-Length') or 0)
        body = json.loads(self.rfile.read(length)) if length else None
        if self.session != self.sim.first_id:
            self.close_connection = True
            return
        if self.sim.http_fault(self):
            return
        with self.sim.lock:
            self.sim.frame()
            self.sim.requests.append(f'{method} {self.path}')
            status, told = self.answer(method, body)
        self.reply(status, told)

    def reply(self, status: int, told: Any) -> None:
        data = json.dumps(told).encode()
        self.send_response(status)
        self.send_header('Content-Type', 'application/json')
        self.send_header('Content-Length', str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def answer(self, method: str, body: Any) -> tuple[int, Any]:
        sim, url = self.sim, urlsplit(self.path)
        if sim.refuse_traffic:
            return 403, {'error_code': 'forbidden', 'error_message': 'Incoming traffic disabled'}
        parts = url.path.strip('/').split('/')
        if parts == ['api', 'capabilities'] and sim.versions != ('v1',):
            return 200, {
                'api': {'versions': list(sim.versions)}, 'x-plane': {'version': sim.version}
            }
        if len(parts) < 3 or parts[0] != 'api' or parts[1] not in sim.versions:
            return 404, {'error_code': 'not_found', 'error_message': 'no such path'}
        match (method, *parts[2:]):
            case 'GET', 'datarefs':
                return self.listed([value for key, value in parse_qsl(url.query)
                                    if key == 'filter[name]'])
            case method, 'datarefs', ident, 'value':
                return self.value(method, int(ident), dict(parse_qsl(url.query)), body)
            case 'GET', 'commands' if parts[1] != 'v1':
                names = [value for key, value in parse_qsl(url.query) if key == 'filter[name]']
                return 200, {'data': [
                    {'id': COMMANDS.index(name), 'name': name, 'description': ''}
                    for name in names if name in COMMANDS
                ]}
            case 'POST', 'command', ident, 'activate':
                sim.commands.append(COMMANDS[int(ident)])
                return 200, None
        return 404, {'error_code': 'not_found', 'error_message': 'no such path'}

    def listed(self, names: list[str]) -> tuple[int, Any]:
        sim = self.sim
        if any(name not in sim.values for name in names):
            return 404, {'error_code': 'invalid_dataref_name', 'error_message': 'no such dataref'}
        known = list(sim.values)
        return 200, {'data': [
            {
                'id': sim.first_id + known.index(name), 'name': name, 'value_type': self.kind(name),
                'is_writable': name not in READ_ONLY,
            } for name in names or known
        ]}

    def kind(self, name: str) -> str:
        value = self.sim.values[name]
        if isinstance(value, bytes):
            return 'data'
        if isinstance(value, list):
            return 'int_array' if isinstance(value[0], int) else 'float_array'
        if name in INTS:
            return 'int'
        return 'double' if name.startswith('sim/flightmodel/position/l') else 'float'

    def value(
        self, method: str, ident: int, query: dict[str, str], body: Any
    ) -> tuple[int, Any]:
        sim = self.sim
        known = list(sim.values)
        if not 0 <= ident - sim.first_id < len(known):
            return 404, {'error_code': 'invalid_dataref_id', 'error_message': 'no such dataref'}
        name = known[ident - sim.first_id]
        value = sim.values[name]
        if method == 'GET':
            text = base64.b64encode(value).decode() if isinstance(value, bytes) else value
            return 200, {'data': text}
        if name in READ_ONLY:
            return 403, {'error_code': 'dataref_is_readonly', 'error_message': 'read-only'}
        if 'index' in query:
            if not isinstance(value, list):
                return 400, {'error_code': 'not_an_array', 'error_message': 'not an array'}
            if not 0 <= int(query['index']) < len(value):
                return 400, {'error_code': 'index_out_of_range', 'error_message': 'out of range'}
            sim.set(name, body['data'], int(query['index']))
        elif isinstance(value, list) is not isinstance(body['data'], list):
            return 400, {'error_code': 'incompatible_data', 'error_message': 'incompatible'}
        else:
            sim.set(name, body['data'])
        return 200, None


class FakeScreen:
    """The screen of a fake X-Plane."""

    def __init__(self, sim: FakeXPlane) -> None:
        self.sim = sim

    def grab(self) -> np.ndarray:
        return self.sim.screen()

    def close(self) -> None:
        pass


def setup_of(sim: FakeXPlane, **more: Any) -> XPlaneSetup:
    """The setup with which a fake X-Plane is used."""
    port = sim.connect_port if more.get('wire') == 'connect' else sim.web_port
    return XPlaneSetup(**{'port': port, 'settle_s': 0.1, 'timeout_s': 30.0, **more})
