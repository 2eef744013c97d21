"""Atomic file writes; disk errors name their file."""

from __future__ import annotations

import contextlib
import errno
import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:  # slow import that should not delay a run
    import pandas as pd

T = TypeVar('T')
FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def disk_words(error: OSError) -> str:
    """The operating system's error message, on one line."""
    text = error.strerror or str(error)
    return f'[Errno {error.errno}] {text}' if error.errno else text


def disk_error(path: Path, error: OSError) -> OSError:
    """Copy of ``error`` with its file name, and always with an error number.

    Writing to an open file raises errors without a name, and libraries raise some without a number.
    """
    text = error.strerror or str(error)
    return OSError(error.errno or errno.ENOSPC, text, str(path))


def sync_folder(folder: Path) -> None:
    """Make the file names in ``folder`` survive a power failure."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EBADF):  # of file systems that sync no folders
            raise
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Create a folder for results, with its parents, unless it exists."""
    folder.mkdir(parents=True, exist_ok=True)


DRAFTS = ('.*.part*', '*.tmp', '.*.draft')
"""Name patterns of :func:`draft_path`, and of drafts of earlier versions."""


def draft_path(path: Path) -> Path:
    """Path of a file's draft; it keeps the suffix, from which libraries infer the format.

    It is always the same, so that a leftover draft is overwritten by the next attempt.
    """
    return path.with_name(f'.{path.stem}.part{path.suffix}')


def write_atomically(path: Path, data: str | bytes, *, sync: bool = True) -> None:
    """Write ``data`` to ``path`` atomically: a reader never sees a partial file.

    Args:
        path: the file; its folder exists.
        data: text is written in UTF-8.
        sync: False if many files are synced together afterwards.

    Raises:
        OSError: it cannot be written (the error names it); an existing file is unchanged.
    """
    content = data.encode() if isinstance(data, str) else data
    make_atomically(path, lambda draft: draft.write_bytes(content), sync=sync)


def make_atomically(path: Path, make: Callable[[Path], T], *, sync: bool = True) -> T:
    """Create ``path`` from a draft beside it, which is renamed once it is safely on the disk.

    Args:
        path: the file; its folder exists.
        make: function that writes the draft; gets its path.
        sync: as for :func:`write_atomically`.

    Returns:
        The return value of ``make``.

    Raises:
        OSError: as :func:`write_atomically`; no draft is left.
    """
    draft = draft_path(path)
    try:
        made = make(draft)
        if sync:
            with draft.open('rb') as file:
                os.fsync(file.fileno())
        draft.replace(path)
        if sync:
            sync_folder(path.parent)
    except OSError as error:
        raise disk_error(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)
    return made


def write_parquet(path: Path, frames: pd.DataFrame | Iterable[pd.DataFrame]) -> None:
    """Write a table atomically, with its ``attrs`` and a checksum of each page; without its index.

    Args:
        path: the file; its folder exists.
        frames: the table, or parts of it with the same columns and ``attrs``.

    Raises:
        OSError: it cannot be written.
    """
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet

    def write(draft: Path) -> None:
        with contextlib.ExitStack() as opened:
            writer = None
            for frame in [frames] if isinstance(frames, pd.DataFrame) else frames:
                columns = pa.Table.from_pandas(frame, preserve_index=False)
                if writer is None:
                    # The key is that of pandas, which reads it back.
                    attributes = {'PANDAS_ATTRS': json.dumps(frame.attrs)} if frame.attrs else {}
                    writer = opened.enter_context(pyarrow.parquet.ParquetWriter(
                        draft, columns.schema.with_metadata(
                            {**(columns.schema.metadata or {}), **attributes}
                        ), write_page_checksum=True,
                    ))
                writer.write_table(columns.replace_schema_metadata(writer.schema.metadata))

    make_atomically(path, write)
