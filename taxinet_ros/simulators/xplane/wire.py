"""What the clients of X-Plane's network interfaces have in common: names, values, failures."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Protocol

from taxinet_ros.errors import InfraError, InfraKind, UsageError

WHO = 'x-plane'
"""Who failed, in errors and records."""

Value = float | tuple[float, ...] | str
"""Value of a dataref: a number, an array of numbers, or the text of bytes."""

MOST_NAME = 255
"""Length limit of a name: XPlaneConnect counts it in a byte."""
MOST_ELEMENTS = 255
"""Length limit of an array that is written, for the same reason."""

_NAME = re.compile(r'([A-Za-z0-9_.\-]+(?:/[A-Za-z0-9_.\-]+)+)(?:\[(\d{1,4})\])?')


def failed(kind: InfraKind, detail: str) -> InfraError:
    """Create the error of a simulator that did not do its part."""
    return InfraError(kind, WHO, -1, detail)


def split_name(text: str) -> tuple[str, int | None]:
    """Split ``sim/weather/cloud_type[0]`` into the name and the index of an element.

    X-Plane 11 has some datarefs whose names end in an index; :class:`WebApi` looks for both.

    Raises:
        UsageError: it is no name of a dataref or command.
    """
    found = _NAME.fullmatch(text)
    if not found or len(text) > MOST_NAME:
        raise UsageError(
            f'x-plane: {text!r:.80} is no name of a dataref; expected words joined by /, as in '
            'sim/weather/rain_percent or sim/weather/cloud_type[0]'
        )
    return found[1], None if found[2] is None else int(found[2])


def checked_value(name: str, value: object) -> float | tuple[float, ...]:
    """A finite number, or an array of them, to be written.

    Raises:
        UsageError: it is neither.
    """
    if isinstance(value, bool):
        return float(value)
    if isinstance(value, int | float) and math.isfinite(value):
        return float(value)
    if isinstance(value, Sequence) and not isinstance(value, str) and (
        0 < len(value) <= MOST_ELEMENTS
        and all(isinstance(one, int | float) and math.isfinite(one) for one in value)
    ):
        return tuple(map(float, value))
    raise UsageError(
        f'x-plane: {name} is {value!r:.60}; expected a finite number, or a list of 1 to '
        f'{MOST_ELEMENTS} of them'
    )


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
