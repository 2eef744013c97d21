"""Entry points of ``taxinet`` and the nodes, with clean exits on signals during start-up.

The executables (``scripts``) block signals, because Python would print a traceback for those that
arrive while it starts. Only what handles signals is imported here.
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

from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.instructions import lacking

_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_END = os._exit  # before user code is loaded: see processes.interrupts


def main() -> NoReturn:
    """Entry point of the executable ``taxinet``."""
    def command() -> None:
        from taxinet_ros.cli.main import main

        if lacking():
            print(f'this processor lacks {lacking()}: results may differ from those of others in '
                  'the last bits, see docs/determinism.md', file=sys.stderr)
        try:
            main()
        finally:
            with contextlib.redirect_stdout(sys.stderr):  # user code may print; results are already
            # out
                atexit._run_exitfuncs()

    _run(command)


def start_node(name: str) -> NoReturn:
    """Entry point of a node's executable, by its name."""
    start_module(f'taxinet_ros.nodes.{name}')


def start_module(name: str) -> NoReturn:
    """Run the ``main`` of a node's module."""
    def node() -> None:
        import gc
        from importlib import import_module

        # What is imported stays. To look for garbage in it costs a tenth of the imports, and as
        # much again each time later.
        gc.disable()
        try:
            module = import_module(name)
        except UsageError as error:  # as a node's main says it
            print(f'error: {error}', file=sys.stderr)
            sys.exit(ExitCode.USAGE)
        gc.freeze()
        gc.enable()
        module.main()

    _run(node)


def _run(work: Callable[[], None]) -> NoReturn:
    """Run the process's work and exit at once with its exit code.

    Everything that needs closing is closed by then. After Ctrl-C, for which ``ros2 launch`` allows
    5 s, interpreter shutdown would take longer than everything else, and it would wait forever for
    a thread left over by user code.
    """
    code: object = None
    with _signals_enabled():
        try:
            work()
        except SystemExit as end:
            code = end.code
        except KeyboardInterrupt:  # raised outside the code that handles it
            _leave(signal.SIGINT, None)
    for stream in filter(None, (sys.stdout, sys.stderr)):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    _END(code if isinstance(code, int) else 0 if code is None else ExitCode.INFRA)


@contextlib.contextmanager
def _signals_enabled() -> Iterator[None]:
    """Context in which signals are handled."""
    for number in _STOPS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # ignored: in the background, or nohup
            signal.signal(number, _leave)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _STOPS)
    try:
        yield
    finally:
        # The exit code is fixed; Python's shutdown must not be interrupted.
        for number in _STOPS:
            signal.signal(number, signal.SIG_IGN)


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    """Exit at once: nothing has been started that needs cleaning up."""
    os.write(2, b'taxinet: interrupted\n')
    _END(128 + number)


if __name__ == '__main__':
    start_module(sys.argv.pop(1))
