"""Bags far away: uploaded by fsspec, and brought back into their folder when they are read.

A stored bag's folder holds ``stored.json`` in place of its files, or beside them: where they are,
with size and SHA-256 of each. Nothing is removed here before it was read back from there and found
equal. An upload that was interrupted goes on with the files that are missing; what is there already
under the same name with other content is never overwritten, but for a bag that got frames here.

Credentials come from the environment, as the store's library reads them (``AWS_ACCESS_KEY_ID``,
``AWS_PROFILE``, ``AWS_ENDPOINT_URL``); an address that contains some is refused.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.atomic import disk_error, draft_path, sync_folder
from taxinet_ros.files.sealed_json import file_sha256, read_sealed, write_sealed

STORED_NAME = 'stored.json'
"""File that says where a bag is stored."""

_KINDS = ('s3', 'file', 'gs', 'abfs', 'sftp', 'hdfs')
"""Kinds of stores; other file systems of fsspec hold other things than files, or need options."""
_SECRETS = ('AWS_SECRET_ACCESS_KEY', 'AWS_SESSION_TOKEN', 'AWS_ACCESS_KEY_ID')
_BLOCK_BYTES = 8 << 20

_BEFORE = '.stored'
"""Folder beside the files of a bag for what is stored of it, while the two are compared."""

FileTold = tuple[int, str]
"""Size of a file in bytes, and its SHA-256."""
Replaces = Callable[[Path, Path, frozenset[str]], bool]
"""Whether a bag replaces the stored one: folder of that, of this, and the files that differ."""


@dataclass(frozen=True, kw_only=True)
class StoredBag:
    """Where a bag is stored.

    Attributes:
        url: its folder there.
        files: size in bytes and SHA-256 of each file by name.
    """

    url: str
    files: Mapping[str, FileTold]


def check_store(url: str) -> str:
    """Check the address of a store and that it answers.

    Returns:
        The address without trailing slashes.

    Raises:
        UsageError: it is no address, contains credentials, a package is missing, or it does not
            answer.
    """
    url = url.rstrip('/')
    try:
        _check_address(url)
        _Far(url).check_root()
    except (UsageError, RecordError) as error:
        raise UsageError(f'--store {error}') from error
    return url


def _check_address(url: str) -> None:
    """Check the form of an address, given by a user or a record, before anything is contacted."""
    kind, _, place = url.partition('://')
    if kind not in _KINDS or not place or place.split() != [place] or '::' in place:
        shown = '…' if '@' in url or '?' in url else url
        raise UsageError(
            f'{shown}: expected an address such as s3://BUCKET/FOLDER or file:///FOLDER; known: '
            f'{", ".join(_KINDS)}'
        )
    if any(sign in place for sign in '@?#'):
        raise UsageError(
            f'{kind}://…: an address must not contain credentials or options; set them in the '
            'environment, such as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY'
        )
    if kind == 'file' and not place.startswith('/'):
        raise UsageError(f'{url}: write file:///FOLDER, with three slashes')


def stored_bag(folder: Path) -> StoredBag | None:
    """Where the bag of a run's folder is stored; None if it is not.

    Raises:
        UsageError: its record is damaged.
    """
    path = folder / STORED_NAME
    if not path.is_file():
        return None
    values = read_sealed(path).values
    try:
        files = {str(name): (int(size), str(sha)) for name, (size, sha) in values['files'].items()}
        if any(Path(name).name != name or name == STORED_NAME for name in files):
            raise ValueError('a name is no plain file name')
        _check_address(values['url'])
        return StoredBag(url=values['url'], files=files)
    except (UsageError, LookupError, TypeError, ValueError, AttributeError) as error:
        raise UsageError(f'{path}: damaged ({error})') from error


def bag_files(folder: Path) -> list[Path]:
    """Files of a run's folder by name, without the record of its store."""
    return [
        path for path in sorted(folder.iterdir()) if path.is_file() and path.name != STORED_NAME
    ]


