"""What an unfinished data set or training was asked for and has made, to go on with --resume.

It is a record, ``progress.db``, in their folder, with one entry per picture.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from taxinet_ros.errors import RecordError, UsageError, warn_once
from taxinet_ros.files.atomic import FULL_DISK
from taxinet_ros.files.record import Record, plain, repair_record, repaired
from taxinet_ros.scenes.programs import check_same_files

NAME = 'progress.db'
_REQUEST, _PICTURE = 'request', 'picture'
FLUSH_S = 0.5
"""Pictures of so long are written at once, as each write waits for the disk."""


def is_begun(folder: Path) -> bool:
    """Whether there is something to go on with in a folder."""
    path = folder / NAME
    return path.is_file() and path.stat().st_size > 0


def check_request(
    command: str, folder: Path, begun: Mapping[str, Any], request: Mapping[str, Any]
) -> None:
    """Check that what was begun in a folder had the same request.

    Raises:
        UsageError: it had not, by the name of the option.
    """
    check_same_files(f'{command}: resume: {folder}', begun, request)
    for name, value in plain(request).items():
        before = begun.get(name)
        if before != value:
            raise UsageError(
                f'{command}: resume: {folder} was begun with {name} {before}, not {value}; '
                'repeat its options, or choose another out'
            )


class Unfinished:
    """The open record of an unfinished command. A context manager.

    Attributes:
        made: values of each picture by its number, from earlier attempts.
    """

    def __init__(
        self, command: str, folder: Path, request: Mapping[str, Any], *, resume: bool
    ) -> None:
        """Open the record, creating it and its folder unless ``resume``.

        Raises:
            UsageError: another command writes to it, it cannot be made, is of another request, or
                there is nothing to resume.
            RecordError: the disk is full.
        """
        path = folder / NAME
        if resume and not path.is_file():
            raise UsageError(
                f'{command}: resume: {path}: no such file, so there is nothing to resume; leave '
                'resume out'
            )
        try:
            if damaged := repair_record(path):
                warn_once(damaged)
            self._record = Record(path)
        except OSError as error:
            if error.errno in FULL_DISK:
                raise RecordError(
                    f'{command}: {folder}: cannot be written ({error.strerror}); fix that and '
                    'resume it'
                ) from error
            raise UsageError(
                f'{command}: {folder}: cannot be written ({error.strerror}); name another out'
            ) from error
        self._waiting: list[tuple[str, str, Any]] = []
        self._flushed_s = time.monotonic()
        try:
            self._begin(command, request)
        except BaseException:
            self._record.close()
            raise

    def _begin(self, command: str, request: Mapping[str, Any]) -> None:
        entries, path = self._record.entries, self._record.path
        if not entries:
            self._record.put(_REQUEST, '', request)
        elif (begun := entries.get(_REQUEST, {}).get('')) is not None:
            check_request(command, path.parent, begun, request)
        else:
            raise UsageError(f'{command}: {path}: its request is lost; choose another out')
        repaired(self._record)
        self.made = {int(key): values for key, values in entries.get(_PICTURE, {}).items()}

    def add(self, number: int, values: Mapping[str, Any]) -> None:
        """Record a picture; after a crash, those of the last half second are made again.

        Raises:
            OSError: it cannot be written, as on a full disk.
            RecordError: the folder was moved, deleted or replaced.
        """
        self._waiting.append((_PICTURE, f'{number:08}', values))
        if time.monotonic() - self._flushed_s >= FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Write what was added to the disk; raises as :meth:`add`."""
        waiting, self._waiting = self._waiting, []
        if waiting:
            self._record.put_all(waiting)
        self._flushed_s = time.monotonic()

    def check_in_place(self) -> None:
        """See :meth:`.Record.check_in_place`."""
        self._record.check_in_place()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.flush()
        finally:
            self._record.close()
