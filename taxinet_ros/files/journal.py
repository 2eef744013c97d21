"""Append-only JSON Lines file with checksums, written by one process at a time.

Each line begins with 64 hexadecimal digits under the key ``chain``. The first 32 are the link, a
digest of the previous line's link and the rest of this line; the last 32 are a digest of this line
alone. This detects and distinguishes changed bits and missing, repeated or moved lines.

An incomplete last line is removed when the file is opened: its write was interrupted and never
confirmed. Missing complete lines at the end are detected by comparison with a recorded end
(:class:`JournalEnd`).

Lines of earlier versions have no checksums. If a journal begins with such lines, a digest of all of
them serves as the link before the first line added to it.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from taxinet_ros.errors import RecordError, UsageError, warn_once
from taxinet_ros.files.atomic import disk_error
from taxinet_ros.files.plain_values import load_json
from taxinet_ros.files.reading import read_file

_DIGITS = 32
_LINE = re.compile(rb'\{"chain":"([0-9a-f]{32})([0-9a-f]{32})",(.+\})', re.DOTALL)


_START = hashlib.sha256().hexdigest()[:_DIGITS]
"""Link before the first line: the digest of empty input."""


class JournalEnd(NamedTuple):
    """End of a journal: number of lines, and link of the last."""

    lines: int
    link: str


@dataclass(frozen=True, kw_only=True, slots=True)
class JournalLine:
    """One complete line of a journal.

    Attributes:
        event: its values, without the checksums; None if it is damaged.
        link: its link; '' in a line that is damaged or of an earlier version.
        trouble: error of the line or its position, or ''.
    """

    event: dict[str, Any] | None
    link: str = ''
    trouble: str = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class JournalContent:
    """Content of a journal.

    Attributes:
        lines: all complete lines.
        unprotected: number of initial lines without checksums and without known damage.
        links: link after each number of lines, starting at zero lines.
        whole: number of bytes up to the end of the last complete line.
        trouble: error in the bytes after them, or ''.
    """

    lines: tuple[JournalLine, ...] = ()
    unprotected: int = 0
    links: tuple[str, ...] = (_START,)
    whole: int = 0
    trouble: str = ''

    @property
    def end(self) -> JournalEnd:
        """End of the journal."""
        return JournalEnd(len(self.lines), self.links[-1])

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
        self._size, self._link = content.whole, content.end.link

    def append(self, event: Mapping[str, Any]) -> None:
        """Write one line.

        Raises:
            OSError: writing failed, as on a full disk; a partial line is removed.
            RecordError: it was written to a file that was moved or replaced; see
                :meth:`check_in_place`.
        """
        line, link = chained_line(self._link, event)
        try:
            if (written := os.write(self._fd, line)) != len(line):
                raise OSError(None, f'only {written} of {len(line)} bytes fitted')
        except OSError as error:
            os.ftruncate(self._fd, self._size)
            raise disk_error(self._path, error) from error
        except BaseException:
            os.ftruncate(self._fd, self._size)
            raise
        self._size, self._link = self._size + len(line), link
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
    if content.links[ended.lines] not in ('', ended.link):
        return f'its first {ended.lines} lines are not those that it had'
    return ''


def damaged_line(path: Path, number: int, why: str) -> UsageError:
    """The error for a damaged or inconsistent line of a journal."""
    return UsageError(
        f'{path}:{number}: damaged line ({why}); check and repair with: taxinet doctor '
        f'{path.parent}'
    )


def parse_journal(data: bytes) -> JournalContent:
    """Parse a journal's lines; errors are recorded, not raised."""
    *whole, rest = data.split(b'\n')
    parsed = [_parsed(line) for line in whole]
    first = next((at for at, line in enumerate(parsed) if line.link), len(parsed))
    old = sum(not line.trouble for line in parsed[:first])
    before = sum(len(line) + 1 for line in whole[:first])
    # The link of a damaged line is unknown.
    links = [_digest(data[:before]) if old == first else ''] * (first + 1)
    links += [line.link for line in parsed[first:]]
    lines = [
        line if line.trouble or at < first else _placed(at, line, whole[at], links)
        for at, line in enumerate(parsed)
    ]
    return JournalContent(
        lines=tuple(lines), unprotected=old, links=tuple(links),
        whole=len(data) - len(rest), trouble=_torn_trouble(rest),
    )