def is_elsewhere(folder: Path) -> bool:
    """Whether files of a run's folder are in a store alone.

    Raises:
        UsageError: its record is damaged.
    """
    stored = stored_bag(folder)
    return stored is not None and not all((folder / name).exists() for name in stored.files)


def store_bag(
    folder: Path, url: str, *, keep: bool = False,
    replaces: Replaces = lambda before, now, names: False,
) -> bool:
    """Upload a bag, verify it there, and remove the files here.

    Args:
        folder: folder of the run.
        url: folder there; that of the run below it has its name.
        keep: do not remove the files here.
        replaces: asked about a stored bag that was changed here.

    Returns:
        Whether anything was uploaded.

    Raises:
        UsageError: another file is there under the same name, the bag was changed here, or a file
            that is not here is missing there.
        RecordError: the store failed; nothing was removed here.
        OSError: the bag cannot be read.
    """
    target, before = f'{url}/{folder.name}', stored_bag(folder)
    files = _files_here(folder)
    there = before.files if before is not None and before.url == target else {}
    far, uploaded = _Far(target), False
    for name in there.keys() - files.keys():
        far.check_there(name, there[name])
    if there and not files:
        return False
    changed = not there or not files.items() <= there.items()
    if changed:
        bring_back(folder)
        files = _files_here(folder)
        _check_change(folder, far, files, there, replaces)
    for name, told in files.items():  # also those stored before: they may be gone there
        uploaded |= far.put(folder / name, told, replaces=there.get(name))
    if changed:
        write_sealed(folder / STORED_NAME, {'url': target, 'files': files})
    if not keep:
        for name in files:
            (folder / name).unlink()
    return uploaded


def check_stored(folder: Path) -> None:
    """Check that the files of a stored bag that are not here are there, by their sizes.

    Raises:
        UsageError: its record is damaged, or a file there is missing or another one.
        RecordError: the store failed.
    """
    stored = stored_bag(folder)
    missing = [name for name in stored.files if not (folder / name).exists()] if stored else []
    if stored is not None and missing:
        far = _Far(stored.url)
        for name in missing:
            far.check_there(name, stored.files[name])


def _check_change(
    folder: Path, far: _Far, files: Mapping[str, FileTold], there: Mapping[str, FileTold],
    replaces: Replaces,
) -> None:
    """Refuse to replace stored files by others, unless ``replaces`` allows it."""
    names = frozenset(name for name in files if files[name] != there.get(name, files[name]))
    if not names:
        return
    before = folder / _BEFORE
    shutil.rmtree(before, ignore_errors=True)
    before.mkdir()
    try:
        for name, told in there.items():  # an interrupted upload has replaced some of them
            done = name in names and far.told(name) == files[name]
            far.get(before / name, files[name] if done else told)
        if not replaces(before, folder, names):
            name = min(names)
            raise UsageError(
                f'{folder / name}: differs from the stored one, {far.url}/{name}, which is never '
                'overwritten; delete it here to get that back, or choose another store'
            )
    finally:
        shutil.rmtree(before, ignore_errors=True)


def _files_here(folder: Path) -> dict[str, FileTold]:
    return {
        path.name: (path.stat().st_size, file_sha256(path)) for path in bag_files(folder)
        if not path.name.startswith('.')
    }


def bring_back(folder: Path) -> None:
    """Download the files of a stored bag that are not in its folder; nothing for other folders.

    Raises:
        UsageError: its record is damaged, or a file there is missing or another one.
        RecordError: the store failed.
        OSError: it cannot be written.
    """
    stored = stored_bag(folder)
    missing = [name for name in stored.files if not (folder / name).exists()] if stored else []
    if stored is None or not missing:
        return
    far = _Far(stored.url)
    for name in missing:
        far.get(folder / name, stored.files[name])
    sync_folder(folder)


