"""The first lines of ``taxinet`` and of the nodes: what stops them early ends them in one line.

Their executables hold signals back (``scripts``), for Python has nothing better than a
traceback for those that come while it starts. Only what is needed to hear them is imported here.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from types import FrameType
from typing import NoReturn

from taxinet_ros.errors import ExitCode

_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_END = os._exit  # as it is before somebody's code is loaded: see processes.interrupts


def main() -> NoReturn:
    """Entry point of the executable ``taxinet``."""
    def command() -> None:
        from taxinet_ros.cli.main import main

        try:
            main()
        finally:
            with contextlib.redirect_stdout(sys.stderr):  # somebody's may print; results are out
                atexit._run_exitfuncs()

    _run(command)


def start_node(name: str) -> NoReturn:
    """Entry point of a node's executable, by its name."""
    start_module(f'taxinet_ros.nodes.{name}')


def start_module(name: str) -> NoReturn:
    """Run the ``main`` of a node's module."""
    def node() -> None:
        from importlib import import_module

        import_module(name).main()

    _run(node)


def _run(work: Callable[[], None]) -> NoReturn:
    """Do the work of this process, and leave it at once with its exit code.

    All that is to be closed is closed. To take the rest apart would cost more time than all else
    after Ctrl-C, of which ``ros2 launch`` gives 5 s; and a thread that somebody's function has
    started, and forgotten, would be waited for without end.
    """
    code: object = None
    with _signals_enabled():
        try:
            work()
        except SystemExit as end:
            code = end.code
        except KeyboardInterrupt:  # between those who handle it
            _leave(signal.SIGINT, None)
    for stream in filter(None, (sys.stdout, sys.stderr)):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    _END(code if isinstance(code, int) else 0 if code is None else ExitCode.INFRA)


@contextlib.contextmanager
def _signals_enabled() -> Iterator[None]:
    """Within the ``with``, signals are heard, from the first line on."""
    for number in _STOPS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as it is in the background, or nohup
            signal.signal(number, _leave)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _STOPS)
    try:
        yield
    finally:
        # The exit code stands; what Python does on its way out is not to be torn.
        for number in _STOPS:
            signal.signal(number, signal.SIG_IGN)


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    """End at once: nothing has been begun that would have to be cleared away."""
    os.write(2, b'taxinet: interrupted\n')
    _END(128 + number)


if __name__ == '__main__':
    start_module(sys.argv.pop(1))