def chained_line(before: str, event: Mapping[str, Any]) -> tuple[bytes, str]:
    """Encode a line with its checksums and newline; also return its link.

    Args:
        before: link of the previous line.
        event: values of the line; not empty.
    """
    body = json.dumps(event, separators=(',', ':')).encode()
    link = _digest(before.encode() + body)
    own = _digest(link.encode() + body)
    return b'{"chain":"%b%b",%b\n' % (link.encode(), own.encode(), body[1:]), link


def journal_end(path: Path) -> JournalEnd:
    """End of a journal that this process has just written; nothing is checked.

    Raises:
        OSError: it cannot be read.
    """
    return parse_journal(read_file(path)).end


def _sound_events(path: Path, content: JournalContent) -> list[dict[str, Any]]:
    for number, why in content.troubles:
        raise damaged_line(path, number, why)
    if content.unprotected:
        warn_once(
            f'{path}: its first {content.unprotected} lines were written by an earlier version '
            'without checksums, so it is unprotected: damage to them may go unnoticed'
        )
    return [line.event for line in content.lines if line.event is not None]


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:_DIGITS]


def _parsed(line: bytes) -> JournalLine:
    """Parse a line independently of its position."""
    found = _LINE.fullmatch(line)
    if found is None:
        return _unchained(line)
    link, own, body = found[1], found[2], b'{' + found[3]
    if _digest(link + body).encode() != own:
        return JournalLine(event=None, trouble='its checksum differs')
    try:
        return JournalLine(event=load_json(body), link=link.decode())
    except ValueError as error:
        return JournalLine(event=None, trouble=str(error))


def _unchained(line: bytes) -> JournalLine:
    """Parse a line that does not begin with checksums.

    No single-bit error makes a line with checksums look like one of an earlier version, whose first
    value was never a text of that length.
    """
    try:
        event = load_json(line)
    except ValueError as error:
        return JournalLine(event=None, trouble=str(error))
    if not isinstance(event, dict):
        return JournalLine(event=None, trouble='it is no object')
    first = next(iter(event.values()), '')
    if 'chain' in event or (isinstance(first, str) and len(first) == 2 * _DIGITS):
        return JournalLine(event=None, trouble='its checksum is damaged')
    return JournalLine(event=event)


def _placed(at: int, line: JournalLine, raw: bytes, links: Sequence[str]) -> JournalLine:
    """An intact line, with any error of its position."""
    if not line.link:
        why = 'it has no checksum, but earlier lines have; was it written by an earlier version?'
        return JournalLine(event=line.event, trouble=why)
    body = b'{' + raw[len(b'{"chain":"",') + 2 * _DIGITS:]

    def follows(before: str) -> bool:
        return _digest(before.encode() + body) == line.link

    if follows(links[at]) or not links[at]:
        return line
    if line.link in links[:at + 1]:
        why = f'it occurs twice, first as line {links.index(line.link)}'
    elif follows(_START):
        why = 'it was the first line: something was inserted before it'
    elif (other := next((n for n, link in enumerate(links) if follows(link)), None)) is not None:
        why = f'it belongs after line {other}: lines are missing or reordered'
    else:
        why = 'lines before it are missing'
    return JournalLine(event=line.event, link=line.link, trouble=why)


def _torn_trouble(rest: bytes) -> str:
    """Error in the bytes after the last newline, or ''.

    After an interrupted write they are an incomplete object; after a complete one, the newline is
    damaged.
    """
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
