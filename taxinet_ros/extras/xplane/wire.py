"""What the clients of X-Plane's network interfaces have in common: values, failures, methods."""

from __future__ import annotations

import socket
from typing import Protocol

from taxinet_ros.core.datarefs import MOST_NUMBER
from taxinet_ros.errors import InfraError, InfraKind, UsageError

WHO = 'x-plane'
"""Who failed, in errors and records."""

Value = float | tuple[float, ...] | str
"""Value of a dataref: a number, an array of numbers, or the text of bytes."""


def failed(kind: InfraKind, detail: str) -> InfraError:
    """Create the error of a simulator that did not do its part."""
    return InfraError(kind, WHO, -1, detail)


def floats(name: str, value: float | tuple[float, ...]) -> tuple[float, ...]:
    """The numbers that are written to a dataref, as 32-bit floats hold them.

    Raises:
        InfraError: one is greater, or none.
    """
    values = value if isinstance(value, tuple) else (value,)
    if not all(abs(one) <= MOST_NUMBER for one in values):
        raise failed(InfraKind.PROTOCOL, f'{name} cannot be {value!r:.40} in 32 bits')
    return values


class Link(Protocol):
    """A way to read and write datarefs.

    Attributes:
        words: what it is and where, for messages.
        version: of X-Plane, as ``12.1.4``; '' where the interface does not tell.
    """

    words: str
    version: str

    def read(self, *names: str) -> list[Value]:
        """Current values, in this order.

        Raises:
            InfraError: no valid answer in time, or no such dataref.
        """
        ...

    def write(self, name: str, value: float | tuple[float, ...]) -> None:
        """Set a dataref, or one element of it: ``name[3]``.

        Raises:
            InfraError: it was refused. Interfaces over UDP confirm nothing: read it back.
        """
        ...

    def command(self, name: str) -> None:
        """Execute a command once.

        Raises:
            InfraError: it was refused, or the interface has no commands.
        """
        ...

    def trouble(self, name: str) -> str:
        """Why a dataref cannot be written, ''  if it can or the interface cannot tell."""
        ...

    def close(self) -> None:
        """Release sockets."""
        ...


class UdpClient:
    """Client of one simulator by UDP.

    Attributes:
        words: what it is and where, for messages.
        version: of X-Plane, which UDP does not tell: ''.
    """

    version = ''

    def __init__(
        self, name: str, host: str, port: int, *, timeout_s: float, tries: int
    ) -> None:
        """Look up the host and open a socket; nothing is sent yet.

        Args:
            name: of the interface, for messages.
            host: name or address of the simulator.
            port: of the interface.
            timeout_s: wait for each answer [s].
            tries: how often a question is sent.

        Raises:
            UsageError: unknown host.
        """
        self.words = f'{name} at {host}:{port}'
        try:
            self._address = socket.gethostbyname(host or 'no host'), port
        except (OSError, TypeError, ValueError) as error:
            v6 = ', or has no IPv4 address, which UDP goes to' if ':' in host else ''
            raise UsageError(f'x-plane: host {host!r:.80} is unknown{v6}') from error
        self._timeout_s, self._tries = timeout_s, tries
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send(self, packet: bytes) -> None:
        try:
            self._socket.sendto(packet, self._address)
        except OSError as error:
            raise failed(InfraKind.DIED, f'{self.words}: {error.strerror or error}') from error
