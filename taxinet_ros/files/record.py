"""Record of a campaign, of trials or of a study: one SQLite file, written by one command at a time.

An entry has a kind, a key and plain values. Each change is one transaction, on the disk before the
method returns; the rollback journal leaves one plain file that can be copied and read anywhere,
which write-ahead logging would not. A crash therefore leaves the entries before or after a change.
While the file is open for writing, one journal is used again and again, which takes less time than
to make and remove one for each change.

Each entry has a digest, and the file has their number and the digest of all of them, so a flipped
bit, a lost entry and a torn file are found when it is read. A file that somebody replaced by an
older copy of itself is not: ``taxinet doctor`` compares it with the bags.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import json
import os
import shutil
import sqlite3
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import quote

from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.atomic import disk_error, make_folder, sync_folder

RECORD_NAME = 'campaign.db'
_APPLICATION_ID = 0x54584E54
_VERSION = 1
_SCHEMA = (
    f'PRAGMA application_id = {_APPLICATION_ID}',
    f'PRAGMA user_version = {_VERSION}',
    'CREATE TABLE entries (kind TEXT NOT NULL, key TEXT NOT NULL, value TEXT NOT NULL, '
    'digest BLOB NOT NULL, PRIMARY KEY (kind, key))',
    'CREATE TABLE total (number INTEGER NOT NULL, digest BLOB NOT NULL)',
)
_BUSY_S = 20.0
_DIGEST_BYTES = 16
_MOST_BYTES = 1 << 40
_JOURNAL = bytes.fromhex('d9d505f920a163d7')
_LOST = 'lost'
"""Kind of the entry of a record that was damaged, until its command has ended in good order."""

Entries = dict[str, dict[str, Any]]
"""Values by kind and key, in the order of the keys."""


class Record:
    """An open record. A context manager."""

    def __init__(self, path: Path, *, create: bool = True, as_text: Collection[str] = ()) -> None:
        """Open a record for writing.

        Args:
            path: its file.
            create: whether it may be created, with its folder.
            as_text: kinds whose values are left as JSON in :attr:`entries`, to be read later.

        Raises:
            UsageError: another command writes it, or it is damaged or of another version.
            OSError: it cannot be opened or created there.
        """
        self._path = path
        self._connection: sqlite3.Connection | None = None
        if create:
            make_folder(path.parent)
        self._lock = _lock(path)
        try:
            with _named(path):
                self._connection = _connect(path, 'rwc' if create else 'rw')
                self._inode = _inode(path)
                self._connection.execute('PRAGMA journal_mode = PERSIST')
                _begin(self._connection)
            sync_folder(path.parent)
            self._entries = _checked(path, self._connection, as_text)
            self._total = _total(self._connection)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def path(self) -> Path:
        """Its file."""
        return self._path

    @property
    def entries(self) -> Entries:
        """The entries that it contained when it was opened."""
        return self._entries

    def put(self, kind: str, key: str, values: Any) -> None:
        """Write one entry; raises as :meth:`put_all`."""
        self.put_all([(kind, key, values)])

    def put_all(self, entries: Iterable[tuple[str, str, Any]]) -> None:
        """Write or replace entries by kind and key, all or none of them.

        Raises:
            OSError: they cannot be written, as on a full disk.
            RecordError: the file was moved, deleted or replaced.
        """
        self._change([(kind, key, _text(values)) for kind, key, values in entries])

    def remove(self, kind: str) -> None:
        """Remove all entries of a kind. Raises as :meth:`put_all`."""
        if gone := [(kind, key, None) for key in self.keys(kind)]:
            self._change(gone)

    def keys(self, kind: str) -> list[str]:
        """Keys of its entries of a kind, in order."""
        with _named(self._path):
            found = self._open().execute(
                'SELECT key FROM entries WHERE kind = ? ORDER BY key', (kind,)
            )
            return [str(key) for key, in found]

    def check_in_place(self) -> None:
        """Check that the file is where it was opened.

        Raises:
            RecordError: it was moved, deleted or replaced.
        """
        if _inode(self._path) != self._inode:
            raise RecordError(
                f'{self._path}: was moved, deleted or replaced while it was being written'
            )

    def close(self) -> None:
        """Close it; a second call has no effect."""
        if self._connection is not None:
            # The journal may stay, as after a killed command, but is no other record's.
            with contextlib.suppress(sqlite3.Error, RecordError):
                self.check_in_place()
                self._connection.execute('PRAGMA journal_mode = DELETE')
            self._connection.close()
            self._connection = None
        if self._lock >= 0:
            _unlock(self._path, self._lock)
            self._lock = -1

    def _open(self) -> sqlite3.Connection:
        assert self._connection is not None
        return self._connection

    def _change(self, entries: Iterable[tuple[str, str, str | None]]) -> None:
        connection = self._open()
        number, total = self._total
        with self._in_place(), _named(self._path), _transaction(connection):
            for kind, key, value in entries:
                found = connection.execute(
                    'SELECT digest FROM entries WHERE kind = ? AND key = ?', (kind, key)
                ).fetchone()
                if found is not None:
                    number, total = number - 1, _xor(total, found[0])
                if value is None:
                    connection.execute(
                        'DELETE FROM entries WHERE kind = ? AND key = ?', (kind, key)
                    )
                    continue
                digest = _digest(kind, key, value)
                number, total = number + 1, _xor(total, digest)
                connection.execute(
                    'INSERT OR REPLACE INTO entries VALUES (?, ?, ?, ?)', (kind, key, value, digest)
                )
            done = connection.execute(
                'UPDATE total SET number = ?, digest = ? WHERE number = ? AND digest = ?',
                (number, total, *self._total),
            )
            if done.rowcount != 1:
                raise RecordError(f'{self._path}: was changed by another program')
        self._total = number, total

    @contextlib.contextmanager
    def _in_place(self) -> Iterator[None]:
        """Context for writing; a file that is gone is named before what follows from it."""
        try:
            yield
        finally:
            self.check_in_place()


def read_record(path: Path, as_text: Collection[str] = ()) -> Entries:
    """Read a record, even while it is being written.

    Args:
        path: its file.
        as_text: kinds of entries whose values are left as JSON, to be read later.

    Raises:
        UsageError: there is none, it is damaged or of another version, or it was damaged and its
            command has not been continued to its end.
    """
    if not path.is_file():
        raise UsageError(f'{path}: no such file')
    entries = _read(path, as_text)
    for why in entries.get(_LOST, {}).values():
        raise UsageError(f'{path}: was damaged ({why}); resume it to its end')
    return entries


def read_entry(path: Path, kind: str, key: str = '') -> Any:
    """Read one entry of a record, however large that is; None if there is none.

    Raises:
        UsageError: there is no such record, or it is damaged or of another version.
    """
    for text in read_texts(path, kind, [key]).values():
        return json.loads(text)
    return None


def read_texts(path: Path, kind: str, keys: Iterable[str]) -> dict[str, str]:
    """Those of some entries that are there, as JSON by key; raises as :func:`read_entry`."""
    if not path.is_file():
        raise UsageError(f'{path}: no such file')
    found = {}
    with _named(path), contextlib.closing(_connect(path, 'ro')) as connection:
        _check_version(path, connection)
        for key in keys:
            one = connection.execute(f'{_ALL} WHERE kind = ? AND key = ?', (kind, key)).fetchone()
            if one is not None:
                if not _is_intact(*one):
                    raise UsageError(f'{path}: damaged (entry {kind} {key!r:.80})')
                found[key] = str(one[2])
    return found


def record_kinds(path: Path) -> set[str]:
    """Kinds of the entries of a record, also where its index is damaged.

    Raises:
        UsageError: it is damaged or of another version.
    """
    with _named(path), contextlib.closing(_connect(path, 'ro')) as connection:
        _check_version(path, connection)
        return {str(kind) for kind, in connection.execute('SELECT kind FROM entries NOT INDEXED')}


def repair_record(path: Path) -> str:
    """Keep what is intact of a damaged record, before its command continues.

    The damaged file is kept as a copy. :func:`read_record` refuses the new one until
    :func:`repaired` is called, as entries may be missing. A file that is not there, or has nothing
    in it, needs no repair.

    Returns:
        A line on what was damaged, or ''.

    Raises:
        UsageError: another command writes it, or nothing of it can be read.
        OSError: a file cannot be read or written.
    """
    if not path.is_file() or path.stat().st_size == 0:
        return ''
    lock = _lock(path)
    try:
        try:
            _read(path)
            return ''
        except UsageError as error:
            if path.stat().st_size == 0:  # rolled back to before its first entry
                return ''
            if _is_of_another_version(path):
                raise
            why = str(error).removeprefix(f'{path}: damaged (').removesuffix(')')
        draft = path.with_name(f'.{path.stem}.part{path.suffix}')
        Path(f'{draft}-journal').unlink(missing_ok=True)  # of a repair that was killed
        shutil.copyfile(path, draft)
        _lengthen(draft)
        entries = _intact(draft)
        draft.unlink()
        Path(f'{draft}-journal').unlink(missing_ok=True)
        if not entries:
            raise UsageError(
                f'{path}: damaged ({why}), and no entry of it can be read; choose another folder'
            )
        number = 1
        while (copy := path.with_name(f'{path.name}.damaged-{number}')).exists():
            number += 1
        shutil.copyfile(path, copy)
        with _named(draft):
            connection = _connect(draft, 'rwc')
            with contextlib.closing(connection):
                _begin(connection)
                with _transaction(connection):
                    _fill(connection, [*entries, (_LOST, '', _text(why))])
        Path(f'{path}-journal').unlink(missing_ok=True)
        draft.replace(path)
        sync_folder(path.parent)
        return f'{path}: damaged ({why}); kept as {copy.name}; what it lacks is made again'
    finally:
        _unlock(path, lock)


def repaired(record: Record) -> None:
    """Note that a damaged record is complete again. Raises as :meth:`Record.put_all`."""
    record.remove(_LOST)


def examine_record(path: Path, as_text: Collection[str] = ()) -> Entries:
    """Read a record after SQLite's integrity check; raises as :func:`read_record`."""
    with _named(path), contextlib.closing(_connect(path, 'ro')) as connection:
        found = [str(line) for line, in connection.execute('PRAGMA integrity_check')]
    entries = read_record(path, as_text)
    if found != ['ok']:
        raise UsageError(f'{path}: damaged ({found[0]:.80})')
    return entries


