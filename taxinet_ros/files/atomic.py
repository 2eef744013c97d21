"""Writing files so that a reader sees all of one or none; errors of the disk name their file."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path

FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def disk_words(error: OSError) -> str:
    """What the operating system said, on one line."""
    text = error.strerror or str(error)
    return f'[Errno {error.errno}] {text}' if error.errno else text


def disk_error(path: Path, error: OSError) -> OSError:
    """``error`` once more, with the file that it was about and a number in any case.

    Writing to an open file raises errors without a name, and libraries raise some without a number.
    """
    text = error.strerror or str(error)
    return OSError(error.errno or errno.ENOSPC, text, str(path))


def sync_folder(folder: Path) -> None:
    """Make the names within ``folder`` survive a loss of power."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_atomically(path: Path, text: str) -> None:
    """Put ``text`` at ``path`` so that a reader sees all of it or no file, come what may.

    Raises:
        OSError: it cannot be written; what was there before is there still.
    """
    write_bytes_atomically(path, text.encode())


def write_bytes_atomically(path: Path, data: bytes) -> None:
    """Put ``data`` at ``path``, as :func:`write_atomically`."""
    draft = path.with_name(path.name + '.tmp')
    try:
        with draft.open('wb') as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        draft.rename(path)
        sync_folder(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)
        raise disk_error(path, error) from error
