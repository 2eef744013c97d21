"""The file descriptor that a bag is written through: checksummed, and honest about failures."""

from __future__ import annotations

import errno as numbers
import os
import zlib
from contextlib import suppress
from pathlib import Path

from taxinet_ros.bag.errors import BagError, BagWriteError


class Output:
    """Unbuffered bytes to a new file; what :meth:`put` returned from survives the process's death.

    After the first error nothing is written any more and every call raises it again, for a disk
    that was full once must not look well when a small write happens to fit.

    Attributes:
        path: the file.
        size: bytes written so far, which is the offset of the next one.
        crc: CRC-32 of all of them.
    """

    def __init__(self, path: Path, *, keep_free_bytes: int = 0) -> None:
        """Create the file, which must not exist.

        Args:
            path: the file.
            keep_free_bytes: free space of the disk that is not used up [bytes]: whoever shares it,
                a campaign's ledger among them, can still write when this file stops.
        """
        self.path = path
        self.size = 0
        self.crc = 0
        self._failure: tuple[str, int] | None = None
        self._descriptor = -1
        self._keep_free_bytes = keep_free_bytes
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        try:
            self._descriptor = os.open(path, flags, 0o644)
        except OSError as error:
            raise self._latch(error) from error

    @property
    def open(self) -> bool:
        """Whether the file is still open."""
        return self._descriptor >= 0

    def check(self) -> None:
        """Raise what went wrong earlier, if anything did, or that the file is closed."""
        if self._failure is not None:
            message, errno = self._failure
            raise BagWriteError(message, path=self.path, errno=errno)
        if self._descriptor < 0:
            raise BagError(f'{self.path}: the bag is closed; nothing can be added', path=self.path)

    def put(self, data: bytes) -> None:
        """Write all of ``data``, or leave the file as it was and raise :class:`BagWriteError`."""
        self.check()
        view = memoryview(data)
        try:
            self._check_room(len(data))
            while view:
                view = view[os.write(self._descriptor, view):]
        except OSError as error:
            with suppress(OSError):  # No half record at the end, if the system lets us.
                os.ftruncate(self._descriptor, self.size)
            raise self._latch(error) from error
        self.size += len(data)
        self.crc = zlib.crc32(data, self.crc)

    def sync(self) -> None:
        """Return once the storage device has everything."""
        self.check()
        try:
            os.fsync(self._descriptor)
        except OSError as error:
            raise self._latch(error) from error

    def close(self) -> None:
        """Close the file; closing twice is harmless."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor < 0:
            return
        try:
            os.close(descriptor)
        except OSError as error:
            raise self._latch(error) from error

    def _check_room(self, wanted: int) -> None:
        if not self._keep_free_bytes:
            return
        disk = os.fstatvfs(self._descriptor)
        free = disk.f_bavail * disk.f_frsize
        if free - wanted < self._keep_free_bytes:
            left = f'{free / 1e6:.0f} MB free, {self._keep_free_bytes / 1e6:.0f} MB of it kept so'
            raise OSError(numbers.ENOSPC, f'{os.strerror(numbers.ENOSPC)} ({left})')

    def _latch(self, error: OSError) -> BagWriteError:
        errno = error.errno or 0
        message = f'{self.path}: cannot write: [Errno {errno}] {error.strerror}'
        self._failure = (message, errno)
        return BagWriteError(message, path=self.path, errno=errno)