@contextlib.contextmanager
def no_writer(path: Path) -> Iterator[bool]:
    """Context in which no command may begin to write a record; False if one writes it already."""
    try:
        lock = _lock(path)
    except UsageError:
        yield False
    except OSError:  # nothing may be written here
        yield True
    else:
        try:
            yield True
        finally:
            _unlock(path, lock)


# SQLite -----------------------------------------------------------------------------------------


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    _check_journal(path)
    if mode == 'ro' and os.access(path.parent, os.W_OK) and os.access(path, os.W_OK):
        mode = 'rw'  # so that what a killed command left half written is rolled back
    connection = sqlite3.connect(
        f'file:{quote(str(path.absolute()))}?mode={mode}', uri=True, timeout=_BUSY_S,
        isolation_level=None, check_same_thread=False,
    )
    connection.execute('PRAGMA synchronous = EXTRA')
    return connection


def _check_journal(path: Path) -> None:
    """Refuse a rollback journal of an earlier state than the file's, such as one copied before it.

    SQLite would undo by it what was recorded since. Both have SQLite's count of changes: the file
    in its header, the journal in its copy of the first page (SQLite, database file format).
    """
    path = path.resolve()
    try:
        with path.open('rb') as file:  # first, as a running campaign writes both
            now = file.read(28)[24:]
        with open(f'{path}-journal', 'rb') as file:
            header = file.read(28)
            sector, page = (int.from_bytes(header[at:at + 4]) for at in (20, 24))
            file.seek(sector)
            for _ in range(int.from_bytes(header[8:12])):  # behind them are older ones
                record = file.read(page + 8)
                if len(record) < page + 8 or page < 28:
                    return
                if int.from_bytes(record[:4]) == 1:
                    before = int.from_bytes(record[28:32])
                    if header[:8] == _JOURNAL and int.from_bytes(now) > before + 1:
                        raise UsageError(
                            f'{path}-journal: is of an earlier state than {path.name}; was it '
                            'copied before it? Delete it'
                        )
                    return
    except FileNotFoundError:
        return


