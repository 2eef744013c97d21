"""MCAP writer whose file stays readable up to the last flush after any failure.

The record layout follows the `MCAP specification <https://mcap.dev/spec>`_. ``mcap.writer`` is not
used, because it cannot write schemas and channels outside chunks; with them outside, one damaged
chunk costs a few messages instead of the whole file. It also writes chunks, one per control step,
field by field, and copies camera frames more often.
"""

from __future__ import annotations

import errno as numbers
import os
import struct
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from taxinet_ros.bag.errors import BagError, BagWriteError
from taxinet_ros.bag.storage.records import MAGIC, encode
from taxinet_ros.bag.topics import TopicInfo


class Output:
    """Unbuffered output to a new file; data written by :meth:`put` survive the process's end.

    After the first error nothing is written and every call raises it again, so that a full disk is
    not hidden by a later small write that fits.

    Attributes:
        path: the file.
        size: number of bytes written, which is the offset of the next one.
        crc: CRC-32 of all bytes written.
    """

    def __init__(self, path: Path, *, keep_free_bytes: int = 0) -> None:
        """Create the file, which must not exist.

        Args:
            path: the file.
            keep_free_bytes: disk space to keep free [bytes], so that other files on it, such as a
                campaign's record, can still be written.
        """
        self.path = path
        self.size = 0
        self.crc = 0
        self._failure: tuple[str, int] | None = None
        self._descriptor = -1
        self._keep_free_bytes = keep_free_bytes
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        try:
            self._descriptor = os.open(path, flags, 0o644)
        except OSError as error:
            raise self._latch(error) from error

    @property
    def open(self) -> bool:
        """Whether the file is still open."""
        return self._descriptor >= 0

    def check(self) -> None:
        """Raise the earlier error, if any, or an error if the file is closed."""
        if self._failure is not None:
            message, errno = self._failure
            raise BagWriteError(message, path=self.path, errno=errno)
        if self._descriptor < 0:
            raise BagError(f'{self.path}: the bag is closed; nothing can be added', path=self.path)

    def put(self, data: bytes) -> None:
        """Write all of ``data``, or leave the file as it was and raise :class:`BagWriteError`."""
        self.check()
        view = memoryview(data)
        try:
            self._check_room(len(data))
            while view:
                view = view[os.write(self._descriptor, view):]
        except OSError as error:
            with suppress(OSError):  # Remove a partial record, if possible.
                os.ftruncate(self._descriptor, self.size)
            raise self._latch(error) from error
        self.size += len(data)
        self.crc = zlib.crc32(data, self.crc)

    def sync(self) -> None:
        """Flush all data to the storage device."""
        self.check()
        try:
            os.fsync(self._descriptor)
        except OSError as error:
            raise self._latch(error) from error

    def close(self) -> None:
        """Close the file; closing twice is harmless."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor < 0:
            return
        try:
            os.close(descriptor)
        except OSError as error:
            raise self._latch(error) from error

    def _check_room(self, wanted: int) -> None:
        if not self._keep_free_bytes:
            return
        disk = os.fstatvfs(self._descriptor)
        free = disk.f_bavail * disk.f_frsize
        if free - wanted < self._keep_free_bytes:
            left = f'{free / 1e6:.0f} MB free, {self._keep_free_bytes / 1e6:.0f} MB of it kept so'
            raise OSError(numbers.ENOSPC, f'{os.strerror(numbers.ENOSPC)} ({left})')

    def _latch(self, error: OSError) -> BagWriteError:
        errno = error.errno or 0
        message = f'{self.path}: cannot write: [Errno {errno}] {error.strerror}'
        self._failure = (message, errno)
        return BagWriteError(message, path=self.path, errno=errno)


_COMPRESSION = b'zstd'
_HEAD = 9
"""Size of a record's opcode and length, which its length does not include."""
# Enum lookups are slow, and these codes are needed for every message.
_MESSAGE_CODE, _INDEX_CODE = int(Opcode.MESSAGE), int(Opcode.MESSAGE_INDEX)
_MESSAGE = struct.Struct('<BQHIQQ')
_CHUNK = struct.Struct('<BQQQQII4sQ')
_INDEX = struct.Struct('<BQHI')
_INDEX_ENTRY = struct.Struct('<QQ')
_INDEX_OF_ONE = struct.Struct('<BQHIQQ')
_LATEST_NS = 2**64 - 1
_CHUNK_INDEX = struct.Struct('<BQQQQQI')
_CHUNK_INDEX_ENTRY = struct.Struct('<HQ')
_CHUNK_INDEX_TAIL = struct.Struct('<QI4sQQ')


