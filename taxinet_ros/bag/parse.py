"""MCAP records out of untrusted bytes: whatever is wrong with them becomes :class:`BagCorrupt`.

Lengths are believed only within :data:`MAX_RECORD_BYTES`, and a chunk is decompressed only into the
size that it declares, so a small hostile file cannot fill the memory.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO

import lz4.frame  # type: ignore[import-untyped]  # lz4 has no stubs
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    Schema,
    Statistics,
)

from taxinet_ros.bag.errors import BagCorrupt

MAX_RECORD_BYTES = 256 * 2**20
HEAD = struct.Struct('<BQ')
"""What every record begins with: opcode, length of the rest."""

_MESSAGE = struct.Struct('<HIQQ')
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


def parse_record(opcode: int, body: bytes) -> McapRecord | None:
    """The record with this opcode and body, or None for the kinds that nobody here needs."""
    if opcode == Opcode.MESSAGE:
        return parse_message(body)
    # A file may hold any number here; its type is the enumeration's only where it is known.
    kind = _KINDS.get(opcode)  # type: ignore[call-overload]
    if kind is None:
        return None
    if opcode == Opcode.ATTACHMENT:
        _check_attachment(body)
    stream = ReadDataStream(BytesIO(body))
    try:
        record: McapRecord = kind.read(stream)
    except _MALFORMED as error:
        raise BagCorrupt(f'malformed {kind.__name__} record: {error}') from error
    if stream.count != len(body):
        raise BagCorrupt(f'{kind.__name__} record of {len(body)} bytes uses only {stream.count}')
    return record


def parse_message(body: bytes) -> Message:
    """The message record with this body."""
    if len(body) < _MESSAGE.size:
        raise BagCorrupt(f'message record of {len(body)} bytes is too short')
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
    return Message(
        channel_id=channel, sequence=sequence, log_time=log_time, publish_time=publish_time,
        data=body[_MESSAGE.size:],
    )


def chunk_records(chunk: Chunk) -> list[McapRecord]:
    """Schemas, channels and messages of a chunk whose checksum holds, all or none."""
    raw = _decompress(chunk)
    if len(raw) != chunk.uncompressed_size:
        raise BagCorrupt(f'chunk declares {chunk.uncompressed_size} bytes but holds {len(raw)}')
    if chunk.uncompressed_crc and zlib.crc32(raw) != chunk.uncompressed_crc:
        raise BagCorrupt('chunk contradicts its checksum')
    records = (parse_record(opcode, body) for opcode, body in split_records(raw))
    return [record for record in records if isinstance(record, Schema | Channel | Message)]


def split_records(raw: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of the records that ``raw`` is made of."""
    position = 0
    while position < len(raw):
        if position + HEAD.size > len(raw):
            raise BagCorrupt('records do not fill their section')
        opcode, length = HEAD.unpack_from(raw, position)
        position += HEAD.size
        if length > len(raw) - position:
            raise BagCorrupt(f'record of {length} bytes exceeds its section')
        yield opcode, raw[position:position + length]
        position += length


def _decompress(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    if size > MAX_RECORD_BYTES:
        raise BagCorrupt(f'chunk declares {size} bytes, more than the {MAX_RECORD_BYTES} allowed')
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


def _check_attachment(body: bytes) -> None:
    if len(body) < 4:
        raise BagCorrupt(f'attachment record of {len(body)} bytes is too short')
    (crc,) = struct.unpack('<I', body[-4:])
    if crc and zlib.crc32(body[:-4]) != crc:
        raise BagCorrupt('attachment contradicts its checksum')
