"""The first lines of ``taxinet`` and of the nodes: what stops them early ends them in one line.

Their executables hold signals back (``scripts``), for Python has nothing better than a
traceback for those that come while it starts. Only what is needed to hear them is imported here.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn

_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main() -> None:
    """Entry point of the executable ``taxinet``."""
    with _heard():
        from taxinet_ros.cli.main import main as command

        command()


def start_node(name: str) -> NoReturn:
    """Entry point of a node's executable, by its name."""
    with _heard():
        from importlib import import_module

        code: object = 0
        try:
            import_module(f'taxinet_ros.nodes.{name}').main()
        except SystemExit as end:
            code = end.code
    for stream in filter(None, (sys.stdout, sys.stderr)):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    # The node has left the graph. To take the rest apart would cost more time than all else after
    # Ctrl-C, of which ``ros2 launch`` gives 5 s.
    os._exit(code if isinstance(code, int) else 0)


@contextlib.contextmanager
def _heard() -> Iterator[None]:
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
    os._exit(128 + number)
