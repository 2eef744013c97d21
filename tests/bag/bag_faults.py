"""Ways of looking at damaged bags, for the tests."""

from __future__ import annotations

from pathlib import Path

from bag_samples import Sample, drain
from mcap.records import Channel, Chunk, Header, Schema

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.reader import read_messages
from taxinet_ros.bag.storage.records import MAGIC, encode

STEPS = 3
PER_STEP = 6


def read_all(path: Path) -> tuple[list[Sample], BagError | None]:
    """What can be read, and the error that ended it, which is one line and names the file."""
    found, error = drain(read_messages(path))
    assert error is None or ('\n' not in str(error) and str(path) in str(error))
    return [(m.topic, m.stamp_ns, m.cdr) for m in found], error


def chunks_of(data: bytes) -> list[tuple[int, int]]:
    """First and last byte of every chunk."""
    places, offset = [], len(MAGIC)
    while data[offset] != 15:
        end = offset + 9 + int.from_bytes(data[offset + 1:offset + 9], 'little')
        if data[offset] == 6:
            places.append((offset, end))
        offset = end
    return places


def declarations() -> bytes:
    """A schema and a channel that uses it."""
    schema = Schema(id=1, name='a/msg/B', encoding='ros2msg', data=b'uint8 x')
    channel = Channel(id=1, topic='/t', message_encoding='cdr', metadata={}, schema_id=1)
    return encode(schema) + encode(channel)


def chunk(data: bytes, declared: int, compression: str, crc: int = 1) -> Chunk:
    """A chunk that declares what it likes."""
    return Chunk(
        compression=compression, data=data, message_start_time=0, message_end_time=0,
        uncompressed_crc=crc, uncompressed_size=declared,
    )


def file_with(record: Chunk) -> bytes:
    """A file that ends with this record."""
    return MAGIC + encode(Header('ros2', 'x')) + declarations() + encode(record)
