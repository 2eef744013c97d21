"""Read files that somebody names: regular ones, and no more bytes of them than a limit.

A device has no size and no end, and a pipe may never have one, so a size that was looked up says
nothing about what will be read. What a shell offers as a file (``/dev/stdin``, ``/dev/fd/63``) is
read up to the limit.
"""

from __future__ import annotations

import errno
import io
import os
import re
import stat
from pathlib import Path

FOUND = {stat.S_IFIFO: 'a pipe', stat.S_IFSOCK: 'a socket', stat.S_IFCHR: 'a device',
         stat.S_IFBLK: 'a device'}
"""Kinds of files that are no regular ones, as named in errors."""
MAX_TEXT_BYTES = 16 << 20
"""Size limit of programs and other texts for which there is no smaller one."""
_OFFERED = re.compile(r'/dev/(stdin|null|fd/\d+)|/proc/(self|\d+)/fd/\d+')


class UnfitFileError(OSError):
    """A file that is not read: too large, or no regular one.

    Attributes:
        what: says so, as ``strerror`` does.
    """

    def __init__(self, path: Path, what: str) -> None:
        """Create it for the file at ``path``."""
        super().__init__(errno.EINVAL, what, str(path))
        self.what = what


def open_regular(path: Path) -> io.BufferedReader:
    """Open a regular file, or one that a shell offers, for reading.

    Raises:
        UnfitFileError: it is a pipe, socket or device.
        OSError: it cannot be opened.
    """
    check_regular(path)
    file = path.open('rb')
    try:  # it may have been exchanged since
        _check_kind(path, os.fstat(file.fileno()))
    except BaseException:
        file.close()
        raise
    return file


def check_regular(path: Path) -> None:
    """Check that a path is that of a regular file, a folder, or a file that a shell offers.

    Raises:
        UnfitFileError: it is a pipe, socket or device.
        OSError: it cannot be looked at.
    """
    _check_kind(path, os.stat(path))


def _check_kind(path: Path, found: os.stat_result) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind in FOUND and not _OFFERED.fullmatch(str(path)):
        raise UnfitFileError(path, f'is {FOUND[kind]}, not a regular file')


def read_file(path: Path, most: int | None = None) -> bytes:
    """Content of a regular file, or of one that a shell offers.

    Args:
        path: the file.
        most: largest size [bytes]; None for records of ours, which may grow.

    Raises:
        UnfitFileError: it is larger, or a pipe, socket or device.
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        data = file.read() if most is None else file.read(most + 1)
    if most is not None and len(data) > most:
        size = f'{most >> 20} MiB' if most >> 20 else f'{most >> 10} KiB'
        raise UnfitFileError(path, f'has more than {size}; is it the right file?')
    return data


def read_text(path: Path, most: int | None = None) -> str:
    """Text in UTF-8 of such a file, with line feeds at its line ends.

    Raises:
        UnicodeDecodeError: it is not UTF-8.
        OSError: as :func:`read_file`.
    """
    return io.StringIO(read_file(path, most).decode(), newline=None).read()
