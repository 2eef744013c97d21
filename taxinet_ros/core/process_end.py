"""The end of a process that runs somebody's code: nobody but us decides when, and with which code.

An exit code is a verdict: 0 says that every run satisfied its specifications. Beyond reach is what
ends a process below Python, as C's ``exit`` does.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable
from importlib.machinery import ExtensionFileLoader
from types import FrameType
from typing import Any, NoReturn

from taxinet_ros.core.errors import warn_once

leave: Callable[[int], NoReturn] = os._exit
"""``os._exit`` as it is, for us."""

STOPS_HEARD: list[int] = []
"""Numbers of the signals that came and asked this process to end, oldest first."""

_EXITS = ('_exit', 'execv', 'execve')
_FORKED = ('multiprocessing.popen_fork', 'multiprocessing.forkserver')
"""Who ends, by ``os._exit``, a child in which somebody's code is loaded: it is at its end."""

_AGAIN_S = 0.01
_kept_by = 0


def end_now(number: int, frame: FrameType | None) -> None:
    """Handle a signal as Python does Ctrl-C, so that whatever is begun is cleared away.

    While a library in C++ is being loaded the signal is put off: pybind11 lets no exception out of
    there, and would abort the process for it.

    Raises:
        KeyboardInterrupt: else.
    """
    if _is_loading(frame):
        come_again(number)
        return
    STOPS_HEARD.append(number)
    raise KeyboardInterrupt


def come_again(number: int) -> None:
    """Have a signal come a moment later; at once it would be where it was."""
    who = threading.main_thread().ident
    assert who is not None
    again = threading.Timer(_AGAIN_S, signal.pthread_kill, (who, number))
    again.daemon = True
    again.start()


def _is_loading(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_name in ('create_module', 'exec_module') and isinstance(
            frame.f_locals.get('self'), ExtensionFileLoader
        ):
            return True
        frame = frame.f_back
    return False


def keep_end() -> None:
    """From now on, have Python's ways to end this process at once raise SystemExit instead.

    Its children may end as they like. A Ctrl-C is noted from now on, wherever it is handled.
    """
    global _kept_by
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        with contextlib.suppress(ValueError):  # not the main thread, which alone is interrupted
            signal.signal(signal.SIGINT, end_now)
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
        if threading.current_thread() is not threading.main_thread():  # where it would be silent
            warn_once(f"{called}: refused, in a thread of somebody's code")
        raise SystemExit(called)

    return refuse
