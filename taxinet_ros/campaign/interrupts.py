"""Ctrl-C, SIGTERM and a closed terminal: once for an end in order, twice for an end now."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import Any, NoReturn

from taxinet_ros.core.process_end import STOPS_HEARD, come_again, leave

_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What asks a program to end."""

INTERRUPTED = 128 + signal.SIGINT
"""Exit code of what was interrupted, as a command gives it; see :func:`told_apart`."""

_STUCK_S = 5.0
"""How long whoever was told to give up may take."""


@contextlib.contextmanager
def interrupts(
    first: Callable[[], None], second: Callable[[], bool] = lambda: False,
    gone_s: float | None = None,
) -> Iterator[None]:
    """Within the ``with``, have the first interrupt call ``first``, and the next one ``second``.

    Where that helps nothing, for somebody's code does not come back, the process is ended after
    :data:`_STUCK_S`.

    Args:
        first: has what is at hand end in order.
        second: has whoever waits give up, or answers False where there is nobody to be told.
        gone_s: the process is ended so long after the second interrupt [s], whatever ``second``
            answers; for what has nothing to clear away that the kernel does not. None: not so.

    Raises:
        KeyboardInterrupt: where ``second`` answers False, and at the third interrupt.
    """
    asked = 0
    stuck = threading.Timer(_STUCK_S if gone_s is None else gone_s, _leave_stuck)
    stuck.daemon = True

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        asked += 1
        STOPS_HEARD.append(number)
        if asked == 1:
            first()
            return
        told = asked == 2 and second()
        if asked == 2 and (told or gone_s is not None):
            stuck.start()
        if not told:
            raise KeyboardInterrupt

    with handled(handle):
        try:
            yield
        finally:
            stuck.cancel()


@contextlib.contextmanager
def handled(
    handle: Callable[[int, FrameType | None], None], numbers: Sequence[signal.Signals] = _STOPS
) -> Iterator[None]:
    """Within the ``with``, have signals handled; under ``nohup`` no closed terminal is one."""
    before = handle_from_now_on(handle, numbers)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def handle_from_now_on(
    handle: Callable[[int, FrameType | None], None], numbers: Sequence[signal.Signals] = _STOPS
) -> dict[signal.Signals, Any]:
    """Have signals handled, to the end of the process; what they were handled by before."""
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        numbers = [number for number in numbers if number != signal.SIGHUP]
    return {number: signal.signal(number, handle) for number in numbers}


@contextlib.contextmanager
def heard_again() -> Iterator[None]:
    """Within the ``with``, have an interrupt come again that Python could not raise.

    In a destructor, or in a callback of the import system, it would be printed and forgotten.
    """
    before = sys.unraisablehook

    def hook(what: Any) -> None:
        if not issubclass(what.exc_type, KeyboardInterrupt):
            before(what)
            return
        # At once, it would be raised right here.
        come_again(_newest())

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before


def leave_with(code: int) -> Callable[[int, FrameType | None], NoReturn]:
    """What handles a signal by ending the process where it stands, whatever its threads are at.

    For where nothing is begun, or all is done: :data:`INTERRUPTED` is told apart.
    """
    def handle(number: int, frame: FrameType | None) -> NoReturn:
        STOPS_HEARD.append(number)
        leave(told_apart(code))

    return handle


def _leave_stuck() -> None:
    line = b'taxinet: error: what is at hand does not come back; it is left where it stands\n'
    with contextlib.suppress(OSError):
        os.write(2, line)  # not print: its lock may be held by what does not come back
    leave(told_apart(INTERRUPTED))


def told_apart(code: int) -> int:
    """An exit code, where an interrupt's is that of the signal that came: 130, or 143 of SIGTERM.

    So do shells, with 128 and the signal's number (POSIX.1-2024, XCU section 2.8.2).
    """
    return 128 + _newest() if code == INTERRUPTED else code


def _newest() -> int:
    return STOPS_HEARD[-1] if STOPS_HEARD else signal.SIGINT
