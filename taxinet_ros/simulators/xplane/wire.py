"""What the clients of X-Plane's network interfaces have in common: values, failures, methods."""

from __future__ import annotations

from typing import Protocol

from taxinet_ros.errors import InfraError, InfraKind

WHO = 'x-plane'
"""Who failed, in errors and records."""

Value = float | tuple[float, ...] | str
"""Value of a dataref: a number, an array of numbers, or the text of bytes."""

def failed(kind: InfraKind, detail: str) -> InfraError:
    """Create the error of a simulator that did not do its part."""
    return InfraError(kind, WHO, -1, detail)


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
