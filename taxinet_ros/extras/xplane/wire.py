"""What the two clients of X-Plane have in common: values, failures, hosts."""

from __future__ import annotations

import socket

from taxinet_ros.errors import InfraError, InfraKind, UsageError

WHO = 'x-plane'
"""Who failed, in errors and records."""

Value = float | tuple[float, ...] | str
"""Value of a dataref: a number, an array of numbers, or the text of bytes."""


def failed(kind: InfraKind, detail: str) -> InfraError:
    """Create the error of a simulator that did not do its part."""
    return InfraError(kind, WHO, -1, detail)


def address_of(host: str) -> str:
    """IPv4 address of a host."""
    try:
        return socket.gethostbyname(host or 'no host')
    except (OSError, TypeError, ValueError) as error:
        raise UsageError(
            f'x-plane: host {host!r:.80} is unknown, or has no IPv4 address'
        ) from error
