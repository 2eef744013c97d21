"""The first lines of ``taxinet``: whatever stops it before it has begun ends it in one line.

Its executable holds signals back (``scripts/taxinet``), for Python has nothing better than a
traceback for those that come while it starts. Only what is needed to hear them is imported here.
"""

from __future__ import annotations

import os
import signal
from types import FrameType
from typing import NoReturn

_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main() -> None:
    """Entry point of the executable."""
    for number in _STOPS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as it is in the background, or nohup
            signal.signal(number, _leave)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _STOPS)
    try:
        from taxinet_ros.cli.main import main as command

        command()
    finally:
        # The exit code stands; what Python does on its way out is not to be torn.
        for number in _STOPS:
            signal.signal(number, signal.SIG_IGN)


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    """End at once: nothing has been begun that would have to be cleared away."""
    os.write(2, b'taxinet: interrupted\n')
    os._exit(128 + number)
