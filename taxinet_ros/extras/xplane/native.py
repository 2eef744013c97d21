"""X-Plane's own UDP interface: its beacon, reading (RREF), writing (DREF) and commands (CMND).

All values are 32-bit floats, so it cannot place an aircraft on a runway (a degree of latitude is
then known to a metre). It finds the simulator in the network, and executes commands where the web
API is too old to.

Source: "Exchanging Data with X-Plane", which X-Plane installs in ``Instructions``; layouts are
little-endian and without padding.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import socket
import struct
import time
from dataclasses import dataclass

from taxinet_ros.core.datarefs import split_name
from taxinet_ros.errors import InfraKind, UsageError
from taxinet_ros.extras.xplane.wire import UdpClient, Value, failed, floats

PORT = 49000
BEACON_GROUP, BEACON_PORT = '239.255.1.1', 49707

_BEACON = struct.Struct('<5sBBiiIH')
_READ = struct.Struct('<5sii400s')
_WRITE = struct.Struct('<5sf500s')
_PAIR = struct.Struct('<if')
_COMMAND_BYTES = 500
_X_PLANE = 1
"""Host id of X-Plane in beacons; 2 is PlaneMaker."""
_ROLES = {1: 'master', 2: 'external visual', 3: 'instructor station'}
_RATE_HZ = 100
"""Requested rate of a value, which is read once: the next frame will do."""
_PACKET_BYTES = 65535


@dataclass(frozen=True, kw_only=True, slots=True)
class Beacon:
    """A simulator that announces itself.

    Attributes:
        host: its address.
        port: of its UDP interface.
        version: of X-Plane as a number, such as 121400 for 12.1.4.
        role: what it is in a network of simulators.
        name: of its computer.
    """

    host: str
    port: int
    version: int
    role: str
    name: str


def parse_beacon(packet: bytes, host: str) -> Beacon | None:
    """Read a beacon; None for that of another program.

    Raises:
        ValueError: it is malformed.
    """
    if len(packet) < _BEACON.size + 1:
        raise ValueError(f'{len(packet)} bytes, expected more than {_BEACON.size}')
    tag, major, minor, program, version, role, port = _BEACON.unpack_from(packet)
    if tag != b'BECN\0':
        raise ValueError(f'begins with {tag!r}, expected BECN')
    if major != 1 or program != _X_PLANE:
        return None
    name, end, _ = packet[_BEACON.size:].partition(b'\0')
    if not end or port == 0 or version <= 0:
        raise ValueError(f'beacon {major}.{minor} with port {port}, version {version}')
    return Beacon(
        host=host, port=port, version=version, role=_ROLES.get(role, f'role {role}'),
        name=name.decode('utf-8', 'replace'),
    )


def find_simulator(
    timeout_s: float = 3.0, *, group: str = BEACON_GROUP, port: int = BEACON_PORT
) -> Beacon:
    """Wait for the beacon of a simulator in the local network; it sends one a second.

    Raises:
        InfraError: none came, or the group cannot be joined.
    """
    bad = ''
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((group, port))
            member = struct.pack('=4s4s', socket.inet_aton(group), socket.inet_aton('0.0.0.0'))
            listener.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        except OSError as error:
            raise failed(
                InfraKind.NOT_READY, f'no beacons can be received: {error.strerror}; name the host'
            ) from error
        until = time.monotonic() + timeout_s
        while (left := until - time.monotonic()) > 0:
            listener.settimeout(left)
            with contextlib.suppress(TimeoutError):
                packet, (host, _) = listener.recvfrom(_PACKET_BYTES)
                try:
                    found = parse_beacon(packet, host)
                except ValueError as error:
                    bad = f'; last packet from {host}: {error}'
                    continue
                if found:
                    return found
    raise failed(
        InfraKind.NOT_READY,
        f'no X-Plane announced itself on {group}:{port} in {timeout_s:g} s{bad}; start it, or name '
        'the host',
    )


class NativeUdp(UdpClient):
    """Client of one simulator's UDP interface."""

    def __init__(
        self, host: str, port: int = PORT, *, timeout_s: float = 1.0, tries: int = 3
    ) -> None:
        """Arguments and errors are those of :class:`.UdpClient`."""
        super().__init__('UDP', host, port, timeout_s=timeout_s, tries=tries)
        self._numbers = itertools.count(1)

    def read(self, *names: str) -> list[Value]:
        """Read values once, as 32-bit floats.

        Each reading has numbers of its own, so that late packets of earlier ones are recognised.

        Raises:
            InfraError: no answer in time; X-Plane does not tell unknown names from lost packets.
        """
        numbers = {next(self._numbers): name for name in names}
        values: dict[int, float] = {}
        try:
            for _ in range(self._tries):
                for number, name in numbers.items():
                    if number not in values:
                        self._subscribe(number, name, _RATE_HZ)
                self._receive(numbers, values)
                if len(values) == len(numbers):
                    return [values[number] for number in numbers]
        finally:
            for number, name in numbers.items():
                self._subscribe(number, name, 0)
        lost = ', '.join(name for number, name in numbers.items() if number not in values)
        raise failed(
            InfraKind.TIMEOUT,
            f'{self.words}: no value of {lost} after {self._tries} requests of '
            f'{self._timeout_s:g} s; is it running, and does it know the name?',
        )

    def _receive(self, wanted: dict[int, str], values: dict[int, float]) -> None:
        until = time.monotonic() + self._timeout_s
        while len(values) < len(wanted) and (left := until - time.monotonic()) > 0:
            self._socket.settimeout(left)
            try:
                packet, sender = self._socket.recvfrom(_PACKET_BYTES)
            except TimeoutError:
                return
            except ConnectionError:  # the port is closed: X-Plane may be about to open it
                continue
            if sender == self._address:
                for number, value in parse_values(packet):
                    if number not in wanted:  # late, of an earlier reading
                        continue
                    if not math.isfinite(value):
                        raise failed(
                            InfraKind.PROTOCOL, f'{self.words}: {wanted[number]} is {value}'
                        )
                    values[number] = value

    def _subscribe(self, number: int, name: str, rate_hz: int) -> None:
        split_name(name)
        self._send(_READ.pack(b'RREF\0', rate_hz, number, name.encode() + b'\0'))

    def write(self, name: str, value: float | tuple[float, ...]) -> None:
        """Set a dataref; arrays are written element by element, and nothing is confirmed."""
        path, index = split_name(name)
        values = floats(name, value)
        if isinstance(value, tuple) and index is not None:
            raise UsageError(f'x-plane: {name} is one element; got {len(value)} numbers')
        for at, number in enumerate(values):
            element = f'{path}[{at}]' if isinstance(value, tuple) else name
            self._send(_WRITE.pack(b'DREF\0', number, element.encode().ljust(500, b'\0')))

    def command(self, name: str) -> None:
        """Execute a command; nothing is confirmed."""
        split_name(name)
        self._send(b'CMND\0' + name.encode().ljust(_COMMAND_BYTES, b'\0'))

    def trouble(self, name: str) -> str:
        """Nothing: the interface does not tell."""
        return ''


def parse_values(packet: bytes) -> list[tuple[int, float]]:
    """Read an RREF packet: numbers of requests and their values.

    Raises:
        InfraError: it is malformed.
    """
    head, body = packet[:5], packet[5:]
    if head[:4] != b'RREF' or not body or len(body) % _PAIR.size:
        raise failed(
            InfraKind.PROTOCOL,
            f'UDP packet of {len(packet)} bytes beginning with {head!r}; expected RREF and pairs '
            f'of {_PAIR.size} bytes',
        )
    return list(_PAIR.iter_unpack(body))


