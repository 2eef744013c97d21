"""Client of NASA's plug-in XPlaneConnect 1.3, for X-Plane 11 and for 12 where it is installed.

UDP, little-endian; a message is a tag of four letters, a padding byte, and its fields. Replies
carry no number, so every question has a socket of its own: a late or repeated reply to an earlier
one cannot be taken for its answer.

Source: the plug-in's documented messages (github.com/nasa/XPlaneConnect, Network Information).
"""

from __future__ import annotations

import math
import socket
import struct
from collections.abc import Callable, Sequence
from typing import TypeVar

from taxinet_ros.core.datarefs import split_name
from taxinet_ros.errors import InfraError, InfraKind
from taxinet_ros.extras.xplane.wire import Value, address_of, failed

PORT = 49009
_POSITION = struct.Struct('<4sxBdddffff')
_REPLY_BYTES = 16384
_MOST_NAMES = 16
_T = TypeVar('_T')


class XPlaneConnect:
    """Client of the plug-in in one simulator, with the methods of the web API's.

    All methods raise InfraError where there is no valid answer in time.

    Attributes:
        words: what it is and where, for messages.
        version: of X-Plane, which the plug-in does not tell: ''.
    """

    version = ''

    def __init__(
        self, host: str, port: int = PORT, *, timeout_s: float = 1.0, tries: int = 3
    ) -> None:
        """Look up the host (UsageError if unknown) and open a socket; nothing is sent yet."""
        self.words = f'XPlaneConnect at {host}:{port}'
        self._address = address_of(host), port
        self._timeout_s, self._tries = timeout_s, tries
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def read(self, *names: str) -> list[Value]:
        """Read datarefs as 32-bit floats (GETD)."""
        found: list[Value] = []
        for at in range(0, len(names), _MOST_NAMES):
            found += self._read(names[at:at + _MOST_NAMES])
        return found

    def _read(self, names: Sequence[str]) -> list[Value]:
        values: list[Value] = []
        for name, row in zip(names, self._rows(*names), strict=True):
            path, index = split_name(name)
            if not row and index is not None:  # the plug-in knows whole arrays only
                row = self._rows(path)[0][index:index + 1]
            if not row:
                raise failed(InfraKind.PROTOCOL, f'{self.words}: no value of {name}; does this '
                             'version of X-Plane have it?')
            values.append(row[0] if len(row) == 1 else row)
        return values

    def _rows(self, *names: str) -> list[tuple[float, ...]]:
        return self._ask(
            b'GETD\0' + bytes([len(names)]) + b''.join(_counted(name) for name in names),
            lambda reply: parse_rows(reply, len(names)),
        )

    def write(self, name: str, value: float | tuple[float, ...]) -> None:
        """Set a dataref (DREF); nothing is confirmed.

        One element of an array is written with all the others, as they are read just before: the
        plug-in knows whole arrays, besides X-Plane 11's datarefs whose names end in an index.
        """
        path, index = split_name(name)
        values = value if isinstance(value, tuple) else (value,)
        if index is not None and not self._rows(name)[0]:
            array = list(self._rows(path)[0])
            if isinstance(value, tuple) or index >= len(array):
                raise failed(
                    InfraKind.PROTOCOL, f'{self.words}: {path} has {len(array)} elements; '
                    f'{name} cannot be {value!r:.40}'
                )
            array[index] = value
            name, values = path, tuple(array)
        self._send(
            b'DREF\0' + _counted(name) + struct.pack(f'<B{len(values)}f', len(values), *values)
        )

    def command(self, name: str) -> None:
        """Execute a command (COMM); nothing is confirmed."""
        self._send(b'COMM\0' + _counted(name))

    def trouble(self, name: str) -> str:
        """Nothing: the plug-in does not tell."""
        return ''

    def position(self) -> tuple[float, ...]:
        """Latitude, longitude, pitch, roll and true heading of the user's aircraft (GETP) [deg]."""
        return self._ask(b'GETP\0\0', parse_position)

    def _send(self, packet: bytes) -> None:
        try:
            self._socket.sendto(packet, self._address)
        except OSError as error:
            raise failed(InfraKind.DIED, f'{self.words}: {error.strerror or error}') from error

    def _ask(self, question: bytes, parse: Callable[[bytes], _T]) -> _T:
        for _ in range(self._tries):  # packets get lost
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
                asking.settimeout(self._timeout_s)
                try:
                    asking.connect(self._address)
                    asking.send(question)
                    return parse(asking.recv(_REPLY_BYTES))
                except (TimeoutError, ConnectionError):
                    continue
                except OSError as error:
                    text = error.strerror or str(error)
                    raise failed(InfraKind.DIED, f'{self.words}: {text}') from error
        raise failed(
            InfraKind.TIMEOUT,
            f'{self.words}: no answer to {question[:4].decode()} after {self._tries} requests of '
            f'{self._timeout_s:g} s; is X-Plane running, with the plug-in?',
        )


def parse_rows(reply: bytes, count: int) -> list[tuple[float, ...]]:
    """Read the reply to GETD, ``RESP``: one row of values for each name; empty if it is unknown."""
    rows, at = [], 6
    try:
        given = reply[5] if reply[:4] == b'RESP' else -1
        for _ in range(count):
            rows.append(struct.unpack_from(f'<{reply[at]}f', reply, at + 1))
            at += 1 + 4 * reply[at]
    except (IndexError, struct.error):
        given = -1
    if given != count:
        raise _malformed(reply, f'RESP with {count} whole rows')
    if not all(math.isfinite(one) for row in rows for one in row):
        raise failed(InfraKind.PROTOCOL, f'XPlaneConnect: values {rows!r:.80} are not finite')
    return rows


def parse_position(reply: bytes) -> tuple[float, ...]:
    """Read the reply to GETP, ``POSI``; its first field is the gear handle, not the aircraft."""
    if len(reply) != _POSITION.size or reply[:4] != b'POSI':
        # 34 bytes: plug-ins before 1.3 tell latitude as a float, to a metre.
        raise _malformed(reply, f'POSI in {_POSITION.size} bytes, as of plug-in 1.3')
    _, _, latitude, longitude, _, pitch, roll, heading, _ = _POSITION.unpack(reply)
    return latitude, longitude, pitch, roll, heading


def _counted(name: str) -> bytes:
    split_name(name)
    return bytes([len(name)]) + name.encode()


def _malformed(reply: bytes, what: str) -> InfraError:
    return failed(
        InfraKind.PROTOCOL,
        f'XPlaneConnect: {len(reply)} bytes beginning with {reply[:4]!r}; expected {what}',
    )
