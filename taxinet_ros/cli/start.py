"""Entry points of ``taxinet`` and of the nodes.

Before and after the work, a signal ends the process at once and in one line. Little is imported
here, so that this holds soon after Python itself has started; in its first 70 ms an interrupt ends
it with Python's own traceback.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
from collections.abc import Callable
from importlib import import_module
from typing import NoReturn

from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.instructions import lacking
from taxinet_ros.processes.interrupts import (
    exit_at_once,
    exit_if_lost,
    handle_signals,
    heeded_signals,
    say_interrupted,
)

_OF_SCENES = {'run', 'falsify', 'estimate'}
_WITHOUT_SCENES = {'-h', '--help', '--help-all', '--from'}


def main() -> NoReturn:
    """Entry point of the executable ``taxinet``."""
    def command() -> None:
        gc.set_threshold(50_000)  # nearly all that a command makes at first is imported, and stays
        if {*sys.argv[1:2]} & _OF_SCENES and not {*sys.argv} & _WITHOUT_SCENES:
            from taxinet_ros.scenes.scenic_server import start_early

            with contextlib.suppress(OSError):  # said where a program is compiled
                start_early()  # Scenic is imported in its own process while this one goes on
        from taxinet_ros.cli.main import main

        if lacking():
            print(f'this processor lacks {lacking()}: results may differ from those of others in '
                  'the last bits, see docs/determinism.md', file=sys.stderr)
        main()

    _run(command)


def start_node(name: str) -> NoReturn:
    """Entry point of a node's executable, by its name."""
    start_module(f'taxinet_ros.nodes.{name}')


def start_module(name: str) -> NoReturn:
    """Run the ``main`` of a node's module."""
    def node() -> None:
        try:
            module = import_module(name)
        except UsageError as error:  # as a node's main says it
            print(f'error: {error}', file=sys.stderr)
            sys.exit(ExitCode.USAGE)
        module.main()

    _run(node)


def _run(work: Callable[[], None]) -> NoReturn:
    """Run the process's work and exit with its exit code.

    Everything that needs closing is closed by then. Interpreter shutdown would take longer than
    everything else after Ctrl-C, for which ``ros2 launch`` allows 5 s, and it would wait forever
    for a thread left over by user code.
    """
    sys.unraisablehook = exit_if_lost
    handle_signals(exit_at_once, heeded_signals())
    signal.pthread_sigmask(signal.SIG_UNBLOCK, heeded_signals())  # a starter may block them
    code: object = None
    try:
        work()
    except SystemExit as end:
        code = end.code
    except KeyboardInterrupt:  # raised outside the code that handles it
        say_interrupted()
        code = ExitCode.INTERRUPTED
    handle_signals(exit_at_once, heeded_signals())
    for stream in filter(None, (sys.stdout, sys.stderr)):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code if isinstance(code, int) else 0 if code is None else ExitCode.INFRA)


if __name__ == '__main__':
    start_module(sys.argv.pop(1))
