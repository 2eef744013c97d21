"""Append-only JSON Lines file with checksums, written by one process at a time.

Each line begins with its checksums, in 64 hexadecimal digits under the key ``chain``: the first 32
are the link, a digest of the link of the line before and of this line's other words; the last 32 a
digest of this line alone. So a changed bit, and a line that is missing, there twice or in another
place, is found and told apart from the others.

A last line without its end is cut off when the file is opened: its write was interrupted, and was
never confirmed. Missing whole lines at the end are detected by comparison with a recorded end
(:class:`JournalEnd`).

Lines of earlier versions have no checksums. Where a journal begins with such lines, the first one
that is added has a digest of all of them for the link before it.
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

_DIGITS = 32
_LINE = re.compile(rb'\{"chain":"([0-9a-f]{32})([0-9a-f]{32})",(.+\})', re.DOTALL)


_START = hashlib.sha256().hexdigest()[:_DIGITS]
"""Link before the first line: the digest of nothing."""


class JournalEnd(NamedTuple):
    """End of a journal: number of lines, and link of the last."""

    lines: int
    link: str


@dataclass(frozen=True, kw_only=True, slots=True)
class JournalLine:
    """One whole line of a journal.

    Attributes:
        event: its values, without the checksums; None where it is damaged.
        link: its link; '' in a line of an earlier version and in one that is damaged.
        trouble: what is wrong with it or with its place, or ''.
    """

    event: dict[str, Any] | None
    link: str = ''
    trouble: str = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class JournalContent:
    """Content of a journal.

    Attributes:
        lines: all whole lines.
        unprotected: number of initial lines without checksums and without known damage.
        links: the link after each number of lines, from none on.
        whole: number of bytes up to the end of the last whole line.
        trouble: what is wrong with the bytes after them, or ''.
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
        events: what the lines said that it held when it was opened.
    """

    def __init__(self, path: Path) -> None:
        """Open ``path`` to append, making it if need be.

        Raises:
            BlockingIOError: another process has it open.
            OSError: it cannot be opened.
            UsageError: ``path:line: message`` where it is damaged; it is left as it is.
        """
        self._path = path
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            content = parse_journal(path.read_bytes())
            self.events = _sound_events(path, content)
            os.ftruncate(self._fd, content.whole)
        except BaseException:
            self.close()
            raise
        self._size, self._link = content.whole, content.end.link

    def append(self, event: Mapping[str, Any]) -> None:
        """Write one line.

        Raises:
            OSError: not all of it could be written, as on a full disk; then none of it is.
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
            RecordError: it, or a folder above it, was moved, deleted or replaced. What was appended
                is in the file all the same, wherever that is now.
        """
        if not _is_at(self._path, self._fd):
            os.fsync(self._fd)
            raise RecordError(
                f'{self._path}: was moved, deleted or replaced while being written; its records '
                'are in the moved file'
            )

    def sync(self) -> None:
        """Wait until what was written has reached the disk.

        Raises:
            OSError: it has not, with the file's name.
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

    A last line without its end is ignored.

    Args:
        path: path of the journal.
        ended: where it ended once, if that is known; it may have grown since.

    Raises:
        OSError: it cannot be read.
        UsageError: ``path:line: message`` on the first thing that is wrong.
    """
    content = parse_journal(path.read_bytes())
    events = _sound_events(path, content)
    if ended is not None and (why := lost_end(content, ended)):
        raise damaged_line(path, len(content.lines) + 1, why)
    return events


def lost_end(content: JournalContent, ended: JournalEnd) -> str:
    """What is wrong with a journal that ended there once, or ''."""
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
    """A line with its checksums and its end, and its link.

    Args:
        before: link of the line before.
        event: what it is to say; not empty.
    """
    body = json.dumps(event, separators=(',', ':')).encode()
    link = _digest(before.encode() + body)
    own = _digest(link.encode() + body)
    return b'{"chain":"%b%b",%b\n' % (link.encode(), own.encode(), body[1:]), link


def journal_end(path: Path) -> JournalEnd:
    """Where a journal ends that this process has just written; nothing is checked.

    Raises:
        OSError: it cannot be read.
    """
    return parse_journal(path.read_bytes()).end


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
    """A line by itself."""
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
    """A line that does not begin as those with checksums do.

    No one bit makes one with checksums look like one of an earlier version, whose first value was
    never a text of as many letters.
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
    """What is wrong with the bytes after the last end of a line, or ''.

    Those of a line that was not written to its end are no whole object, nor is there more of it.
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
