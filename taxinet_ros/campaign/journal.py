"""A file of JSON lines that is only ever appended to, by one process at a time.

A last line without its end is cut off when the file is opened: it was being written when the power
went, and nobody has been told that it was kept.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from taxinet_ros.bag.layout import disk_error
from taxinet_ros.core.errors import RecordError, UsageError


class Journal:
    """An open journal.

    Attributes:
        lines: the whole lines that it held when it was opened, without their ends.
    """

    def __init__(self, path: Path) -> None:
        """Open ``path`` to append, making it if need be.

        Raises:
            BlockingIOError: another process has it open.
            OSError: it cannot be opened.
        """
        self._path = path
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            whole = whole_lines(path.read_bytes())
            os.ftruncate(self._fd, len(whole))
        except BaseException:
            self.close()
            raise
        self.lines = whole.splitlines()

    def append(self, values: Mapping[str, Any]) -> None:
        """Write one line.

        Raises:
            OSError: not all of it could be written, as on a full disk.
            RecordError: it was written, but where nobody looks for it; see :meth:`check_in_place`.
        """
        line = json.dumps(values, separators=(',', ':')).encode() + b'\n'
        if (written := os.write(self._fd, line)) != len(line):
            what = f'only {written} of {len(line)} bytes fitted'
            raise OSError(None, what, str(self._path))
        self.check_in_place()

    def check_in_place(self) -> None:
        """See that the open file is still the one at its path.

        Raises:
            RecordError: it, or a folder above it, was moved, deleted or replaced. What was appended
                is in the file all the same, wherever that is now.
        """
        if not _is_at(self._path, self._fd):
            os.fsync(self._fd)
            raise RecordError(
                f'{self._path}: was moved, deleted or replaced while it was written; what was '
                'recorded is in the file that was moved'
            )

    def sync(self) -> None:
        """Wait until what was written has reached the disk."""
        os.fsync(self._fd)

    def close(self) -> None:
        """Let others open it."""
        os.close(self._fd)


def _is_at(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.stat(path), os.fstat(descriptor))
    except OSError:
        return False


def whole_lines(data: bytes) -> bytes:
    """``data`` without a last line that has no end."""
    return data[: data.rfind(b'\n') + 1]


def open_journal(path: Path, command: str) -> Journal:
    """Open a journal for a command that works on its folder.

    Raises:
        UsageError: another such command has it open, or it cannot be written.
    """
    try:
        return Journal(path)
    except BlockingIOError as error:
        raise UsageError(f'{path}: another {command} is at work on it') from error
    except OSError as error:
        raise disk_error(path, error) from error


class JournalOwner:
    """Something that keeps a journal open; a context manager that closes it."""

    _journal: Journal

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let others open it."""
        self._journal.close()

    def check_in_place(self) -> None:
        """See :meth:`Journal.check_in_place`."""
        self._journal.check_in_place()
