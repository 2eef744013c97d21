"""Errors of bags, with one-line messages; every failure of this package is one of these."""

from __future__ import annotations

from pathlib import Path

from taxinet_ros.errors import plain_line


class BagError(Exception):
    """A bag cannot be written or read.

    Attributes:
        path: the file or folder concerned, or None if unknown.
        offset: byte offset of the damage in the file, or -1 if it has none.
    """

    def __init__(self, message: str, *, path: Path | None = None, offset: int = -1) -> None:
        super().__init__(plain_line(message))
        self.path = path
        self.offset = offset


class BagWriteError(BagError):
    """The operating system failed to write; the bag contains what was written before.

    Attributes:
        errno: the system's error number, e.g. ``errno.ENOSPC``.
    """

    def __init__(self, message: str, *, path: Path | None = None, errno: int = 0) -> None:
        super().__init__(message, path=path)
        self.errno = errno


class BagTruncated(BagError):  # noqa: N818 - the state of the bag
    """The file ends before its end mark: the writer was killed, or the copy is incomplete."""


class BagCorrupt(BagError):  # noqa: N818 - the state of the bag
    """The data do not match their checksums or each other."""


class BagEmpty(BagError):  # noqa: N818 - the state of the bag
    """The bag contains nothing to read."""


class BagForeign(BagError):  # noqa: N818 - the state of the bag
    """Not a bag, or one of an unsupported kind."""
