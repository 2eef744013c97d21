"""JSBSim's log, caught instead of printed: its banner on every start, its reasons for a failure."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import jsbsim


class CapturedLog(jsbsim.FGLogger):
    """Collects what JSBSim says.

    Attributes:
        text: everything so far.
    """

    def __init__(self) -> None:
        super().__init__()
        self.text = ''

    def set_level(self, level: jsbsim.LogLevel) -> None:
        """Ignore the severity of the next record."""

    def file_location(self, filename: str, line: int) -> None:
        """Ignore where in JSBSim's input the next record comes from."""

    def message(self, message: str) -> None:
        """Keep a piece of text."""
        self.text += message

    def format(self, style: jsbsim.LogFormat) -> None:
        """Ignore colours."""

    def flush(self) -> None:
        """End a record."""
        self.text += '\n'


@contextmanager
def captured_log() -> Iterator[CapturedLog]:
    """Catch what JSBSim logs on this thread while the context lasts."""
    outer = jsbsim.get_logger()
    log = CapturedLog()
    jsbsim.set_logger(log)
    try:
        yield log
    finally:
        jsbsim.set_logger(outer)
