"""Ctrl-C and SIGTERM: once ends what is at hand in order, twice ends everything now."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType


@contextlib.contextmanager
def interrupts(first: Callable[[], None]) -> Iterator[None]:
    """Within the ``with``, have the first interrupt call ``first``.

    Raises:
        KeyboardInterrupt: at the second.
    """
    asked = False

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        first()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
