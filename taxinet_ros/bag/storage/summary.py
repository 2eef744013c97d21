"""Read and check the end of an MCAP file: summary, indexes and footer.

They are checked against their checksum and the data: players find messages through the indexes, so
a wrong index hides messages of an otherwise intact file. Damage to the data is detected by
:mod:`taxinet_ros.bag.storage.scan`.
"""

from __future__ import annotations

import mmap
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Footer,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from taxinet_ros.bag.errors import BagCorrupt, BagError, BagTruncated
from taxinet_ros.bag.storage.records import (
    HEAD,
    MAGIC,
    MAX_RECORD_BYTES,
    ReadBudget,
    open_chunk,
    parse_index,
    parse_record,
    placed_records,
    split_records,
)

_FOOTER_BYTES = HEAD.size + 20
_TAIL_BYTES = _FOOTER_BYTES + len(MAGIC)


def read_statistics(path: Path) -> dict[str, int]:
    """Number of messages by topic name, from the summary of the file at ``path``.

    Raises:
        BagTruncated: the end of the file is missing.
        BagCorrupt: the summary is inconsistent.
    """
    try:
        with path.open('rb') as stream:
            size = stream.seek(0, 2)
            stream.seek(max(0, size - _TAIL_BYTES))
            start = _footer(stream.read()).summary_start
            if not 0 < start <= size - _TAIL_BYTES or size - start > MAX_RECORD_BYTES:
                raise BagCorrupt(f'summary at byte {start} of {size}')
            stream.seek(start)
            statistics, names = check_summary(stream.read(), start)
    except OSError as error:
        raise BagError(f'{path}: cannot read: {error.strerror}', path=path) from error
    except BagError as error:
        raise type(error)(f'{path}: {error}', path=path) from error
    if statistics is None:
        raise BagCorrupt(f'{path}: no statistics in the summary', path=path)
    counts = dict.fromkeys(names.values(), 0)
    for channel, name in names.items():  # Another recorder's topic may have several.
        counts[name] += statistics.channel_message_counts.get(channel, 0)
    return counts


def check_summary(tail: bytes, start: int) -> tuple[Statistics | None, dict[int, str]]:
    """Check everything after the data section.

    Args:
        tail: bytes from the end of the data section to the end of the file.
        start: offset of ``tail`` in the file.

    Returns:
        The statistics record, if any, and topic names by channel number.

    Raises:
        BagTruncated: the end mark is missing.
        BagCorrupt: checksum or offsets are wrong.
    """
    footer = _footer(tail[-_TAIL_BYTES:])
    summary = tail[:-_TAIL_BYTES]
    if footer.summary_start not in (start, 0) or bool(summary) != bool(footer.summary_start):
        raise BagCorrupt(f'footer places the summary at {footer.summary_start}, not at {start}')
    if footer.summary_crc and footer.summary_crc != zlib.crc32(tail[:-len(MAGIC) - 4]):
        raise BagCorrupt('summary contradicts its checksum')
    statistics: Statistics | None = None
    names: dict[int, str] = {}
    for opcode, body in split_records(summary):
        record = parse_record(opcode, body)
        if isinstance(record, Statistics):
            statistics = record
        elif isinstance(record, Channel):
            names[record.id] = record.topic
    return statistics, names


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Content of a file's summary that is used to read around damage.

    Attributes:
        start: offset of the summary and end of the data.
        declarations: schemas and channels, each schema before its channels.
        chunks: chunk indexes, in the order of the file.
    """

    start: int
    declarations: tuple[Schema | Channel, ...]
    chunks: tuple[ChunkIndex, ...]


def sound_summary(data: mmap.mmap) -> Summary | None:
    """Summary of a file if it is verified by its checksum, else None."""
    try:
        start = _footer(data[max(0, len(data) - _TAIL_BYTES):]).summary_start
        if not 0 < start <= len(data) - _TAIL_BYTES or len(data) - start > MAX_RECORD_BYTES:
            return None
        tail = data[start:]
        if not _footer(tail[-_TAIL_BYTES:]).summary_crc:
            return None
        check_summary(tail, start)
        records = [
            parse_record(opcode, body) or parse_index(opcode, body)
            for opcode, body in split_records(tail[:-_TAIL_BYTES])
        ]
    except BagError:
        return None
    chunks = [record for record in records if isinstance(record, ChunkIndex)]
    return Summary(
        start=start,
        declarations=(
            *(record for record in records if isinstance(record, Schema)),
            *(record for record in records if isinstance(record, Channel)),
        ),
        chunks=tuple(sorted(chunks, key=lambda chunk: chunk.chunk_start_offset)),
    )


def _footer(tail: bytes) -> Footer:
    if len(tail) < _TAIL_BYTES or tail[-len(MAGIC):] != MAGIC:
        raise BagTruncated('the end of the file is missing')
    opcode, length = HEAD.unpack_from(tail)
    body = tail[HEAD.size:-len(MAGIC)]
    footer = parse_record(opcode, body) if opcode == Opcode.FOOTER else None
    if length != len(body) or not isinstance(footer, Footer):
        raise BagCorrupt('malformed footer')
    return footer


MAX_CHUNK_MESSAGES = 1_000_000
"""Maximum messages per chunk; recorders write chunks of about 1 MB, larger ones are malicious."""
Entries = dict[int, list[tuple[int, int]]]
"""Stamp [ns] and offset in the chunk of each message, by channel."""


class IndexTrouble(NamedTuple):
    """A problem of an index: byte offset in the file, and a one-line description."""

    offset: int
    what: str


def index_troubles(path: Path) -> tuple[IndexTrouble, ...]:
    """Problems of the indexes of a file with valid checksums.

    Raises:
        BagError: the file cannot be read, or a checksum is invalid.
    """
    try:
        size = path.stat().st_size
        check = _IndexCheck(work=ReadBudget(size))
        with path.open('rb') as stream:
            for offset, opcode, body in _records(stream, size):
                check.note(offset, opcode, body)
    except OSError as error:
        raise BagError(f'{path}: cannot read: {error.strerror}', path=path) from error
    except BagError as error:
        raise type(error)(f'{path}: {error}', path=path) from error
    check.finish()
    return tuple(check.troubles)


def _records(stream: BinaryIO, size: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield offset, opcode and body of all records of the file."""
    offset = len(MAGIC)
    stream.seek(offset)
    while offset < size - len(MAGIC):
        head = stream.read(HEAD.size)
        if len(head) < HEAD.size:
            raise BagCorrupt(f'at byte {offset}: no whole record')
        opcode, length = HEAD.unpack(head)
        if length > min(size - offset - HEAD.size, MAX_RECORD_BYTES):
            raise BagCorrupt(f'at byte {offset}: a record of {length} bytes')
        yield offset, opcode, stream.read(length)
        offset += HEAD.size + length


