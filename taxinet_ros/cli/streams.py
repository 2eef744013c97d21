"""Tolerate closed or full standard streams, and refuse special files as input.

If the terminal closes or stderr is full, its output is dropped and the program continues. A pipe,
socket or device in place of an input file is refused, since reading it may never end; files are
opened in many places, some in libraries, so an audit hook checks each.
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
from taxinet_ros.files.reading import FOUND
from taxinet_ros.processes.child import fill_standard_descriptors


class OutputUnreadError(Exception):
    """Stdout was closed by its reader. Not an OSError, which libraries may catch."""


class _Output(io.FileIO):
    """Stdout that drops output once its terminal is closed."""

    def write(self, data: Any, /) -> int:
        """Write the data, or drop it if the terminal is closed."""
        try:
            return super().write(data)
        except BrokenPipeError:
            raise OutputUnreadError from None
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            return memoryview(data).nbytes


class _Complaints(io.FileIO):
    """Stderr that drops output it cannot write."""

    def write(self, data: Any, /) -> int:
        """Write the data, or drop it on an error."""
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes


@contextlib.contextmanager
def standard_streams() -> Iterator[bool]:
    """Context in which printing to a closed terminal or a lost stderr is no error.

    SIGHUP of a closed terminal may arrive after the first failed print. Streams closed from the
    start read and write nothing.

    Yields:
        Whether stdout was closed from the start.
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
    """Flush stdout.

    Raises:
        OSError, OutputUnreadError: flushing failed; the output is dropped, and later flushes do not
            raise.
    """
    try:
        sys.stdout.flush()
    except (OSError, OutputUnreadError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)
        raise


def _through(kind: type[io.FileIO], stream: TextIO) -> TextIO:
    """Wrap a stream's file in ``kind``; a stream without a file is returned unchanged."""
    try:
        raw = kind(stream.fileno(), 'w', closefd=False)
    except (OSError, ValueError):
        return stream
    return io.TextIOWrapper(
        io.BufferedWriter(raw), encoding=stream.encoding, errors=stream.errors,
        line_buffering=bool(stream.line_buffering),
    )


_ENDLESS = ('/dev/zero', '/dev/full')
_watched: list[bool] = []


def refuse_special_files() -> None:
    """Install an audit hook that raises :class:`UsageError` when a special file is opened.

    Paths below ``/dev`` are allowed: ``/dev/null``, ``/dev/stdin``, and the ``/dev/fd/63`` of a
    shell's ``<(command)``; but not those of which reading never ends.
    """
    if not _watched:
        _watched.append(True)
        sys.addaudithook(_check_opened_file)


def _check_opened_file(event: str, arguments: tuple[Any, ...]) -> None:
    if event != 'open' or not isinstance(arguments[0], str | bytes):
        return
    path = os.fsdecode(arguments[0])
    if path.startswith(('/dev/', '/proc/')) and path not in _ENDLESS:
        return
    try:
        kind = stat.S_IFMT(os.stat(path).st_mode)
    except (OSError, ValueError):
        return
    if kind in FOUND:
        raise UsageError(f'{path}: is {FOUND[kind]}, not a regular file')
