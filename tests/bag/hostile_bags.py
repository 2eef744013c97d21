"""Small files that are made to keep a reader busy, or to fill its memory; one function for each.

``python tests/bag/hostile_bags.py FOLDER`` writes them all.
"""

from __future__ import annotations

import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    Schema,
    Statistics,
)

MAGIC = b'\x89MCAP0\r\n'
MIB = 1 << 20
MOST = 255 * MIB
"""Of one chunk unpacked, a little below what one may have."""


def encode(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def schema(number: int = 1, data: bytes = b'uint8 x', name: str = 'a/msg/B') -> bytes:
    return encode(Schema(id=number, name=name, encoding='ros2msg', data=data))


def channel(number: int = 1, topic: str = '/t', of: int = 1) -> bytes:
    return encode(Channel(
        id=number, topic=topic, message_encoding='cdr', metadata={}, schema_id=of))


HEAD = MAGIC + encode(Header('ros2', 'x'))
DECLARED = HEAD + schema() + channel()


def record(opcode: int, body: bytes = b'') -> bytes:
    return struct.pack('<BQ', opcode, len(body)) + body


def packed(raw: bytes, compression: str = 'zstd') -> bytes:
    """A sound chunk that holds ``raw``."""
    data = {'zstd': zstandard.ZstdCompressor(level=1).compress, 'lz4': lz4.frame.compress,
            '': bytes}[compression](raw)
    return encode(Chunk(
        compression=compression, data=data, message_start_time=0, message_end_time=0,
        uncompressed_crc=zlib.crc32(raw), uncompressed_size=len(raw)))


def whole(data: bytes, messages: int = 0, summary: bytes = b'') -> bytes:
    """A file that ends as it should."""
    data += encode(DataEnd(zlib.crc32(data)))
    start = len(data)
    summary = summary or schema() + channel() + encode(Statistics(
        attachment_count=0, channel_count=1, channel_message_counts={1: messages}, chunk_count=0,
        message_count=messages, message_end_time=0, message_start_time=0, metadata_count=0,
        schema_count=1))
    footer = Footer(summary_start=start, summary_offset_start=0, summary_crc=0)
    footer.summary_crc = zlib.crc32(summary + encode(footer)[:-4])
    return data + summary + encode(footer) + MAGIC


def repeated(one: bytes, size: int = MOST) -> bytes:
    return one * (size // len(one))


MESSAGE = encode(Message(1, 5, b'\0\1\0\0\1\0\0\0', 5, 0))
EMPTY = encode(Message(1, 5, b'', 5, 0))
PRIVATE = record(0x80)


def zeros() -> bytes:
    """Records of kind 0, nine bytes each."""
    return DECLARED + packed(bytes(MOST))


def private() -> bytes:
    """Countless records of a kind of one's own, in one chunk."""
    return whole(DECLARED + packed(repeated(PRIVATE)))


def many_private() -> bytes:
    """The same, in many chunks that differ."""
    return whole(DECLARED + b''.join(
        packed(repeated(record(0x80 + n, b'%d' % n), 64 * MIB)) for n in range(40)))


def empty_attachments() -> bytes:
    """Attachments within a chunk."""
    one = encode(Attachment(create_time=0, log_time=0, name='', media_type='', data=b''))
    return whole(DECLARED + packed(repeated(one)))


def many_headers() -> bytes:
    """Headers, data ends and footers within a chunk."""
    one = encode(Header('ros2', '')) + encode(DataEnd(0)) + encode(Footer(0, 0, 0))
    return whole(DECLARED + packed(repeated(one)))


def messages() -> bytes:
    """Messages in one chunk, as many as it takes."""
    raw = repeated(MESSAGE)
    return whole(DECLARED + packed(raw), len(raw) // len(MESSAGE))


def messages_below_the_limit() -> bytes:
    """Nearly a million messages in a file of some hundred kilobytes."""
    return whole(DECLARED + packed(MESSAGE * 999_000), 999_000)


def many_chunks_of_messages() -> bytes:
    """Likewise, in chunks of ten thousand each."""
    chunks = [packed(encode(Message(1, n, b'\0\1\0\0\1\0\0\0', 5, 0)) * 10_000) for n in range(300)]
    return whole(DECLARED + b''.join(chunks), 3_000_000)


def tiny_chunks() -> bytes:
    """Very many chunks with one message each, the same one."""
    return whole(DECLARED + packed(MESSAGE, '') * 60_000, 60_000)


def empty_chunks() -> bytes:
    return whole(DECLARED + packed(b'', '') * 100_000)


def large_chunks() -> bytes:
    """Chunks of one large message each, that are packed thousandfold."""
    return whole(DECLARED + b''.join(
        packed(encode(Message(1, n, bytes(MOST), n, 0))) for n in range(1, 30)), 29)


def large_chunks_lz4() -> bytes:
    return whole(DECLARED + b''.join(
        packed(encode(Message(1, n, bytes(MOST // 4), n, 0)), 'lz4') for n in range(1, 30)), 29)


def many_schemas() -> bytes:
    """As many definitions as there are numbers, each of the largest size."""
    text = b'\n'.join(b'uint8 a%d' % n for n in range(9_000))
    return whole(HEAD + b''.join(
        packed(b''.join(schema(n, text, f'a/msg/B{n}') + channel(n, f'/t{n}', n)
                        + encode(Message(n, 5, b'\0\1\0\0' + bytes(9_000), 5, 0))
                        for n in range(first, first + 500)))
        for first in range(1, 6_000, 500)), 6_000)


def many_channels() -> bytes:
    return whole(HEAD + packed(schema() + b''.join(
        channel(n, f'/t{n}') for n in range(1, 65_536))))


def channel_of_many_words() -> bytes:
    """A channel with countless empty words of metadata."""
    names = struct.pack('<HH', 2, 1) + struct.pack('<I', 2) + b'/x' + struct.pack('<I', 3) + b'cdr'
    body = names + struct.pack('<I', MOST) + bytes(MOST)
    return whole(DECLARED + packed(record(Opcode.CHANNEL, body)))


def metadata_of_many_words() -> bytes:
    """Metadata with countless empty words, within a chunk."""
    body = struct.pack('<I', 0) + struct.pack('<I', MOST // 8 * 8) + bytes(MOST // 8 * 8)
    return whole(DECLARED + packed(record(Opcode.METADATA, body)))


def statistics_of_many_channels() -> bytes:
    """Statistics with countless channels, within a chunk."""
    size = MOST // 10 * 10
    body = struct.pack('<QHIIIIQQ', 0, 0, 0, 0, 0, 0, 0, 0) + struct.pack('<I', size) + bytes(size)
    return whole(DECLARED + packed(record(Opcode.STATISTICS, body)))


def same_channel_again() -> bytes:
    """One schema and channel, told over and over."""
    return whole(DECLARED + packed(repeated(schema() + channel())))


def contradicting_channels() -> bytes:
    """A channel told in two ways, over and over."""
    one = channel(2, '/a') + channel(2, '/b')
    return whole(DECLARED + packed(repeated(one, 64 * MIB)))


def many_attachments() -> bytes:
    one = encode(Attachment(create_time=0, log_time=0, name='a', media_type='', data=b''))
    return whole(DECLARED + one * 50_000)


def many_metadata() -> bytes:
    return whole(DECLARED + b''.join(
        encode(Metadata(name=f'{n}', metadata={'a': 'b'})) for n in range(50_000)))


def summary_that_lies() -> bytes:
    """A summary whose index names the same chunk of zeros again and again, behind damage."""
    chunk = packed(bytes(MOST))
    body = DECLARED + chunk
    index = encode(ChunkIndex(
        chunk_length=len(chunk), chunk_start_offset=len(DECLARED), compression='zstd',
        compressed_size=len(chunk) - 44 - 9, message_end_time=0, message_index_length=0,
        message_index_offsets={}, message_start_time=0, uncompressed_size=MOST))
    file = bytearray(whole(body, 0, schema() + channel() + index * 3_000))
    file[len(DECLARED)] ^= 0x40
    return bytes(file)


def summary_of_many_records() -> bytes:
    return whole(DECLARED, 0, PRIVATE * 100_000)


def long_strings() -> bytes:
    """A message of countless empty words."""
    count = 15_000_000
    cdr = b'\0\1\0\0' + struct.pack('<I', count) + struct.pack('<II', 1, 0) * count
    return whole(HEAD + schema(1, b'string[] words') + channel()
                 + packed(encode(Message(1, 5, cdr, 5, 0))), 1)


def long_numbers() -> bytes:
    """A message of countless numbers."""
    count = 250_000_000
    cdr = b'\0\1\0\0' + struct.pack('<I', count) + bytes(count)
    return whole(HEAD + schema(1, b'uint8[] numbers') + channel()
                 + packed(encode(Message(1, 5, cdr, 5, 0))), 1)


def nested_messages() -> bytes:
    """A message of countless messages."""
    count = 30_000_000
    text = b'Inner[] many\n' + b'=' * 80 + b'\nMSG: a/Inner\nbool a\nbool b\n'
    cdr = b'\0\1\0\0' + struct.pack('<I', count) + bytes(2 * count)
    return whole(HEAD + schema(1, text) + channel() + packed(encode(Message(1, 5, cdr, 5, 0))), 1)


def frames_in_frames() -> bytes:
    """Zstd frames behind one another, of which the first tells no size."""
    part = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(MIB))
    data = part * 3_000
    return DECLARED + encode(Chunk(
        compression='zstd', data=data, message_start_time=0, message_end_time=0,
        uncompressed_crc=1, uncompressed_size=MOST))


def heads_without_end() -> bytes:
    """Nothing but what records begin with, behind damage."""
    heads = record(Opcode.CHUNK)[:6] * 100_000
    return DECLARED + b'\xff' * 9 + heads + b'\x28\xb5\x2f\xfd' * 50_000


HOSTILE: dict[str, Callable[[], bytes]] = {
    make.__name__: make for make in (
        zeros, private, many_private, empty_attachments, many_headers, messages,
        messages_below_the_limit, many_chunks_of_messages, tiny_chunks, empty_chunks, large_chunks,
        large_chunks_lz4, many_schemas, many_channels, channel_of_many_words,
        metadata_of_many_words, statistics_of_many_channels, same_channel_again,
        contradicting_channels, many_attachments, many_metadata, summary_that_lies,
        summary_of_many_records, long_strings, long_numbers, nested_messages, frames_in_frames,
        heads_without_end,
    )
}


if __name__ == '__main__':
    for name, make in HOSTILE.items():
        path = Path(sys.argv[1]) / f'{name}.mcap'
        path.write_bytes(make())
        print(f'{path.stat().st_size:10d} {name}', flush=True)