@dataclass
class _IndexCheck:
    """Collects the content of the data section, then compares the summary with it."""

    work: ReadBudget
    troubles: list[IndexTrouble] = field(default_factory=list)
    chunks: dict[int, ChunkIndex] = field(default_factory=dict)
    files: dict[int, AttachmentIndex] = field(default_factory=dict)
    words: dict[int, MetadataIndex] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    groups: dict[int, tuple[int, int]] = field(default_factory=dict)
    pending: Entries = field(default_factory=dict)
    chunk: ChunkIndex | None = None
    schemas: set[int] = field(default_factory=set)
    stamps: tuple[int, int] | None = None
    totals: dict[str, int] = field(default_factory=dict)
    end: int = 0
    told: int = 0

    def note(self, offset: int, opcode: int, body: bytes) -> None:
        """Process one record of the file."""
        record = parse_record(opcode, body) or parse_index(opcode, body)
        length = HEAD.size + len(body)
        if self.end:
            self._hold_against(offset, record)
            self._note_group(offset, opcode, length)
        elif opcode == Opcode.DATA_END:
            self._close_chunk()
            self._sum_up()
            self.end = offset
        else:
            self._note_data(offset, length, record)

    def finish(self) -> None:
        """Report data that is missing in the summary; call after the last record."""
        if self.told == 0 and self.chunks:
            self.troubles.append(
                IndexTrouble(self.end, 'no index: players must read the whole file')
            )
            return
        for what, left in (('chunk', self.chunks), ('file', self.files), ('words', self.words)):
            self.troubles += [IndexTrouble(offset, f'{what} in no index') for offset in left]

    def _note_data(self, offset: int, length: int, record: McapRecord | None) -> None:
        if isinstance(record, MessageIndex):
            self._note_entries(offset, length, record)
            return
        self._close_chunk()
        if isinstance(record, Chunk):
            self._note_chunk(offset, length, record)
        elif isinstance(record, Message):
            self._count(record)
        elif isinstance(record, Schema):
            self.schemas.add(record.id)
        elif isinstance(record, Channel):
            self.counts.setdefault(record.id, 0)
        elif isinstance(record, Attachment):
            self.files[offset] = AttachmentIndex(
                offset=offset, length=length, log_time=record.log_time,
                create_time=record.create_time, data_size=len(record.data), name=record.name,
                media_type=record.media_type,
            )
        elif isinstance(record, Metadata):
            self.words[offset] = MetadataIndex(offset=offset, length=length, name=record.name)

    def _note_chunk(self, offset: int, length: int, chunk: Chunk) -> None:
        stamps = []
        for place, record in placed_records(open_chunk(chunk, self.work), self.work):
            if isinstance(record, Message):
                self._count(record)
                stamps.append(record.log_time)
                self.pending.setdefault(record.channel_id, []).append((record.log_time, place))
                if len(stamps) > MAX_CHUNK_MESSAGES:
                    text = f'at byte {offset}: more than {MAX_CHUNK_MESSAGES} messages in a chunk'
                    raise BagCorrupt(text)
            elif isinstance(record, Schema):
                self.schemas.add(record.id)
            elif isinstance(record, Channel):
                self.counts.setdefault(record.id, 0)
        self.chunk = ChunkIndex(
            chunk_length=length, chunk_start_offset=offset, compression=chunk.compression,
            compressed_size=len(chunk.data), message_end_time=max(stamps, default=0),
            message_index_length=0, message_index_offsets={},
            message_start_time=min(stamps, default=0), uncompressed_size=chunk.uncompressed_size,
        )
        if (chunk.message_start_time, chunk.message_end_time) != (
            self.chunk.message_start_time, self.chunk.message_end_time
        ):
            self.troubles.append(IndexTrouble(offset, "chunk's stamps differ from its messages'"))

    def _note_entries(self, offset: int, length: int, index: MessageIndex) -> None:
        there = self.pending.pop(index.channel_id, [])
        if sorted(index.records) != sorted(there) or self.chunk is None:
            self.troubles.append(IndexTrouble(
                offset, f'message index of channel {index.channel_id} misses its messages'
            ))
        if self.chunk is not None:
            self.chunk.message_index_offsets[index.channel_id] = offset
            self.chunk.message_index_length += length

    def _close_chunk(self) -> None:
        if self.chunk is None:
            return
        offset = self.chunk.chunk_start_offset
        for channel in self.pending:
            self.troubles.append(IndexTrouble(offset, f'messages of channel {channel} in no index'))
        self.chunks[offset] = self.chunk
        self.chunk = None
        self.pending = {}

    def _count(self, message: Message) -> None:
        stamp = message.log_time
        self.counts[message.channel_id] = self.counts.get(message.channel_id, 0) + 1
        low, high = self.stamps or (stamp, stamp)
        self.stamps = min(low, stamp), max(high, stamp)

    def _hold_against(self, offset: int, record: McapRecord | None) -> None:
        """Compare one record of the summary with the data."""
        if isinstance(record, ChunkIndex):
            there: object = self.chunks.pop(record.chunk_start_offset, None)
        elif isinstance(record, AttachmentIndex):
            there = self.files.pop(record.offset, None)
        elif isinstance(record, MetadataIndex):
            there = self.words.pop(record.offset, None)
        elif isinstance(record, Statistics):
            self._hold_numbers_against(offset, record)
            return
        elif isinstance(record, SummaryOffset):
            group = self.groups.get(record.group_opcode)
            if group != (record.group_start, record.group_length):
                self.troubles.append(IndexTrouble(offset, 'summary offset misses its group'))
            return
        else:
            return
        self.told += 1
        if record != there:
            kind = type(record).__name__
            self.troubles.append(IndexTrouble(offset, f'{kind} points to something else'))

    def _note_group(self, offset: int, opcode: int, length: int) -> None:
        start, so_far = self.groups.get(opcode, (offset, 0))
        self.groups[opcode] = start, so_far + length

    def _sum_up(self) -> None:
        start, end = self.stamps or (0, 0)
        self.totals = {
            'message_count': sum(self.counts.values()), 'schema_count': len(self.schemas),
            'channel_count': len(self.counts), 'attachment_count': len(self.files),
            'metadata_count': len(self.words), 'chunk_count': len(self.chunks),
            'message_start_time': start, 'message_end_time': end,
        }

    def _hold_numbers_against(self, offset: int, told: Statistics) -> None:
        for name, number in self.totals.items():
            if (claim := getattr(told, name)) != number:
                text = f'statistics: {name} is {claim}, in the data {number}'
                self.troubles.append(IndexTrouble(offset, text))
        counts = {channel: n for channel, n in told.channel_message_counts.items() if n}
        if counts != {channel: n for channel, n in self.counts.items() if n}:
            self.troubles.append(
                IndexTrouble(offset, 'statistics: messages per channel differ')
            )
