"""Interrupts (Ctrl-C, SIGTERM, closed terminal) and their exit codes.

The first one asks for an orderly end, the second ends the process at once: its children die with
it, and what it has recorded is complete up to the last step.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import Any, NoReturn

from taxinet_ros.errors import ExitCode
from taxinet_ros.processes.streams import drop_output, is_closed

_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that request the end of a program."""
_received: list[int] = []
"""Those that this process has received, oldest first."""


class ToldInterrupt(KeyboardInterrupt):
    """Interrupt that ends a command which has already reported the state of its work."""


def raise_interrupt(number: int, frame: FrameType | None) -> None:
    """Handle a signal like Ctrl-C, by raising KeyboardInterrupt, so that cleanup code runs.

    Amid an import it ends the process instead: C modules such as numpy's turn an interrupt into an
    ImportError of theirs.

    Raises:
        KeyboardInterrupt: always.
    """
    while frame is not None and not frame.f_code.co_filename.startswith('<frozen importlib'):
        frame = frame.f_back
    if frame is not None:
        exit_at_once(number, frame)
    _note(number)
    raise KeyboardInterrupt


def exit_at_once(number: int, frame: FrameType | None) -> NoReturn:
    """Handle a signal by ending the process, without cleanup."""
    say_interrupted()
    os._exit(128 + number)


def exit_if_lost(lost: sys.UnraisableHookArgs) -> None:
    """Hook for exceptions that Python drops: a dropped interrupt ends the process at once.

    One that arrives in a destructor or in the callback of a weak reference, such as those of
    Python's imports, reaches no code that could handle it.
    """
    if issubclass(lost.exc_type, KeyboardInterrupt):
        exit_at_once(_received[-1] if _received else signal.SIGINT, None)
    sys.__unraisablehook__(lost)


def exit_handler(code: int) -> Callable[[int, FrameType | None], NoReturn]:
    """Signal handler that ends the process immediately, regardless of its threads.

    For use before work has begun or after it is done. :attr:`ExitCode.INTERRUPTED` becomes the exit
    code of the signal, see :func:`interrupted_exit_code`.
    """
    def handle(number: int, frame: FrameType | None) -> NoReturn:
        _note(number)
        os._exit(interrupted_exit_code(code))

    return handle


def say_interrupted() -> None:
    """Print the line of a command that was interrupted."""
    with contextlib.suppress(OSError):
        os.write(2, b'taxinet: interrupted\n')  # print() may be interrupted itself


@contextlib.contextmanager
def interrupts(first: Callable[[], None]) -> Iterator[None]:
    """Context in which the first interrupt calls ``first``, and the next one ends the process.

    Args:
        first: requests an orderly end of the current work.
    """
    asked: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        if asked:
            exit_at_once(number, frame)
        asked.append(number)
        _note(number)
        first()

    with signals_handled(handle):
        yield


@contextlib.contextmanager
def interrupts_delayed() -> Iterator[None]:
    """Context of a closing that one interrupt does not tear apart: it takes effect at its end.

    Interrupts reach the main thread only, so other threads need nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    try:
        with interrupts(lambda: came.append(_received[-1])):
            yield
    finally:
        for number in came:
            signal.raise_signal(number)


@contextlib.contextmanager
def signals_handled(
    handle: Callable[[int, FrameType | None], None], numbers: Sequence[signal.Signals] = _STOPS
) -> Iterator[None]:
    """Context in which signals are handled; under ``nohup``, SIGHUP is not."""
    before = handle_signals(handle, numbers)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def handle_signals(
    handle: Callable[[int, FrameType | None], None], numbers: Sequence[signal.Signals] = _STOPS
) -> dict[signal.Signals, Any]:
    """Install signal handlers until the process ends; return the previous ones."""
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        numbers = [number for number in numbers if number != signal.SIGHUP]
    return {number: signal.signal(number, handle) for number in numbers}


def heeded_signals() -> list[signal.Signals]:
    """Signals that end this process, without those that its starter has it ignore (``nohup``)."""
    return [number for number in _STOPS if signal.getsignal(number) is not signal.SIG_IGN]


def interrupted_exit_code(code: int) -> int:
    """Exit code, or for an interrupt that of the received signal: 130, or 143 for SIGTERM.

    As in shells, it is 128 plus the signal number (POSIX.1-2024, XCU section 2.8.2).
    """
    newest = _received[-1] if _received else signal.SIGINT
    return 128 + newest if code == ExitCode.INTERRUPTED else code


def interrupts_received() -> int:
    """Number of interrupts that this process has received."""
    return len(_received)


def _note(number: int) -> None:
    _received.append(number)
    if number == signal.SIGHUP:  # what is printed to a closed terminal would be an error
        drop_output(*filter(is_closed, (1, 2)))
