"""Errors of bags. Every failure of this package is one of these, with a one-line message."""

from __future__ import annotations

from pathlib import Path

from taxinet_ros.errors import plain_line


class BagError(Exception):
    """A bag cannot be written or read.

    Attributes:
        path: the file or folder concerned, or None where only bytes were at hand.
        recovered: messages that were read soundly before the trouble.
        offset: byte of the file at which the damage lies, or -1 where it has no place.
    """

    def __init__(
        self, message: str, *, path: Path | None = None, recovered: int = 0, offset: int = -1
    ) -> None:
        super().__init__(plain_line(message))
        self.path = path
        self.recovered = recovered
        self.offset = offset


class BagWriteError(BagError):
    """The operating system refused to store more; the bag holds what was written before.

    Attributes:
        errno: the system's error number, e.g. ``errno.ENOSPC``.
    """

    def __init__(self, message: str, *, path: Path | None = None, errno: int = 0) -> None:
        super().__init__(message, path=path)
        self.errno = errno


class BagTruncated(BagError):  # noqa: N818 - the state of the bag
    """The file stops before its end mark: its writer was killed, or the copy is incomplete."""


class BagCorrupt(BagError):  # noqa: N818 - the state of the bag
    """The bytes contradict their checksums or one another."""


class BagEmpty(BagError):  # noqa: N818 - the state of the bag
    """There is nothing in it to read."""


class BagForeign(BagError):  # noqa: N818 - the state of the bag
    """It is no bag, or one of a kind that this package does not read."""


def several_runs(path: Path, one: str, other: str) -> BagForeign:
    """The error of who reads one run, and finds two in a bag."""
    return BagForeign(
        f'{path}: holds several runs, {one} and {other}; split it with: taxinet bag split {path} '
        '--out DIR', path=path,
    )