class PackedChunk(NamedTuple):
    """A serialised chunk.

    Attributes:
        records: the chunk and its message indexes.
        summary: the chunk index record, for the summary of the file.
    """

    records: bytes
    summary: bytes


class ChunkBuilder:
    """Collects the messages of a chunk, uncompressed.

    Attributes:
        data: the records in the chunk.
    """

    def __init__(self, head: bytes = b'') -> None:
        """Start with the records ``head``."""
        self.data = bytearray(head)
        self._entries: dict[int, list[tuple[int, int]]] = {}
        self._start_ns, self._end_ns = _LATEST_NS, 0

    @property
    def empty(self) -> bool:
        """Whether there is no message yet."""
        return not self._entries

    def add(
        self, channel: int, number: int, data: bytes, stamp_ns: int, published_ns: int
    ) -> None:
        """Append message ``number`` of a channel, with its log time and publish time [ns]."""
        entry = stamp_ns, len(self.data)
        entries = self._entries.get(channel)
        if entries is None:
            self._entries[channel] = [entry]
        else:
            entries.append(entry)
        if stamp_ns < self._start_ns:
            self._start_ns = stamp_ns
        if stamp_ns > self._end_ns:
            self._end_ns = stamp_ns
        length = _MESSAGE.size - _HEAD + len(data)
        self.data += _MESSAGE.pack(_MESSAGE_CODE, length, channel, number, stamp_ns, published_ns)
        self.data += data

    def packed(self, compressor: zstandard.ZstdCompressor, offset: int) -> PackedChunk:
        """Serialise the chunk, which must contain a message, for ``offset`` in the file."""
        start_ns, end_ns = self._start_ns, self._end_ns
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
    """Message index record of a channel: stamps and offsets of its messages in a chunk."""
    if len(entries) == 1:
        return _INDEX_OF_ONE.pack(
            _INDEX_CODE, _INDEX_OF_ONE.size - _HEAD, channel, _INDEX_ENTRY.size, *entries[0]
        )
    size = _INDEX_ENTRY.size * len(entries)
    head = _INDEX.pack(_INDEX_CODE, _INDEX.size - _HEAD + size, channel, size)
    return head + b''.join([_INDEX_ENTRY.pack(*entry) for entry in entries])


CHUNK_BYTES = 32 * 1024
"""A chunk ends at the first message beyond this size, so camera frames have their own chunks."""
COMPRESSION_LEVEL = 1
"""zstd level: on camera frames a third of the default's time, for a sixth more bytes."""


