"""Ctrl-C, SIGTERM and a closed terminal: once for an end in order, twice for an end now."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType

_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignal:
    """Which signal asked for the end, if any has.

    Attributes:
        number: the first that came; 0 as long as none has.
    """

    def __init__(self) -> None:
        self.number = 0
        self._in_order: Callable[[], None] | None = None

    @property
    def exit_code(self) -> int:
        """What a shell expects: 130 after Ctrl-C, 143 after SIGTERM; 0 without a signal."""
        return 128 + self.number if self.number else 0

    def hear(self, in_order: Callable[[], None]) -> None:
        """From now on the first signal calls ``in_order``; before, it raised KeyboardInterrupt."""
        self._in_order = in_order

    def take(self, number: int, frame: FrameType | None) -> None:
        """Take one signal."""
        first, self.number = not self.number, self.number or number
        if not first or self._in_order is None:
            raise KeyboardInterrupt
        self._in_order()


@contextlib.contextmanager
def stop_signals() -> Iterator[StopSignal]:
    """Within the ``with``, take the signals that ask a program to end."""
    stop = StopSignal()
    before = {number: signal.signal(number, stop.take) for number in _STOPS}
    try:
        yield stop
    finally:
        for number, old in before.items():
            signal.signal(number, old)
