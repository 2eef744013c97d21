"""Standard streams that may be closed or full, and special files in the place of regular ones.

A terminal that goes away, or a stderr that takes no more, loses what is shown there and does not
end the program. A pipe, socket or device where a file is to be read is refused, for reading it may
never end; files are opened in many places, some of them in libraries, so an audit hook checks each.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import stat
import sys
from collections.abc import Iterator
from typing import Any, TextIO

from taxinet_ros.errors import UsageError
from taxinet_ros.processes.child import fill_standard_descriptors


class OutputUnreadError(Exception):
    """Nobody reads stdout any more. No OSError, which libraries take for their own to handle."""


class _Output(io.FileIO):
    """Stdout; once its terminal is closed, what is written goes nowhere."""

    def write(self, data: Any, /) -> int:
        """Write to it, if it is there."""
        try:
            return super().write(data)
        except BrokenPipeError:
            raise OutputUnreadError from None
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            return memoryview(data).nbytes


class _Complaints(io.FileIO):
    """Stderr; where it takes no more, what is written goes nowhere."""

    def write(self, data: Any, /) -> int:
        """Write to it, if it is there."""
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes


@contextlib.contextmanager
def standard_streams() -> Iterator[bool]:
    """Within the ``with``, printing to a closed terminal, and to any lost stderr, is no error.

    The signal that says that a terminal is closed (SIGHUP) may come later than the first failure
    to print. Streams that were closed from the start read and write nothing.

    Yields:
        Whether stdout was closed from the start, so that nobody would get an answer.
    """
    closed = sys.stdout is None
    fill_standard_descriptors()
    before = sys.stdin, sys.stdout, sys.stderr
    sys.stdin = sys.stdin or os.fdopen(0, closefd=False)
    sys.stdout = _through(_Output, sys.stdout or os.fdopen(1, 'w', closefd=False))
    sys.stderr = _through(_Complaints, sys.stderr or os.fdopen(2, 'w', closefd=False))
    try:
        yield closed
    finally:
        with contextlib.suppress(OSError):
            sys.stderr.flush()
        sys.stdin, sys.stdout, sys.stderr = before


def flush_output() -> None:
    """Have everything printed so far reach whoever reads it.

    Raises:
        OSError, OutputUnreadError: it does not; it is given up, and no later flush complains.
    """
    try:
        sys.stdout.flush()
    except (OSError, OutputUnreadError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)
        raise


def _through(kind: type[io.FileIO], stream: TextIO) -> TextIO:
    """A stream to the same place by way of ``kind``; one that is no file's is left alone."""
    try:
        raw = kind(stream.fileno(), 'w', closefd=False)
    except (OSError, ValueError):
        return stream
    return io.TextIOWrapper(
        io.BufferedWriter(raw), encoding=stream.encoding, errors=stream.errors,
        line_buffering=bool(stream.line_buffering),
    )


_FOUND = {stat.S_IFIFO: 'a pipe', stat.S_IFSOCK: 'a socket', stat.S_IFCHR: 'a device',
          stat.S_IFBLK: 'a device'}
_watched: list[bool] = []


def refuse_special_files() -> None:
    """From now on, opening such a thing raises :class:`UsageError`.

    What is named below ``/dev`` itself was meant: ``/dev/null``, ``/dev/stdin``, and the
    ``/dev/fd/63`` of a shell's ``<(command)``.
    """
    if not _watched:
        _watched.append(True)
        sys.addaudithook(_check_opened_file)


def _check_opened_file(event: str, arguments: tuple[Any, ...]) -> None:
    if event != 'open' or not isinstance(arguments[0], str | bytes):
        return
    path = os.fsdecode(arguments[0])
    if path.startswith(('/dev/', '/proc/')):
        return
    try:
        kind = stat.S_IFMT(os.stat(path).st_mode)
    except (OSError, ValueError):
        return
    if kind in _FOUND:
        raise UsageError(f'{path}: is {_FOUND[kind]}, no regular file')