def _begin(connection: sqlite3.Connection) -> None:
    """Make the tables of a new file."""
    tables = connection.execute('SELECT count(*) FROM sqlite_master').fetchone()[0]
    if tables == 0 and connection.execute('PRAGMA user_version').fetchone()[0] == 0:
        with _transaction(connection):
            for statement in _SCHEMA:
                connection.execute(statement)
            connection.execute('INSERT INTO total VALUES (0, ?)', (bytes(_DIGEST_BYTES),))


def _fill(
    connection: sqlite3.Connection, entries: Iterable[tuple[str, str, str]]
) -> None:
    number, total = 0, bytes(_DIGEST_BYTES)
    for kind, key, value in entries:
        digest = _digest(kind, key, value)
        number, total = number + 1, _xor(total, digest)
        connection.execute('INSERT INTO entries VALUES (?, ?, ?, ?)', (kind, key, value, digest))
    connection.execute('UPDATE total SET number = ?, digest = ?', (number, total))


@contextlib.contextmanager
def _transaction(connection: sqlite3.Connection) -> Iterator[None]:
    connection.execute('BEGIN IMMEDIATE')
    try:
        yield
        connection.execute('COMMIT')
    except BaseException:
        with contextlib.suppress(sqlite3.Error):
            connection.execute('ROLLBACK')
        raise