class StorageFile:
    """An ``.mcap`` file being written.

    Attributes:
        output: the underlying file.
        counts: number of messages so far by topic name.
        start_ns, end_ns: minimum and maximum stamp so far [ns]; 0 without messages.
    """

    def __init__(
        self, path: Path, *, topics: Iterable[TopicInfo], library: str, keep_free_bytes: int = 0
    ) -> None:
        """Create the file and write its head: the topics, outside any chunk."""
        self.output = Output(path, keep_free_bytes=keep_free_bytes)
        self.start_ns = 0
        self.end_ns = 0
        self._schemas: dict[str, Schema] = {}
        self._channels: dict[str, Channel] = {}
        for topic in topics:
            self._declare(topic)
        self.counts = dict.fromkeys(self._channels, 0)
        self._compressor = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
        self._started = False
        self._chunk_indexes: list[bytes] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self.output.put(MAGIC + encode(Header('ros2', library)) + self._declarations())
        # Repeated under the first chunk's checksum, so that damage to the copy above is detected.
        self._chunk = ChunkBuilder(self._declarations())

    def add_message(self, topic: str, data: bytes, stamp_ns: int, published_ns: int) -> None:
        """Append one message, with its log time and publish time [ns]."""
        self.output.check()
        if len(self._chunk.data) + len(data) > CHUNK_BYTES and not self._chunk.empty:
            self.finish_chunk()
        number = self.counts[topic]
        self._chunk.add(self._channels[topic].id, number, data, stamp_ns, published_ns)
        if stamp_ns < self.start_ns or not self._started:
            self.start_ns, self._started = stamp_ns, True
        if stamp_ns > self.end_ns:
            self.end_ns = stamp_ns
        self.counts[topic] = number + 1
        if len(self._chunk.data) > CHUNK_BYTES:
            self.finish_chunk()

    def add_attachment(self, attachment: Attachment) -> None:
        """Append an attachment."""
        record = encode(attachment)
        index = AttachmentIndex(
            offset=self.output.size, length=len(record), log_time=attachment.log_time,
            create_time=attachment.create_time, data_size=len(attachment.data),
            name=attachment.name, media_type=attachment.media_type,
        )
        self.output.put(record)
        self._attachments.append(index)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append a metadata record."""
        record = encode(Metadata(name=name, metadata=dict(values)))
        index = MetadataIndex(offset=self.output.size, length=len(record), name=name)
        self.output.put(record)
        self._metadata.append(index)

    def finish_chunk(self) -> None:
        """Write the current chunk to the operating system, unless it has no messages."""
        self.output.check()
        if self._chunk.empty:
            return
        records, summary = self._chunk.packed(self._compressor, self.output.size)
        self.output.put(records)
        self._chunk_indexes.append(summary)
        self._chunk = ChunkBuilder()

    def finish(self) -> None:
        """Complete the file: write end of data, summary and footer, with checksums."""
        self.finish_chunk()
        self.output.put(encode(DataEnd(self.output.crc)))
        start = self.output.size
        groups = self._summary()
        summary = b''.join(data for _, data in groups)
        offsets = _encoded(_offsets(start, groups))
        footer = Footer(
            summary_start=start, summary_offset_start=start + len(summary), summary_crc=0
        )
        footer.summary_crc = zlib.crc32(summary + offsets + encode(footer)[:-4])
        self.output.put(summary + offsets + encode(footer) + MAGIC)

    def _declare(self, topic: TopicInfo) -> None:
        schema = self._schemas.setdefault(topic.type, Schema(
            id=len(self._schemas) + 1, name=topic.type, encoding='ros2msg',
            data=topic.definition.encode(),
        ))
        self._channels[topic.name] = Channel(
            id=len(self._channels) + 1, schema_id=schema.id, topic=topic.name,
            message_encoding='cdr',
            metadata={'offered_qos_profiles': topic.qos, 'topic_type_hash': topic.type_hash},
        )

    def _declarations(self) -> bytes:
        return _encoded([*self._schemas.values(), *self._channels.values()])

    def _summary(self) -> list[tuple[Opcode, bytes]]:
        """Records of the summary section by kind; without empty groups, which confuse readers."""
        numbers = {channel.id: self.counts[topic] for topic, channel in self._channels.items()}
        statistics = Statistics(
            attachment_count=len(self._attachments), channel_count=len(self._channels),
            channel_message_counts=numbers, chunk_count=len(self._chunk_indexes),
            message_count=sum(numbers.values()), message_end_time=self.end_ns,
            message_start_time=self.start_ns, metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups = [
            (Opcode.SCHEMA, _encoded(self._schemas.values())),
            (Opcode.CHANNEL, _encoded(self._channels.values())),
            (Opcode.STATISTICS, _encoded([statistics])),
            (Opcode.CHUNK_INDEX, b''.join(self._chunk_indexes)),
            (Opcode.ATTACHMENT_INDEX, _encoded(self._attachments)),
            (Opcode.METADATA_INDEX, _encoded(self._metadata)),
        ]
        return [(code, records) for code, records in groups if records]


def _encoded(records: Iterable[McapRecord]) -> bytes:
    return b''.join(map(encode, records))


def _offsets(start: int, groups: list[tuple[Opcode, bytes]]) -> Iterable[SummaryOffset]:
    for code, data in groups:
        yield SummaryOffset(group_opcode=code, group_start=start, group_length=len(data))
        start += len(data)
