"""Serialise MCAP records, and parse them from untrusted bytes.

Any parse error becomes :class:`BagCorrupt`. Lengths are limited to :data:`MAX_RECORD_BYTES`, and a
chunk is decompressed to at most its declared size and split message by message, so a small
malicious file cannot exhaust memory. :class:`ReadBudget` limits the total work of all chunks of a
file.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Any, TypeVar

import lz4.frame  # type: ignore[import-untyped]  # lz4 has no stubs
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from taxinet_ros.bag.errors import BagCorrupt

MAGIC = b'\x89MCAP0\r\n'


def encode(record: McapRecord) -> bytes:
    """Serialise one MCAP record."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


MAX_RECORD_BYTES = 256 * 2**20
FREE_RECORDS = 250_000
BYTES_FOR_A_RECORD = 4
"""File bytes per allowed record; the smallest compressed message takes more."""
FREE_BYTES = 1 << 30
UNPACKED_FOR_A_BYTE = 256
"""Allowed compression ratio; black camera frames exceed it and use :data:`FREE_BYTES`."""
_TEXT_OF_A_RECORD = 32
"""Bytes of a definition that take as much work as a message."""
_IN_CHUNKS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
_FIRST_PRIVATE = 0x80
HEAD = struct.Struct('<BQ')
"""Record header: opcode, length of the body."""
_MESSAGE = struct.Struct('<HIQQ')
_MESSAGE_INDEX = struct.Struct('<HI')
_INDEX_ENTRY_BYTES = 16
_CHUNK_NAME_AT, _CHUNK_LEAST_BYTES = 28, 40
"""Chunk body: offset of the compression name, and its length without name and data."""
_MALFORMED = (
    McapError, struct.error, ValueError, OverflowError, MemoryError, RuntimeError,
    zstandard.ZstdError,
)
_KINDS = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
    Opcode.DATA_END: DataEnd,
    Opcode.STATISTICS: Statistics,
    Opcode.FOOTER: Footer,
}
_INDEX_KINDS = {
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
}
Body = bytes | memoryview
BodyT = TypeVar('BodyT', bytes, memoryview)


def parse_record(opcode: int, body: Body) -> McapRecord | None:
    """Parse a record; None for indexes and unknown opcodes."""
    if opcode == Opcode.MESSAGE:
        return parse_message(body)
    if opcode == Opcode.ATTACHMENT:
        _check_attachment(body)
    if opcode == Opcode.CHUNK:
        _check_chunk(body)
    # A file may contain any opcode, not only members of the enumeration.
    return _read(_KINDS.get(opcode), body)  # type: ignore[call-overload]  # any int may be asked


def parse_index(opcode: int, body: Body) -> McapRecord | None:
    """Parse an index record; None for other opcodes."""
    return _read(_INDEX_KINDS.get(opcode), body)  # type: ignore[call-overload]  # as above


def _read(kind: Any, body: Body) -> McapRecord | None:
    if kind is None:
        return None
    stream = ReadDataStream(BytesIO(body))
    try:
        record: McapRecord = kind.read(stream)
    except _MALFORMED as error:
        raise BagCorrupt(f'malformed {kind.__name__} record: {error}') from error
    if stream.count != len(body):
        raise BagCorrupt(f'{kind.__name__} record of {len(body)} bytes uses only {stream.count}')
    return record


def parse_message(body: Body) -> Message:
    """Parse a message record."""
    if len(body) < _MESSAGE.size:
        raise BagCorrupt(f'message record of {len(body)} bytes is too short')
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
    return Message(
        channel_id=channel, sequence=sequence, log_time=log_time, publish_time=publish_time,
        data=bytes(body[_MESSAGE.size:]),
    )


def check_message_index(body: Body) -> None:
    """Check the lengths in a message index against the record's length."""
    entries = len(body) - _MESSAGE_INDEX.size
    if entries < 0 or entries % _INDEX_ENTRY_BYTES:
        raise BagCorrupt(f'message index of {len(body)} bytes')
    if _MESSAGE_INDEX.unpack_from(body)[1] != entries:
        raise BagCorrupt('message index contradicts its own length')


