"""An MCAP file, written so that it stays readable up to the last flush whatever happens.

The record layout is the `MCAP specification <https://mcap.dev/spec>`_'s. A writer of our own, since
``mcap.writer`` has no way to put schemas and channels outside chunks, which decides whether one
damaged chunk costs a few messages or the whole file.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
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

from taxinet_ros.bag.chunk import Chunk
from taxinet_ros.bag.output import Output
from taxinet_ros.bag.topics import TopicInfo

MAGIC = b'\x89MCAP0\r\n'
CHUNK_BYTES = 32 * 1024
"""A chunk ends at the first message beyond this size, so that camera frames lie alone."""

COMPRESSION_LEVEL = 1
"""Of zstd: on camera frames a third of the time of its default, for a sixth more bytes."""


class StorageFile:
    """One ``.mcap`` file in the making.

    Attributes:
        output: the file below.
        counts: messages so far by topic name.
        start_ns, end_ns: least and greatest stamp so far [ns]; 0 without messages.
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
        # Once more under the first chunk's checksum, so that damage to the copy above shows.
        self._chunk = Chunk(self._declarations())

    def add_message(self, topic: str, data: bytes, stamp_ns: int) -> None:
        """Append one message; its stamp is both log and publish time."""
        self.output.check()
        if len(self._chunk.data) + len(data) > CHUNK_BYTES and not self._chunk.empty:
            self.finish_chunk()
        number = self.counts[topic]
        self._chunk.add(self._channels[topic].id, number, data, stamp_ns)
        if stamp_ns < self.start_ns or not self._started:
            self.start_ns, self._started = stamp_ns, True
        if stamp_ns > self.end_ns:
            self.end_ns = stamp_ns
        self.counts[topic] = number + 1
        if len(self._chunk.data) > CHUNK_BYTES:
            self.finish_chunk()

    def add_attachment(self, name: str, data: bytes, *, media_type: str) -> None:
        """Append a file by the name of ``name``, stamped with the latest message's time."""
        record = encode(Attachment(
            create_time=self.end_ns, log_time=self.end_ns, name=name, media_type=media_type,
            data=data,
        ))
        index = AttachmentIndex(
            offset=self.output.size, length=len(record), log_time=self.end_ns,
            create_time=self.end_ns, data_size=len(data), name=name, media_type=media_type,
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
        """Hand everything to the operating system; no chunk is written without messages."""
        self.output.check()
        if self._chunk.empty:
            return
        records, summary = self._chunk.packed(self._compressor, self.output.size)
        self.output.put(records)
        self._chunk_indexes.append(summary)
        self._chunk = Chunk()

    def finish(self) -> None:
        """Write what makes the file complete: end of data, summary, footer, with checksums."""
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
        """The records of the summary section by kind; readers stumble over kinds without any."""
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


def encode(record: McapRecord) -> bytes:
    """The bytes of one MCAP record."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _encoded(records: Iterable[McapRecord]) -> bytes:
    return b''.join(map(encode, records))


def _offsets(start: int, groups: list[tuple[Opcode, bytes]]) -> Iterable[SummaryOffset]:
    for code, data in groups:
        yield SummaryOffset(group_opcode=code, group_start=start, group_length=len(data))
        start += len(data)