def _read(path: Path, as_text: Collection[str] = ()) -> Entries:
    if path.stat().st_size == 0:
        raise UsageError(_EMPTY.format(path))
    try:
        with _named(path), contextlib.closing(_connect(path, 'ro')) as connection:
            return _checked(path, connection, as_text)
    except OSError as error:
        if error.errno != errno.EROFS:
            raise
        raise UsageError(
            f'{path}: a killed command left {path.name}-journal, and nothing may be written here; '
            'copy the folder to where that is allowed'
        ) from error


def _checked(path: Path, connection: sqlite3.Connection, as_text: Collection[str]) -> Entries:
    """All entries, in one view of the file; their digests and number are checked."""
    found: Entries = {}
    number, total = 0, 0
    with _named(path):
        connection.execute('BEGIN')
        try:
            _check_version(path, connection)
            for kind, key, value, digest in connection.execute(f'{_ALL} ORDER BY kind, key'):
                if not _is_intact(kind, key, value, digest):
                    raise UsageError(f'{path}: damaged (entry {kind} {key!r:.80})')
                number, total = number + 1, total ^ int.from_bytes(digest)
                values = value if kind in as_text else json.loads(value)
                found.setdefault(kind, {})[key] = values
            if _total(connection) != (number, total.to_bytes(_DIGEST_BYTES)):
                raise UsageError(f'{path}: damaged (entries are missing or exchanged)')
        finally:
            with contextlib.suppress(sqlite3.Error):
                connection.execute('COMMIT')
    return found


_ALL = 'SELECT kind, key, value, digest FROM entries'
_EMPTY = '{}: has no entry; has its command just begun, was it killed so, or the file cut?'


def _lengthen(path: Path) -> None:
    """Give a torn file the size that its header says; SQLite reads nothing of a shorter one."""
    with path.open('rb') as file:
        header = file.read(32)
    size = int.from_bytes(header[16:18]) * int.from_bytes(header[28:32])
    if path.stat().st_size < size < _MOST_BYTES:
        os.truncate(path, size)


def _intact(path: Path) -> list[tuple[str, str, str]]:
    """The entries of a damaged file that can be read and have their digest."""
    found: dict[tuple[str, str], str] = {}
    for order in ('', ' DESC'):  # from both ends, up to the damage; the index may be damaged too
        with contextlib.suppress(sqlite3.Error, OSError, UnicodeError), contextlib.closing(
            _connect(path, 'ro')
        ) as connection:
            rows = connection.execute(f'{_ALL} NOT INDEXED ORDER BY rowid{order}')
            for kind, key, value, digest in rows:
                if _is_intact(kind, key, value, digest) and kind != _LOST:
                    found.setdefault((kind, key), value)
    return [(kind, key, value) for (kind, key), value in sorted(found.items())]


def _is_intact(kind: Any, key: Any, value: Any, digest: Any) -> bool:
    texts = type(kind) is type(key) is type(value) is str  # not isinstance, as rows are many
    return texts and digest == _digest(kind, key, value)