class ReadBudget:
    """Limits for the chunks of one file in one pass.

    A malicious file may contain thousands of records, or of unpacked bytes, per file byte; a
    recording does not.
    """

    def __init__(self, file_bytes: int) -> None:
        """Set the budget for a file of ``file_bytes`` bytes."""
        self._file_bytes = file_bytes
        self._records = FREE_RECORDS + file_bytes // BYTES_FOR_A_RECORD
        self._bytes = FREE_BYTES + file_bytes * UNPACKED_FOR_A_BYTE

    def unpack(self, size: int) -> None:
        """Account for ``size`` bytes to be decompressed.

        Raises:
            BagCorrupt: the total is too large.
        """
        if size > self._bytes:
            raise BagCorrupt(f'chunks of {self._file_bytes} bytes unpack to more than a recording')
        self._bytes -= size

    def record(self, opcode: int, length: int) -> None:
        """Account for a record in a chunk.

        Raises:
            BagCorrupt: the record is not allowed in a chunk, or there are too many.
        """
        if opcode not in _IN_CHUNKS and opcode < _FIRST_PRIVATE:
            raise BagCorrupt(f'record of kind {opcode} within a chunk')
        # Channels and definitions are parsed word by word.
        self._records -= 1 if opcode == Opcode.MESSAGE else 1 + length // _TEXT_OF_A_RECORD
        if self._records < 0:
            raise BagCorrupt(f'{self._file_bytes} bytes hold more records than a recording')


def open_chunk(chunk: Chunk, work: ReadBudget) -> bytes:
    """Decompress a chunk; checks its size, its checksum and the file's budget."""
    size = chunk.uncompressed_size
    if size > MAX_RECORD_BYTES:
        raise BagCorrupt(f'chunk declares {size} bytes, more than the {MAX_RECORD_BYTES} allowed')
    work.unpack(size if chunk.compression else 0)
    raw = _decompress(chunk)
    if len(raw) != size:
        raise BagCorrupt(f'chunk declares {size} bytes but holds {len(raw)}')
    if chunk.uncompressed_crc and zlib.crc32(raw) != chunk.uncompressed_crc:
        raise BagCorrupt('chunk contradicts its checksum')
    return raw


def chunk_records(raw: bytes, work: ReadBudget) -> Iterator[McapRecord]:
    """Yield schemas, channels and messages of an opened chunk."""
    for _, record in placed_records(raw, work):
        yield record


def placed_records(raw: bytes, work: ReadBudget) -> Iterator[tuple[int, McapRecord]]:
    """Yield the offset in an opened chunk, and the schema, channel or message there."""
    position = 0
    for opcode, body in split_records(memoryview(raw)):
        work.record(opcode, len(body))
        record = parse_record(opcode, body) if opcode in _IN_CHUNKS else None
        if record is not None:
            yield position, record
        position += HEAD.size + len(body)


def split_records(raw: BodyT) -> Iterator[tuple[int, BodyT]]:
    """Yield opcode and body of the records in ``raw``."""
    position = 0
    while position < len(raw):
        if position + HEAD.size > len(raw):
            raise BagCorrupt('records do not fill their section')
        opcode, length = HEAD.unpack_from(raw, position)
        if opcode == 0:  # Invalid by the specification; zeros would be a record per nine bytes.
            raise BagCorrupt('record of kind 0')
        position += HEAD.size
        if length > len(raw) - position:
            raise BagCorrupt(f'record of {length} bytes exceeds its section')
        yield opcode, raw[position:position + length]
        position += length


def _decompress(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    try:
        if chunk.compression == 'zstd':
            return _unzstd(chunk.data, size)
        if chunk.compression == 'lz4':
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size))
    except _MALFORMED as error:
        raise BagCorrupt(f'chunk cannot be decompressed: {error}') from error
    if chunk.compression:
        raise BagCorrupt(f'chunk has unknown compression {chunk.compression!r}')
    return chunk.data


def _unzstd(data: bytes, size: int) -> bytes:
    # The frame header takes precedence over max_output_size, so it must match the chunk's size.
    declared = zstandard.get_frame_parameters(data).content_size
    if declared not in (size, zstandard.CONTENTSIZE_UNKNOWN):
        raise BagCorrupt(f'chunk declares {size} bytes but its zstd frame {declared}')
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)


def _check_chunk(body: Body) -> None:
    """Check the lengths in a chunk against the record's; the library accepts short data."""
    if len(body) >= _CHUNK_LEAST_BYTES:
        (name,) = struct.unpack_from('<I', body, _CHUNK_NAME_AT)
        held = len(body) - _CHUNK_LEAST_BYTES - name
        if held < 0 or struct.unpack_from('<Q', body, _CHUNK_NAME_AT + 4 + name)[0] != held:
            raise BagCorrupt(f'chunk record of {len(body)} bytes contradicts its own lengths')


def _check_attachment(body: Body) -> None:
    if len(body) < 4:
        raise BagCorrupt(f'attachment record of {len(body)} bytes is too short')
    (crc,) = struct.unpack('<I', body[-4:])
    if crc and zlib.crc32(body[:-4]) != crc:
        raise BagCorrupt('attachment contradicts its checksum')
