"""MCAP's magic bytes, and serialising one record."""

from __future__ import annotations

from mcap.data_stream import RecordBuilder
from mcap.records import McapRecord

MAGIC = b'\x89MCAP0\r\n'


def encode(record: McapRecord) -> bytes:
    """Serialise one MCAP record."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