class _Far:
    """One folder of a store. Errors of its library become one line without credentials."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._kind = url.partition('://')[0]
        with self._named():
            try:
                import fsspec

                self._fs: Any = fsspec.filesystem(self._kind)
            except (ImportError, ValueError) as error:
                raise UsageError(
                    f'{self._kind}://: {error}; install what it needs with: pip install '
                    "'taxinet_ros[store]'"
                ) from error

    def check_root(self) -> None:
        """Check that the store answers and, if it has buckets, that this one exists."""
        with self._named():
            if self._kind == 's3':
                bucket = self.url.partition('://')[2].partition('/')[0]
                if not self._fs.exists(bucket):
                    raise UsageError(f'{self.url}: no such bucket, or no access to it')
            else:
                self._fs.exists(self.url)

    def told(self, name: str) -> FileTold | None:
        """Size and SHA-256 of a file, by reading it; None if there is none."""
        sha256, size = hashlib.sha256(), 0
        try:
            for block in self._blocks(name):
                sha256.update(block)
                size += len(block)
        except _MissingError:
            return None
        return size, sha256.hexdigest()

    def check_there(self, name: str, told: FileTold) -> None:
        """Check that a file is there and has its size, without reading it.

        Raises:
            UsageError: it is missing, or another one.
        """
        with self._named():
            self._fs.invalidate_cache()
            try:
                size = self._fs.info(f'{self.url}/{name}')['size']
            except FileNotFoundError:
                raise UsageError(f'{self.url}/{name}: is missing in the store and here') from None
        if size != told[0]:
            raise UsageError(
                f'{self.url}/{name}: is not the file that was stored ({size} bytes, not {told[0]})'
            )

    def put(self, path: Path, told: FileTold, *, replaces: FileTold | None = None) -> bool:
        """Upload a file unless it is there, and verify it; whether it was uploaded."""
        far = f'{self.url}/{path.name}'
        there = self.told(path.name)
        if there == told:
            return False
        if there is not None and there != replaces:
            raise UsageError(
                f'{far}: another file is there already; recordings are never overwritten, choose '
                'another --store'
            )
        with self._named():
            if self._kind == 'file':  # a file there would be visible before it is complete
                self._fs.makedirs(self.url, exist_ok=True)
                self._fs.put_file(str(path), f'{far}.part')
                self._fs.mv(f'{far}.part', far)
            else:
                self._fs.put_file(str(path), far)
        if self.told(path.name) != told:
            raise RecordError(f'{far}: reads back differently from what was uploaded')
        return True

    def get(self, path: Path, told: FileTold) -> None:
        """Download a file atomically; it must be the one recorded."""
        draft = draft_path(path).with_suffix(f'.{os.getpid()}')
        sha256, size = hashlib.sha256(), 0
        try:
            with draft.open('xb') as file:
                for block in self._blocks(path.name):
                    sha256.update(block)
                    size += len(block)
                    if size > told[0]:
                        break
                    file.write(block)
                file.flush()
                os.fsync(file.fileno())
            if (size, sha256.hexdigest()) != told:
                raise UsageError(
                    f'{self.url}/{path.name}: is not the file that was stored (its SHA-256 differs)'
                )
            draft.replace(path)
        except _MissingError:
            raise UsageError(f'{self.url}/{path.name}: is missing in the store') from None
        except OSError as error:
            raise disk_error(path, error) from error
        finally:
            draft.unlink(missing_ok=True)

    def _blocks(self, name: str) -> Iterator[bytes]:
        with self._named():
            self._fs.invalidate_cache()
            try:
                with self._fs.open(f'{self.url}/{name}', 'rb', block_size=_BLOCK_BYTES) as file:
                    while block := file.read(_BLOCK_BYTES):
                        yield block
            except FileNotFoundError as error:
                raise _MissingError from error

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        """Turn the errors of the store's library into one line that names the address."""
        try:
            yield
        except (UsageError, _MissingError):
            raise
        except Exception as error:  # each kind of store has its own
            text = f'{type(error).__name__}: {error}'
            for secret in filter(None, map(os.environ.get, _SECRETS)):
                text = text.replace(secret, '…')
            raise RecordError(f'{self.url}: {" ".join(text.split())}') from error


class _MissingError(Exception):
    """There is no such file in the store."""
