"""A terminal that goes away takes only what it shows with it, not the program."""

from __future__ import annotations

import contextlib
import errno
import io
import sys
from collections.abc import Iterator
from typing import Any, TextIO


class _Leavable(io.FileIO):
    """A terminal; once that is closed, what is written goes nowhere."""

    def write(self, data: Any, /) -> int:
        """Write to it, if it is there."""
        try:
            return super().write(data)
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            return memoryview(data).nbytes


@contextlib.contextmanager
def outlived_terminal() -> Iterator[None]:
    """Within the ``with``, printing to a terminal that is closed is no error.

    The signal that says so (SIGHUP) may come later than the first failure to print.
    """
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = map(_leavable, before)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        sys.stdout, sys.stderr = before


def _leavable(stream: TextIO) -> TextIO:
    if not stream.isatty():
        return stream
    raw = _Leavable(stream.fileno(), 'w', closefd=False)
    return io.TextIOWrapper(
        io.BufferedWriter(raw), encoding=stream.encoding, errors=stream.errors, line_buffering=True
    )
