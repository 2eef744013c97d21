"""Append-only JSON Lines file with a checksum in each line, written by one process at a time.

Each line begins with a digest of the rest of it under the key ``sum``. An incomplete last line is
removed when the file is opened: its write was interrupted and never confirmed. Complete lines that
are missing or exchanged are detected by comparison with a recorded end (:class:`JournalEnd`).
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.atomic import disk_error
from taxinet_ros.files.plain_values import load_json
from taxinet_ros.files.reading import read_file

_DIGITS = 32
_LINE = re.compile(rb'\{"sum":"([0-9a-f]{32})",(.+\})', re.DOTALL)


class JournalEnd(NamedTuple):
    """End of a journal: number of lines, and a digest of the checksums of all of them."""

    lines: int
    checksum: str


@dataclass(frozen=True, kw_only=True, slots=True)
class JournalLine:
    """One complete line of a journal.

    Attributes:
        event: its values, without the checksum; None if it is damaged.
        checksum: its checksum; '' in a damaged line.
        trouble: what is wrong with it, or ''.
    """

    event: dict[str, Any] | None
    checksum: str = ''
    trouble: str = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class JournalContent:
    """Content of a journal.

    Attributes:
        lines: all complete lines.
        whole: number of bytes up to the end of the last complete line.
        trouble: error in the bytes after them, or ''.
    """

    lines: tuple[JournalLine, ...] = ()
    whole: int = 0
    trouble: str = ''

    @property
    def end(self) -> JournalEnd:
        """End of the journal."""
        return self.end_after(len(self.lines))

    def end_after(self, lines: int) -> JournalEnd:
        """End that the journal had after so many lines."""
        sums = ''.join(line.checksum for line in self.lines[:lines])
        return JournalEnd(lines, _digest(sums.encode()).decode() if sums else '')

    @property
    def troubles(self) -> list[tuple[int, str]]:
        """All errors with their line numbers, from 1."""
        found = [(at, line.trouble) for at, line in enumerate(self.lines, 1) if line.trouble]
        return [*found, *([(len(self.lines) + 1, self.trouble)] if self.trouble else [])]


class Journal:
    """An open journal.

    Attributes:
        events: events that it contained when it was opened.
    """

    def __init__(self, path: Path) -> None:
        """Open ``path`` for appending; create it if missing.

        Raises:
            BlockingIOError: another process has it open.
            OSError: it cannot be opened.
            UsageError: ``path:line: message`` if it is damaged; the file is not changed.
        """
        self._path = path
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            content = parse_journal(read_file(path))
            self.events = _sound_events(path, content)
            os.ftruncate(self._fd, content.whole)
        except BaseException:
            self.close()
            raise
        self._size = content.whole

    def append(self, event: Mapping[str, Any]) -> None:
        """Write one line.

        Raises:
            OSError: writing failed, as on a full disk; a partial line is removed.
            RecordError: it was written to a file that was moved or replaced; see
                :meth:`check_in_place`.
        """
        line = journal_line(event)
        try:
            if (written := os.write(self._fd, line)) != len(line):
                raise OSError(None, f'only {written} of {len(line)} bytes fitted')
        except OSError as error:
            os.ftruncate(self._fd, self._size)
            raise disk_error(self._path, error) from error
        except BaseException:
            os.ftruncate(self._fd, self._size)
            raise
        self._size += len(line)
        self.check_in_place()

    def check_in_place(self) -> None:
        """Check that the open file is still the one at its path.

        Raises:
            RecordError: it, or a folder above it, was moved, deleted or replaced. Appended lines
                are in the original file, wherever that is now.
        """
        if not _is_at(self._path, self._fd):
            os.fsync(self._fd)
            raise RecordError(
                f'{self._path}: was moved, deleted or replaced while being written; its records '
                'are in the moved file'
            )

    def sync(self) -> None:
        """Wait until all written lines are on the disk.

        Raises:
            OSError: the disk failed; the error names the file.
        """
        try:
            os.fsync(self._fd)
        except OSError as error:
            raise disk_error(self._path, error) from error

    def close(self) -> None:
        """Close it and release the lock."""
        os.close(self._fd)


def read_journal(path: Path, ended: JournalEnd | None = None) -> list[dict[str, Any]]:
    """Read the events of a journal, even while it is being written.

    An incomplete last line is ignored.

    Args:
        path: path of the journal.
        ended: recorded end, if known; the journal may have grown since.

    Raises:
        OSError: it cannot be read.
        UsageError: ``path:line: message`` for the first error.
    """
    content = parse_journal(read_file(path))
    events = _sound_events(path, content)
    if ended is not None and (why := lost_end(content, ended)):
        raise damaged_line(path, len(content.lines) + 1, why)
    return events


def lost_end(content: JournalContent, ended: JournalEnd) -> str:
    """Why a journal does not contain its recorded end, or ''."""
    if not 0 <= ended.lines <= len(content.lines):
        lost = ended.lines - len(content.lines)
        return f'{lost} of its {ended.lines} lines are missing at its end'
    if content.end_after(ended.lines) != ended:
        return f'its first {ended.lines} lines are not those that it had'
    return ''


def damaged_line(path: Path, number: int, why: str) -> UsageError:
    """The error for a damaged or inconsistent line of a journal."""
    return UsageError(
        f'{path}:{number}: damaged line ({why}); check it with taxinet doctor {path.parent}; '
        'the command that made it goes on with --resume; where it has none, delete the line'
    )


def parse_journal(data: bytes) -> JournalContent:
    """Parse a journal's lines; errors are recorded, not raised."""
    *whole, rest = data.split(b'\n')
    return JournalContent(
        lines=tuple(map(_parsed, whole)), whole=len(data) - len(rest), trouble=_torn_trouble(rest),
    )


