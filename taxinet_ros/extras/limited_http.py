"""HTTP connections to simulators on which an answer has one limit in all.

The timeout of a socket begins anew with every byte: a peer that sends one now and then would be
waited for without end.
"""

from __future__ import annotations

import http.client
import math
import socket
import time
from typing import Any


class LimitedConnection(http.client.HTTPConnection):
    """A connection on which ``timeout`` limits the whole answer, from its request on."""

    def connect(self) -> None:
        """Connect, to a socket with the limit."""
        super().connect()
        self._limited = _LimitedSocket(fileno=self.sock.detach())
        self.sock = self._limited

    def request(self, *args: Any, **named: Any) -> None:
        """Send a request; the time for its answer begins."""
        if self.sock is None:
            self.connect()
        self._limited.begin(float(self.timeout or math.inf))
        super().request(*args, **named)


class _LimitedSocket(socket.socket):
    """A socket that receives until a moment, however little comes at once."""

    _until_s = math.inf

    def begin(self, limit_s: float) -> None:
        """Limit what is sent and received from now on [s]."""
        self._until_s = time.monotonic() + limit_s
        self.settimeout(None if limit_s == math.inf else limit_s)

    def recv_into(self, *args: Any) -> int:
        """As of any socket, within the limit."""
        if self._until_s < math.inf:
            left_s = self._until_s - time.monotonic()
            if left_s <= 0:
                raise TimeoutError('the answer takes too long')
            self.settimeout(left_s)
        return super().recv_into(*args)