def _check_version(path: Path, connection: sqlite3.Connection) -> None:
    application, = connection.execute('PRAGMA application_id').fetchone()
    version, = connection.execute('PRAGMA user_version').fetchone()
    if (application, version) == (0, 0) and not connection.execute(
        'SELECT count(*) FROM sqlite_master'
    ).fetchone()[0]:
        raise UsageError(_EMPTY.format(path))
    if (application, version) != (_APPLICATION_ID, _VERSION):
        raise UsageError(
            f'{path}: not a record of this version of taxinet_ros (format {version}, expected '
            f'{_VERSION}); read it with the version that wrote it'
        )


def _is_of_another_version(path: Path) -> bool:
    """Whether a file is whole but no record of this version."""
    try:
        with contextlib.closing(_connect(path, 'ro')) as connection:
            _check_version(path, connection)
            connection.execute('SELECT 1 FROM entries, total LIMIT 1').fetchone()
    except UsageError:
        return True
    except (sqlite3.Error, OSError):
        return False
    return False


def _total(connection: sqlite3.Connection) -> tuple[int, bytes]:
    rows = connection.execute('SELECT number, digest FROM total').fetchall()
    if len(rows) != 1 or not isinstance(rows[0][1], bytes) or len(rows[0][1]) != _DIGEST_BYTES:
        raise sqlite3.DatabaseError('the number of its entries is damaged')
    return int(rows[0][0]), rows[0][1]


def _text(values: Any) -> str:
    return json.dumps(values, separators=(',', ':'))


def _digest(kind: str, key: str, value: str) -> bytes:
    return hashlib.sha256(f'{kind}\0{key}\0{value}'.encode()).digest()[:_DIGEST_BYTES]


def _xor(one: bytes, other: bytes) -> bytes:
    return (int.from_bytes(one) ^ int.from_bytes(other)).to_bytes(_DIGEST_BYTES)


def _inode(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError:
        return (0, 0)
    return (found.st_dev, found.st_ino)


def _lock(path: Path) -> int:
    """Lock a record until :func:`_unlock`, for all machines that see it.

    A file beside it is locked. SQLite's own locks end with every close of the record in this
    process, and a lock of the folder would hold on this machine only: network file systems pass on
    those of files (Linux, ``fs/nfs/dir.c`` has no ``flock``).
    """
    file = _lock_file(path)
    while True:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            raise UsageError(f'{path}: another command is writing to it') from None
        except OSError as error:
            _unlock(path, descriptor)
            raise UsageError(_NO_LOCKS.format(path, error.strerror)) from error
        status = os.fstat(descriptor)
        if _inode(file) == (status.st_dev, status.st_ino):
            return descriptor
        os.close(descriptor)  # the command that held it has just removed it


def _unlock(path: Path, descriptor: int) -> None:
    with contextlib.suppress(OSError):  # it may stay, as after a killed command
        _lock_file(path).unlink()
    os.close(descriptor)


def _lock_file(path: Path) -> Path:
    path = path.resolve()
    return path.with_name(f'.{path.name}.lock')


_NO_LOCKS = (
    '{}: its file system locks no files ({}), so commands could overwrite the entries of each '
    'other; choose a folder on another, or mount it with locks'
)


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    """Context in which errors of SQLite become those of the file."""
    try:
        yield
    except sqlite3.OperationalError as error:
        name = getattr(error, 'sqlite_errorname', '')
        codes = {
            'FULL': errno.ENOSPC, 'READONLY': errno.EROFS, 'CANTOPEN': errno.EACCES,
            'BUSY': errno.EBUSY, 'LOCKED': errno.EBUSY,
        }
        if name.startswith('SQLITE_IOERR') and 'LOCK' in name:
            raise UsageError(_NO_LOCKS.format(path, error)) from error
        for word, code in codes.items():
            if name.startswith(f'SQLITE_{word}'):
                raise OSError(code, os.strerror(code), str(path)) from error
        if name.startswith('SQLITE_IOERR'):
            raise disk_error(path, OSError(errno.EIO, str(error))) from error
        raise UsageError(f'{path}: damaged ({error!s:.80})') from error
    except (sqlite3.DatabaseError, UnicodeError) as error:
        raise UsageError(f'{path}: damaged ({error!s:.80})') from error


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values as they are read back from a record: tuples are lists, keys are texts."""
    return dict(json.loads(_text(values)))
