"""An independent stand-in for FlightGear's HTTP server, with a runway of its own.

It understands what our scripts set, and draws a sloping runway with three white lines by geometry
of its own, in earth-centred coordinates: what is set takes effect in the next frame, and it draws a
frame per request, as FlightGear does.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
from numpy.typing import NDArray

LATITUDE_DEG, LONGITUDE_DEG, LENGTH_M = 63.98504, -22.65499, 3065.0
HEIGHT_M, RISE = 30.0, 0.008
LINES_M = (-28.0, 0.0, 28.0)
_A_M, _FLATTENING = 6378137.0, 1 / 298.257223563
_E2 = _FLATTENING * (2 - _FLATTENING)
_PAIR = re.compile(r'\["(/[^"]+)", ("[^"]*"|[^\]]+)\]')
_POINT = re.compile(r'\[(-?[\d.]+), (-?[\d.]+)\]')

Vector = NDArray[np.float64]


def ecef(latitude_deg: float, longitude_deg: float, height_m: float) -> Vector:
    """Earth-centred position on WGS84."""
    sin, cos = math.sin(math.radians(latitude_deg)), math.cos(math.radians(latitude_deg))
    radius = _A_M / math.sqrt(1 - _E2 * sin * sin)
    longitude = math.radians(longitude_deg)
    return np.array([
        (radius + height_m) * cos * math.cos(longitude),
        (radius + height_m) * cos * math.sin(longitude), (radius * (1 - _E2) + height_m) * sin,
    ])


def compass(latitude_deg: float, longitude_deg: float) -> tuple[Vector, Vector, Vector]:
    """North, east and up at a point."""
    a, o = math.radians(latitude_deg), math.radians(longitude_deg)
    north = np.array([-math.sin(a) * math.cos(o), -math.sin(a) * math.sin(o), math.cos(a)])
    east = np.array([-math.sin(o), math.cos(o), 0.0])
    up = np.array([math.cos(a) * math.cos(o), math.cos(a) * math.sin(o), math.sin(a)])
    return north, east, up


class FlightGearPeer:
    """The state of the stand-in; tests change its attributes to make it fail."""

    def __init__(self, size_px: tuple[int, int] = (480, 288)) -> None:
        self.size_px = size_px
        self.frame, self.drawn, self.frozen = 0, 0, False
        self.flicker, self.lag, self.silent_s = False, 1, 0.0
        self.answers: dict[str, Callable[[], tuple[int, bytes]]] = {}
        """Answers in place of its own, by the beginning of a path."""
        self.runways = True
        self.terrain = True
        self.requests: list[str] = []
        self.stuck: set[str] = set()
        """Properties that cannot be set."""
        self.properties: dict[str, Any] = {
            '/sim/version/flightgear': '2020.3.16', '/sim/aircraft': 'ufo',
            '/sim/flight-model': 'external', '/sim/sceneryloaded': True,
            '/sim/rendering/gl-renderer': 'numpy', '/position/latitude-deg': LATITUDE_DEG,
            '/position/longitude-deg': LONGITUDE_DEG, '/position/altitude-ft': 200.0,
            '/orientation/heading-deg': 0.0, '/orientation/pitch-deg': 0.0,
            '/orientation/roll-deg': 0.0, '/sim/current-view/field-of-view': 55.0,
            '/environment/visibility-m': 5000.0, '/environment/clouds/layer[0]/coverage': 'few',
            '/environment/rain-norm': 0.0, '/sim/time/cur-time-override': 0,
            '/taxinet/request': 'none',
        }
        self.views = [dict(self.properties)]
        """What each frame so far was drawn of, oldest first."""
        self.north, self.east, self.up = compass(LATITUDE_DEG, LONGITUDE_DEG)
        self.origin = ecef(LATITUDE_DEG, LONGITUDE_DEG, HEIGHT_M)

    @property
    def shown(self) -> dict[str, Any]:
        """The properties that the newest frame shows."""
        return self.views[max(len(self.views) - 1 - self.lag, 0)]

    def step(self) -> None:
        """Draw a frame."""
        if not self.frozen:
            self.frame += 1
        self.views = [*self.views[-8:], dict(self.properties)]
        if '/hooked' in self.properties:
            self.properties['/taxinet/told'] = self.told()

    def told(self) -> str:
        """What our script in its frame loop would tell."""
        shown = self.shown
        at, (right, up, back) = self.eye(shown)
        turn = np.stack([right, up, back], axis=1)
        w = math.sqrt(max(1 + np.trace(turn), 1e-12)) / 2
        x, y, z = (
            (turn[(i + 2) % 3, (i + 1) % 3] - turn[(i + 1) % 3, (i + 2) % 3]) / (4 * w)
            for i in range(3)
        )
        moment = time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(
            int(shown['/sim/time/cur-time-override'])
        ))
        return (
            f'{shown["/taxinet/request"]} {self.frame} {at[0]:.4f} {at[1]:.4f} {at[2]:.4f} '
            f'{w:.6f} {x:.6f} {y:.6f} {z:.6f} {shown["/sim/current-view/field-of-view"]:.5f} '
            f'{moment} {shown.get("/sun", 0.9):.5f} {shown["/environment/visibility-m"]:.1f} '
            f'{shown["/environment/clouds/layer[0]/coverage"]} '
            f'{shown["/environment/rain-norm"]:.4f}'
        )

    def eye(self, shown: dict[str, Any]) -> tuple[Vector, tuple[Vector, Vector, Vector]]:
        """Position, and the directions right, up and back of a view."""
        latitude, longitude = shown['/position/latitude-deg'], shown['/position/longitude-deg']
        north, east, up = compass(latitude, longitude)
        heading, pitch, roll = (
            math.radians(shown[f'/orientation/{name}-deg']) for name in ('heading', 'pitch', 'roll')
        )
        level = math.cos(heading) * north + math.sin(heading) * east
        forward = math.cos(pitch) * level + math.sin(pitch) * up
        aside = math.cos(heading) * east - math.sin(heading) * north
        over = np.cross(aside, forward)
        right = math.cos(roll) * aside - math.sin(roll) * over
        at = ecef(latitude, longitude, shown['/position/altitude-ft'] * 0.3048)
        return at, (right, np.cross(right, forward), -forward)

    def picture(self) -> NDArray[np.uint8]:
        """Draw the runway: grey, with three white lines along it; all else is green or sky."""
        (width, height), shown = self.size_px, self.shown
        at, (right, up, back) = self.eye(shown)
        focal = width / 2 / math.tan(math.radians(shown['/sim/current-view/field-of-view']) / 2)
        rows, columns = np.mgrid[0:height, 0:width]
        rays = (
            ((columns + 0.5 - width / 2) / focal)[..., None] * right
            - ((rows + 0.5 - height / 2) / focal)[..., None] * up - back
        )
        slope = self.up - RISE * self.east  # normal of the sloping ground
        reach = -((at - self.origin) @ slope) / np.minimum(rays @ slope, -1e-9)
        ground = (at - self.origin) + reach[..., None] * rays
        aside = -(ground @ self.north)
        picture = np.full((height, width, 3), (60, 90, 40), np.uint8)
        picture[np.abs(aside) < 30.0] = 70
        # Edges are mixed by area, else lines along the columns would be off by half a pixel.
        wide = np.maximum(np.hypot(*np.gradient(aside)), 1e-9)
        for line in LINES_M:
            share = np.clip((0.8 - np.abs(aside + line)) / wide + 0.5, 0, 1)[..., None]
            picture = (picture + share * (240.0 - picture)).astype(np.uint8)
        picture[rays @ slope > -1e-3] = (120, 150, 220)
        if self.flicker:
            self.drawn += 1
            picture = picture + np.uint8(9 * (self.drawn % 2))
        return picture

    def run(self, script: str) -> None:
        """Do what one of our scripts means."""
        if 'taxinet_told' in script:
            self.properties['/hooked'] = 1
        elif 'airportinfo' in script:
            east_deg = LONGITUDE_DEG + math.degrees(
                LENGTH_M / (np.linalg.norm(ecef(LATITUDE_DEG, LONGITUDE_DEG, 0)[:2]))
            )
            self.properties['/taxinet/out'] = (
                f'10 {LATITUDE_DEG:.9f} {LONGITUDE_DEG:.9f};28 {LATITUDE_DEG:.9f} {east_deg:.9f};'
            ) if self.runways else ''
        elif 'geodinfo' in script:
            self.properties['/taxinet/out'] = ' '.join(
                self.height(float(latitude), float(longitude))
                for latitude, longitude in _POINT.findall(script)
            )
        else:
            pairs = _PAIR.findall(script)
            assert len(pairs) > 10, script
            for path, value in pairs:
                if path not in self.stuck:
                    self.properties[path] = json.loads(value)

    def height(self, latitude_deg: float, longitude_deg: float) -> str:
        """Height of the sloping plane above the ellipsoid."""
        if not self.terrain:
            return 'inf'
        normal = self.up - RISE * self.east
        below = (self.origin - ecef(latitude_deg, longitude_deg, 0.0)) @ normal
        return f'{below / (compass(latitude_deg, longitude_deg)[2] @ normal):.4f}'

    def answer(self, method: str, path: str, body: bytes) -> tuple[int, bytes]:
        """Status and content for a request."""
        self.requests.append(path)
        if self.silent_s:
            time.sleep(self.silent_s)
        self.step()
        for begin, other in self.answers.items():
            if path.startswith(begin):
                return other()
        if method == 'POST' and path == '/run.cgi?value=nasal':
            [script] = [one['value'] for one in json.loads(body)['children']]
            self.run(script)
            return 200, b'ok.'
        if path.startswith('/json/'):
            value = self.properties.get(path.removeprefix('/json'))
            return 200, json.dumps({'path': path, 'value': value}).encode()
        if path == '/screenshot?type=ppm':
            picture = self.picture()
            head = f'P6\n{picture.shape[1]} {picture.shape[0]}\n255\n'
            return 200, head.encode() + picture.tobytes()
        return 404, b'not found'


@contextlib.contextmanager
def serving(peer: FlightGearPeer) -> Iterator[tuple[str, int]]:
    """Context in which the stand-in answers; gives its address."""
    class Handler(BaseHTTPRequestHandler):
        protocol_version = 'HTTP/1.1'

        def _answer(self) -> None:
            body = self.rfile.read(int(self.headers.get('Content-Length', 0)))
            try:
                status, content = peer.answer(self.command, self.path, body)
            except ConnectionAbortedError:
                self.close_connection = True
                return
            with contextlib.suppress(ConnectionError):  # nobody waits any more
                self.send_response(status)
                self.send_header('Content-Length', str(len(content)))
                self.end_headers()
                self.wfile.write(content)

        do_GET = do_POST = _answer  # noqa: N815 - the names that http.server calls

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(('127.0.0.1', 0), Handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield ('127.0.0.1', server.server_address[1])
        finally:
            server.shutdown()
            thread.join()
