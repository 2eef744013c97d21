"""Interrupts (Ctrl-C, SIGTERM, closed terminal) and their exit codes.

The first interrupt requests an orderly end, the second an immediate one. Exit code 0 means that
every run satisfied its specifications, so user code cannot end the process or choose its exit code,
except through native code such as C's ``exit``.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from importlib.machinery import ExtensionFileLoader
from types import FrameType
from typing import Any, NoReturn

from taxinet_ros.errors import ExitCode, warn_once

exit_now: Callable[[int], NoReturn] = os._exit
"""The original ``os._exit``."""
RECEIVED_STOPS: list[int] = []
"""Signals received that ask this process to end, oldest first."""
_EXITS = ('_exit', 'execv', 'execve')
_FORKED = ('multiprocessing.popen_fork', 'multiprocessing.forkserver')
"""Modules that may call ``os._exit``: they end children whose work is done."""
_AGAIN_S = 0.01
_kept_by = 0


class ToldInterrupt(KeyboardInterrupt):
    """Interrupt that ends a command which has already reported the state of its work."""


def raise_interrupt(number: int, frame: FrameType | None) -> None:
    """Handle a signal like Ctrl-C, by raising KeyboardInterrupt, so that cleanup code runs.

    While a C++ library is being loaded or calls Python from a destructor, the signal is delayed:
    an exception there would make C++ abort the process.

    Raises:
        KeyboardInterrupt: in all other cases.
    """
    if _must_not_raise(frame):
        resend_signal(number)
        return
    RECEIVED_STOPS.append(number)
    raise KeyboardInterrupt


def resend_signal(number: int) -> None:
    """Resend a signal after a short delay; at once it would arrive at the same place."""
    who = threading.main_thread().ident
    assert who is not None
    again = threading.Timer(_AGAIN_S, signal.pthread_kill, (who, number))
    again.daemon = True
    again.start()


def _must_not_raise(frame: FrameType | None) -> bool:
    while frame is not None:
        name = frame.f_code.co_name
        if name in ('create_module', 'exec_module') and isinstance(
            frame.f_locals.get('self'), ExtensionFileLoader
        ):
            return True
        # The executor of rclpy releases the entities it waits for in destructors.
        if name == '__exit__' and str(frame.f_globals.get('__name__')).startswith('rclpy.'):
            return True
        frame = frame.f_back
    return False


def refuse_exits() -> None:
    """Replace functions that end the process immediately, so that they raise SystemExit.

    Child processes are not affected. From now on every Ctrl-C is recorded, even if user code
    handles it.
    """
    global _kept_by
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        with contextlib.suppress(ValueError):  # only the main thread can set handlers
            signal.signal(signal.SIGINT, raise_interrupt)
    if not _kept_by:
        for name in _EXITS:
            refusing = _refusing(name, getattr(os, name))
            for module in (os, sys.modules[os.name]):
                setattr(module, name, refusing)
    _kept_by = os.getpid()


def _refusing(name: str, end: Callable[..., NoReturn]) -> Callable[..., NoReturn]:
    def refuse(*words: Any, **named: Any) -> NoReturn:
        caller = sys._getframe(1).f_globals.get('__name__')
        if os.getpid() != _kept_by or (name == '_exit' and caller in _FORKED):
            end(*words, **named)
        called = f'os.{name}({", ".join(map(repr, words))})'
        if threading.current_thread() is not threading.main_thread():  # SystemExit is silent
            warn_once(f'{called}: refused in a thread of user code')
        raise SystemExit(called)

    return refuse


_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that request the end of a program."""
_STUCK_S = 5.0
"""Time limit for code that was told to give up [s]."""


@contextlib.contextmanager
def interrupts(
    first: Callable[[], None], second: Callable[[], bool] = lambda: False,
    gone_s: float | None = None,
) -> Iterator[None]:
    """Context in which the first interrupt calls ``first`` and the next one ``second``.

    If user code still does not return, the process is ended after :data:`_STUCK_S`.

    Args:
        first: requests an orderly end of the current work.
        second: makes waiting code give up; returns False if none is waiting.
        gone_s: the process is ended this long after the second interrupt [s], whatever ``second``
            returns; for work that needs no cleanup beyond the kernel's. None: no such limit.

    Raises:
        KeyboardInterrupt: ``second`` returned False, or at the third interrupt.
    """
    turns = itertools.count(1)  # in one step, for a second interrupt may come within the handler
    stuck = threading.Timer(_STUCK_S if gone_s is None else gone_s, _exit_stuck)
    stuck.daemon = True

    def handle(number: int, frame: FrameType | None) -> None:
        if _must_not_raise(frame):
            resend_signal(number)
            return
        turn = next(turns)
        RECEIVED_STOPS.append(number)
        if turn == 1:
            first()
            return
        told = turn == 2 and second()
        if turn == 2 and (told or gone_s is not None):
            stuck.start()
        if not told:
            raise KeyboardInterrupt

    with signals_handled(handle):
        try:
            yield
        finally:
            stuck.cancel()


@contextlib.contextmanager
def interrupts_delayed() -> Iterator[None]:
    """Context of a closing that no interrupt may tear apart: they take effect at its end.

    If it has not ended :data:`_STUCK_S` after the first of them, the process is. Interrupts reach
    the main thread only, so other threads need nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    turns = itertools.count(1)

    def end() -> None:
        RECEIVED_STOPS.extend(came)
        _exit_stuck()

    stuck = threading.Timer(_STUCK_S, end)
    stuck.daemon = True

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)
        if next(turns) == 1:
            stuck.start()

    try:
        with signals_handled(note):
            yield
    finally:
        stuck.cancel()
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


@contextlib.contextmanager
def lost_interrupts_resent() -> Iterator[None]:
    """Context that resends an interrupt that Python could not raise.

    In a destructor, or in a callback of the import system, Python would only print it.
    """
    before = sys.unraisablehook

    def hook(what: Any) -> None:
        if not issubclass(what.exc_type, KeyboardInterrupt):
            before(what)
            return
        # Delayed, since it would otherwise be raised right here.
        resend_signal(_newest_stop())

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before


def exit_handler(code: int) -> Callable[[int, FrameType | None], NoReturn]:
    """Signal handler that ends the process immediately, regardless of its threads.

    For use before work has begun or after it is done. :attr:`ExitCode.INTERRUPTED` becomes the exit
    code of the signal, see :func:`interrupted_exit_code`.
    """
    def handle(number: int, frame: FrameType | None) -> NoReturn:
        RECEIVED_STOPS.append(number)
        exit_now(interrupted_exit_code(code))

    return handle


def _exit_stuck() -> None:
    line = b'taxinet: error: what is at hand does not come back; it is left where it stands\n'
    with contextlib.suppress(OSError):
        os.write(2, line)  # not print: its lock may be held by a stuck thread
    exit_now(interrupted_exit_code(ExitCode.INTERRUPTED))


def interrupted_exit_code(code: int) -> int:
    """Exit code, or for an interrupt that of the received signal: 130, or 143 for SIGTERM.

    As in shells, it is 128 plus the signal number (POSIX.1-2024, XCU section 2.8.2).
    """
    return 128 + _newest_stop() if code == ExitCode.INTERRUPTED else code


def _newest_stop() -> int:
    return RECEIVED_STOPS[-1] if RECEIVED_STOPS else signal.SIGINT