def journal_line(event: Mapping[str, Any]) -> bytes:
    """Encode a line with its checksum and newline.

    Args:
        event: values of the line; not empty.
    """
    body = json.dumps(event, separators=(',', ':')).encode()
    return b'{"sum":"%b",%b\n' % (_digest(body), body[1:])


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock a journal against appends by others.

    Raises:
        UsageError: another process has it open.
    """
    with path.open('rb') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UsageError(f'{path}: in use by another process; wait until it ends') from error
        yield


def journal_end(path: Path) -> JournalEnd:
    """End of a journal that this process has just written; nothing is checked.

    Raises:
        OSError: it cannot be read.
    """
    return parse_journal(read_file(path)).end


def _sound_events(path: Path, content: JournalContent) -> list[dict[str, Any]]:
    for number, why in content.troubles:
        raise damaged_line(path, number, why)
    return [line.event for line in content.lines if line.event is not None]


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest()[:_DIGITS].encode()


def _parsed(line: bytes) -> JournalLine:
    found = _LINE.fullmatch(line)
    if found is None:
        return JournalLine(
            event=None, trouble='no checksum: damaged, or written by another version'
        )
    body = b'{' + found[2]
    if _digest(body) != found[1]:
        return JournalLine(event=None, trouble='its checksum differs')
    try:
        return JournalLine(event=load_json(body), checksum=found[1].decode())
    except ValueError as error:
        return JournalLine(event=None, trouble=str(error))


def _torn_trouble(rest: bytes) -> str:
    """Error in the bytes after the last newline, or ''.

    After an interrupted write they are an incomplete object; after a complete one, the newline is
    damaged; zeros are what a file system leaves of lines that were there.
    """
    if b'\0' in rest:
        return 'its end is zeroed'
    try:
        return 'its end is damaged' if isinstance(load_json(rest[:-1]), dict) else ''
    except ValueError:
        return ''


def _is_at(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.stat(path), os.fstat(descriptor))
    except OSError:
        return False


def open_journal(path: Path, command: str) -> Journal:
    """Open a journal for a command that works on its folder.

    Raises:
        UsageError: another such command has it open, it cannot be written, or it is damaged.
    """
    try:
        return Journal(path)
    except BlockingIOError as error:
        raise UsageError(f'{path}: in use by another {command}') from error
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
        """Close it and release the lock."""
        self._journal.close()

    def check_in_place(self) -> None:
        """See :meth:`Journal.check_in_place`."""
        self._journal.check_in_place()
