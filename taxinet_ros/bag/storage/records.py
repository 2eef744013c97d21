"""MCAP records as bytes, and out of untrusted bytes.

Whatever is wrong with what is read becomes :class:`BagCorrupt`. Lengths are believed only
within :data:`MAX_RECORD_BYTES`, and a chunk is decompressed only into the size that it declares
and taken apart message by message, so a small hostile file cannot fill the memory.
:class:`ReadBudget` limits what all the chunks of a file together may ask of a reader.
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
    """The bytes of one MCAP record."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


MAX_RECORD_BYTES = 256 * 2**20
FREE_RECORDS = 250_000
BYTES_FOR_A_RECORD = 4
"""Of the file; the smallest message takes more, with its index or without, however well packed."""
FREE_BYTES = 1 << 30
UNPACKED_FOR_A_BYTE = 256
"""Black camera frames are packed better still; the free ones are for those."""
_TEXT_OF_A_RECORD = 32
"""Bytes of a definition that are as much work as a message."""
_IN_CHUNKS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
_FIRST_PRIVATE = 0x80
HEAD = struct.Struct('<BQ')
"""What every record begins with: opcode, length of the rest."""
_MESSAGE = struct.Struct('<HIQQ')
_MESSAGE_INDEX = struct.Struct('<HI')
_INDEX_ENTRY_BYTES = 16
_CHUNK_NAME_AT, _CHUNK_LEAST_BYTES = 28, 40
"""Of a chunk's body: where the name of its compression is, and its length without name and data."""
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
    """The record with this opcode and body, or None for indexes and unknown kinds."""
    if opcode == Opcode.MESSAGE:
        return parse_message(body)
    if opcode == Opcode.ATTACHMENT:
        _check_attachment(body)
    if opcode == Opcode.CHUNK:
        _check_chunk(body)
    # A file may hold any number here; its type is the enumeration's only where it is known.
    return _read(_KINDS.get(opcode), body)  # type: ignore[call-overload]  # any int may be asked


def parse_index(opcode: int, body: Body) -> McapRecord | None:
    """The index record with this opcode and body, or None for all that are no index."""
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
    """The message record with this body."""
    if len(body) < _MESSAGE.size:
        raise BagCorrupt(f'message record of {len(body)} bytes is too short')
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
    return Message(
        channel_id=channel, sequence=sequence, log_time=log_time, publish_time=publish_time,
        data=bytes(body[_MESSAGE.size:]),
    )


def check_message_index(body: Body) -> None:
    """Hold the lengths within a message index against that of the record."""
    entries = len(body) - _MESSAGE_INDEX.size
    if entries < 0 or entries % _INDEX_ENTRY_BYTES:
        raise BagCorrupt(f'message index of {len(body)} bytes')
    if _MESSAGE_INDEX.unpack_from(body)[1] != entries:
        raise BagCorrupt('message index contradicts its own length')


class ReadBudget:
    """What the chunks of one file may ask of one pass over it.

    A file that is made to keep a reader busy packs thousands of records, or of bytes, into each of
    its own; a recorder does not.
    """

    def __init__(self, file_bytes: int) -> None:
        """A budget for a file of so many bytes."""
        self._file_bytes = file_bytes
        self._records = FREE_RECORDS + file_bytes // BYTES_FOR_A_RECORD
        self._bytes = FREE_BYTES + file_bytes * UNPACKED_FOR_A_BYTE

    def unpack(self, size: int) -> None:
        """So many bytes are about to be unpacked.

        Raises:
            BagCorrupt: with all before, that is too many.
        """
        if size > self._bytes:
            raise BagCorrupt(f'chunks of {self._file_bytes} bytes unpack to more than a recording')
        self._bytes -= size

    def record(self, opcode: int, length: int) -> None:
        """A record within a chunk is about to be looked at.

        Raises:
            BagCorrupt: it does not belong there, or with all before there are too many.
        """
        if opcode not in _IN_CHUNKS and opcode < _FIRST_PRIVATE:
            raise BagCorrupt(f'record of kind {opcode} within a chunk')
        # What a channel or a definition says is gone through word by word.
        self._records -= 1 if opcode == Opcode.MESSAGE else 1 + length // _TEXT_OF_A_RECORD
        if self._records < 0:
            raise BagCorrupt(f'{self._file_bytes} bytes hold more records than a recording')


def open_chunk(chunk: Chunk, work: ReadBudget) -> bytes:
    """What a chunk holds, if its size and its checksum hold, and the file's budget."""
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
    """Schemas, channels and messages out of an opened chunk, one at a time."""
    for _, record in placed_records(raw, work):
        yield record


def placed_records(raw: bytes, work: ReadBudget) -> Iterator[tuple[int, McapRecord]]:
    """Offset within an opened chunk, and schema, channel or message there."""
    position = 0
    for opcode, body in split_records(memoryview(raw)):
        work.record(opcode, len(body))
        record = parse_record(opcode, body) if opcode in _IN_CHUNKS else None
        if record is not None:
            yield position, record
        position += HEAD.size + len(body)


def split_records(raw: BodyT) -> Iterator[tuple[int, BodyT]]:
    """Opcode and body of the records that ``raw`` is made of."""
    position = 0
    while position < len(raw):
        if position + HEAD.size > len(raw):
            raise BagCorrupt('records do not fill their section')
        opcode, length = HEAD.unpack_from(raw, position)
        if opcode == 0:  # Not one by the specification; zeros would be one each nine bytes.
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
    # The frame's own header would win over max_output_size, so it is held against the chunk's.
    declared = zstandard.get_frame_parameters(data).content_size
    if declared not in (size, zstandard.CONTENTSIZE_UNKNOWN):
        raise BagCorrupt(f'chunk declares {size} bytes but its zstd frame {declared}')
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)


def _check_chunk(body: Body) -> None:
    """Hold the lengths within a chunk against the record's: the library takes what is there."""
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
