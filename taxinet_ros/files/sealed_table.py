"""Parquet table with a checksum of itself, which stays with it where it is copied.

The file's metadata hold the SHA-256 of all its bytes with zeros in the place of the digits, and, in
another entry, that there is one: no single-bit error makes a table with a checksum look like one
without. Tables of pandas or other programs have none.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import make_atomically

if TYPE_CHECKING:  # slow imports that should not delay a run
    import pandas as pd

_DIGITS = re.compile(rb'[0-9a-f]{64}')
_ZEROS = b'0' * 64
_KEY, _OTHER_KEY, _WORD = b'taxinet_sha256', b'taxinet_sealed', b'by a SHA-256'
# An entry of the metadata in the file (Thrift, compact): key, type of the value, its length, value.
_NAME = _KEY + bytes([0x18, len(_ZEROS)])
_HAS = _OTHER_KEY + bytes([0x18, len(_WORD)]) + _WORD


def write_table(path: Path, frame: pd.DataFrame) -> None:
    """Write a table atomically, with its ``attrs`` and a checksum; the index is left out.

    Raises:
        OSError: it cannot be written.
    """
    make_atomically(path, lambda draft: draft.write_bytes(_sealed_bytes(frame)))


def is_sealed_table(path: Path, data: bytes) -> bool:
    """Whether a table has a checksum, which is then checked.

    Args:
        path: path of the table, for messages.
        data: its bytes.

    Raises:
        UsageError: its checksum differs, or is damaged.
    """
    named, has = data.rfind(_NAME), data.rfind(_HAS)
    if named < 0 and has < 0:
        return False
    begin = named + len(_NAME)
    digits = data[begin:begin + len(_ZEROS)]
    if named < 0 or has < 0 or not _DIGITS.fullmatch(digits):
        raise UsageError(f'{path}: damaged (its checksum is damaged); restore it or write it anew')
    if _sha256(data, begin) != digits:
        raise UsageError(
            f'{path}: was modified (its SHA-256 differs); restore it or write it anew'
        )
    return True


def _sealed_bytes(frame: pd.DataFrame) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet

    table = pa.Table.from_pandas(frame, preserve_index=False)
    metadata = {**(table.schema.metadata or {})}
    if frame.attrs:
        metadata[b'PANDAS_ATTRS'] = json.dumps(frame.attrs).encode()  # as pandas writes and reads
    metadata |= {_KEY: _ZEROS, _OTHER_KEY: _WORD}
    stream = pa.BufferOutputStream()
    pyarrow.parquet.write_table(table.replace_schema_metadata(metadata), stream)
    data = bytes(stream.getvalue().to_pybytes())
    begin = data.rindex(_NAME + _ZEROS) + len(_NAME)
    assert _HAS in data
    return data[:begin] + _sha256(data, begin) + data[begin + len(_ZEROS):]


def _sha256(data: bytes, begin: int) -> bytes:
    digest = hashlib.sha256(data[:begin])
    digest.update(_ZEROS)
    digest.update(data[begin + len(_ZEROS):])
    return digest.hexdigest().encode()
