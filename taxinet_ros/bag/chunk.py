"""One chunk of an MCAP file, and the records that say where in it the messages are.

Every control step ends one, which the library's builder would write field by field; and frames pass
through here by the hundred thousand bytes, so they are not copied as often as there.
"""

from __future__ import annotations

import struct
import zlib
from typing import NamedTuple

import zstandard
from mcap.opcode import Opcode

_COMPRESSION = b'zstd'
_HEAD = 9
"""Bytes of a record's kind and length, which are not part of its length."""

# Members of an enum take long to look up, and these are needed for every message.
_MESSAGE_CODE, _INDEX_CODE = int(Opcode.MESSAGE), int(Opcode.MESSAGE_INDEX)

_MESSAGE = struct.Struct('<BQHIQQ')
_CHUNK = struct.Struct('<BQQQQII4sQ')
_INDEX = struct.Struct('<BQHI')
_INDEX_ENTRY = struct.Struct('<QQ')
_CHUNK_INDEX = struct.Struct('<BQQQQQI')
_CHUNK_INDEX_ENTRY = struct.Struct('<HQ')
_CHUNK_INDEX_TAIL = struct.Struct('<QI4sQQ')


class PackedChunk(NamedTuple):
    """A chunk as it goes to the file.

    Attributes:
        records: the chunk and its message indexes.
        summary: the chunk index record, for the summary of the file.
    """

    records: bytes
    summary: bytes


class Chunk:
    """Messages so far, uncompressed.

    Attributes:
        data: the records within the chunk.
    """

    def __init__(self, head: bytes = b'') -> None:
        """Begin with the records ``head``."""
        self.data = bytearray(head)
        self._entries: dict[int, list[tuple[int, int]]] = {}

    @property
    def empty(self) -> bool:
        """Whether there is no message yet."""
        return not self._entries

    def add(self, channel: int, number: int, data: bytes, stamp_ns: int) -> None:
        """Append message ``number`` of a channel; its stamp is both log and publish time [ns]."""
        entry = stamp_ns, len(self.data)
        entries = self._entries.get(channel)
        if entries is None:
            self._entries[channel] = [entry]
        else:
            entries.append(entry)
        length = _MESSAGE.size - _HEAD + len(data)
        self.data += _MESSAGE.pack(_MESSAGE_CODE, length, channel, number, stamp_ns, stamp_ns)
        self.data += data

    def packed(self, compressor: zstandard.ZstdCompressor, offset: int) -> PackedChunk:
        """The chunk, which holds a message at least, as it is to lie at ``offset`` of the file."""
        stamps = [stamp for entries in self._entries.values() for stamp, _ in entries]
        start_ns, end_ns = min(stamps), max(stamps)
        packed = compressor.compress(self.data)
        chunk = _CHUNK.pack(
            Opcode.CHUNK, _CHUNK.size - _HEAD + len(packed), start_ns, end_ns,
            len(self.data), zlib.crc32(self.data), len(_COMPRESSION), _COMPRESSION, len(packed),
        )
        records = [chunk, packed]
        length = len(chunk) + len(packed)
        places = []
        at = offset + length
        for channel, entries in self._entries.items():
            places.append(_CHUNK_INDEX_ENTRY.pack(channel, at))
            records.append(_message_index(channel, entries))
            at += len(records[-1])
        where = b''.join(places)
        size = _CHUNK_INDEX.size + len(where) + _CHUNK_INDEX_TAIL.size
        head = _CHUNK_INDEX.pack(
            Opcode.CHUNK_INDEX, size - _HEAD, start_ns, end_ns, offset, length, len(where)
        )
        tail = _CHUNK_INDEX_TAIL.pack(
            at - offset - length, len(_COMPRESSION), _COMPRESSION, len(packed), len(self.data)
        )
        return PackedChunk(b''.join(records), head + where + tail)


def _message_index(channel: int, entries: list[tuple[int, int]]) -> bytes:
    """The record that says where in a chunk the messages of a channel are, by stamp."""
    size = _INDEX_ENTRY.size * len(entries)
    head = _INDEX.pack(_INDEX_CODE, _INDEX.size - _HEAD + size, channel, size)
    return head + b''.join([_INDEX_ENTRY.pack(*entry) for entry in entries])
