"""Read an MCAP file from its first byte to its end, or to the first damage.

Neither index nor footer is needed, so a file whose writer was killed is read up to its last flush.
Chunks and records are opened by the library ``mcap``, and every checksum is compared. Its
``StreamReader`` is not used for the loop over them, because it parses all indexes of messages,
which takes longer than reading the messages.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

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
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.layout import compressed
from taxinet_ros.bag.storage.records import MAGIC
from taxinet_ros.bag.topics import TopicInfo

PROFILES = ('ros2', '')
"""MCAP profiles read; other recorders leave it empty."""
MAX_RECORD_BYTES = 256 * 2**20
"""Maximum size of a record, and of a chunk when decompressed; recorders write about 1 MB."""

_HEAD = struct.Struct('<BQ')
"""Record header: opcode, length of the body."""
_MESSAGE = struct.Struct('<HIQQ')
_FOOTER_BYTES = _HEAD.size + 20
_TAIL_BYTES = _FOOTER_BYTES + len(MAGIC)
_KINDS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
    Opcode.DATA_END: DataEnd,
}
_NOT_IN_DATA = frozenset({
    0, Opcode.FOOTER, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.STATISTICS,
    Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET,
})
_ZSTD = b'\x28\xb5\x2f\xfd'
"""Start of a message compressed by rosbag2; a CDR message starts with a zero."""
_MALFORMED = (
    McapError, struct.error, ValueError, OverflowError, MemoryError, LookupError, RuntimeError,
    zstandard.ZstdError,
)
"""Errors of the libraries for bytes that are no valid record or chunk."""


class StoredMessage(NamedTuple):
    """One message with its topic's description; log time and publish time [ns]."""

    topic: TopicInfo
    stamp_ns: int
    cdr: bytes
    published_ns: int


Stored = TopicInfo | StoredMessage | Metadata | Attachment


class McapFile:
    """An MCAP file, read once.

    Attributes:
        path: the file.
        messages: number of messages read so far.
        unchecked: number of messages that no checksum covers, so that damage is not detected.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.messages = 0
        self._schemas: dict[int, Schema] = {}
        self._topics: dict[int, TopicInfo] = {}
        self.unchecked = 0

    def records(self) -> Iterator[Stored]:
        """Yield topics, messages, metadata and attachments in the order of the file.

        A topic always precedes its messages. Chunks are yielded only if intact.

        Raises:
            BagTruncated, BagCorrupt: damage; all before it was yielded.
            BagEmpty: the file is empty.
            BagForeign: not a ROS 2 MCAP file.
            BagError: the file cannot be read.
        """
        try:
            with self.path.open('rb') as stream:
                yield from self._records(stream)
        except OSError as error:
            raise BagError(f'{self.path}: cannot read: {error.strerror}', path=self.path) from error

    def _records(self, stream: BinaryIO) -> Iterator[Stored]:
        size = os.fstat(stream.fileno()).st_size
        magic = stream.read(len(MAGIC))
        if not magic:
            raise BagEmpty(f'{self.path}: has no bytes', path=self.path)
        if not MAGIC.startswith(magic):
            raise BagForeign(f'{self.path}: not an MCAP file', path=self.path)
        offset, crc = len(magic), zlib.crc32(magic)
        while True:
            try:
                head, body = _next_record(stream, size - offset)
                found = self._parsed(head[0], body)
                if isinstance(found, DataEnd):
                    behind = offset + len(head) + len(body)
                    self._check_end(found, crc, _read_tail(stream, size - behind), behind)
                    return
            except BagForeign:
                raise
            except (BagError, OSError, *_MALFORMED) as error:  # a disk may fail amid a file, too
                raise self._damage(error, offset) from error
            yield from found
            offset += len(head) + len(body)
            crc = zlib.crc32(body, zlib.crc32(head, crc))

    def _damage(self, error: Exception, offset: int) -> BagError:
        kind = BagTruncated if isinstance(error, BagTruncated) else BagCorrupt
        what = str(error) if isinstance(error, BagError | CRCValidationError | OSError) else (
            f'not a valid record: {type(error).__name__} {error}'.rstrip()
        )
        text = f'{self.path}: at byte {offset}: {what}; {self.messages} intact messages before'
        return kind(text, path=self.path, offset=offset)

    def _parsed(self, opcode: int, body: bytes) -> Sequence[Stored] | DataEnd:
        if opcode in _NOT_IN_DATA:
            raise BagCorrupt(f'record of kind {opcode} within the data')
        if opcode == Opcode.MESSAGE:
            message = self._message(body, 0, len(body))
            self.messages += 1
            self.unchecked += 1
            return (message,)
        record = _parsed(opcode, body)
        if isinstance(record, Chunk):
            before, found = self.messages, self._in_chunk(_opened(record))
            if not record.uncompressed_crc:
                self.unchecked += self.messages - before
            return found
        if isinstance(record, Schema | Channel):
            return self._declared(record)
        if isinstance(record, Header) and record.profile not in PROFILES:
            text = f'{self.path}: MCAP of profile {record.profile!r}, not {PROFILES[0]}'
            raise BagForeign(text, path=self.path)
        if isinstance(record, Attachment):
            _check_attachment(body)
        if isinstance(record, DataEnd):
            return record
        return (record,) if isinstance(record, Metadata | Attachment) else ()

    def _in_chunk(self, raw: bytes) -> Sequence[Stored]:
        found: list[Stored] = []
        count = start = 0
        while start < len(raw):
            opcode, length = _HEAD.unpack_from(raw, start)
            start += _HEAD.size
            end = start + length
            if opcode == Opcode.MESSAGE:
                found.append(self._message(raw, start, end))
                count += 1
            else:
                record = _parsed(opcode, raw[start:end])
                if isinstance(record, Schema | Channel):
                    found += self._declared(record)
            start = end
        if start != len(raw):
            raise BagCorrupt('records do not fill their chunk')
        self.messages += count
        return found

    def _message(self, raw: bytes, start: int, end: int) -> StoredMessage:
        channel, _, stamp_ns, published_ns = _MESSAGE.unpack_from(raw, start)
        topic = self._topics.get(channel)
        if topic is None:
            raise BagCorrupt(f'message on unknown channel {channel}')
        cdr = raw[start + _MESSAGE.size:end]
        if topic.encoding == 'cdr' and cdr.startswith(_ZSTD):
            raise BagForeign(compressed(self.path, 'message'), path=self.path)
        return StoredMessage(topic, stamp_ns, cdr, published_ns)

    def _declared(self, record: Schema | Channel) -> Sequence[TopicInfo]:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
            return ()
        schema = self._schemas.get(record.schema_id)
        if schema is None and record.schema_id:
            raise BagCorrupt(f'channel {record.topic} names unknown schema {record.schema_id}')
        readable = schema and schema.encoding == 'ros2msg'
        topic = self._topics[record.id] = TopicInfo(
            name=record.topic,
            type=schema.name if schema else '',
            qos=record.metadata.get('offered_qos_profiles', ''),
            definition=schema.data.decode('utf-8', 'replace') if schema and readable else '',
            type_hash=record.metadata.get('topic_type_hash', ''),
            encoding=record.message_encoding,
        )
        return (topic,)

    def _check_end(self, end: DataEnd, crc: int, tail: bytes, start: int) -> None:
        """Compare the data with its checksum and with the summary in ``tail``."""
        statistics, _ = _summary(tail, start)
        if end.data_section_crc not in (0, crc):
            raise BagCorrupt('the data contradicts its checksum')
        if statistics is not None and statistics.message_count != self.messages:
            raise BagCorrupt(f'{self.messages} messages of {statistics.message_count} found')
        if end.data_section_crc:
            self.unchecked = 0


def _opened(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    if size > MAX_RECORD_BYTES:
        raise BagCorrupt(f'chunk declares {size} bytes, more than {MAX_RECORD_BYTES}')
    if chunk.compression not in ('', 'zstd', 'lz4'):
        raise BagCorrupt(f'chunk has unknown compression {chunk.compression!r}')
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    if length != size:
        raise BagCorrupt(f'chunk declares {size} bytes but holds {length}')
    return stream.read(length)


def read_statistics(path: Path) -> dict[str, int]:
    """Number of messages by topic name, from the summary of the file at ``path``.

    Raises:
        BagTruncated: the end of the file is missing.
        BagCorrupt: the summary is inconsistent.
    """
    try:
        with path.open('rb') as stream:
            size = stream.seek(0, os.SEEK_END)
            stream.seek(max(0, size - _TAIL_BYTES))
            start = _footer(stream.read()).summary_start
            if not 0 < start <= size - _TAIL_BYTES:
                raise BagCorrupt(f'summary at byte {start} of {size}')
            stream.seek(start)
            statistics, names = _summary(_read_tail(stream, size - start), start)
    except OSError as error:
        raise BagError(f'{path}: cannot read: {error.strerror}', path=path) from error
    except (BagError, *_MALFORMED) as error:
        kind = type(error) if isinstance(error, BagError) else BagCorrupt
        raise kind(f'{path}: {error}', path=path) from error
    if statistics is None:
        raise BagCorrupt(f'{path}: no statistics in the summary', path=path)
    counts = dict.fromkeys(names.values(), 0)
    for channel, name in names.items():  # Another recorder's topic may have several.
        counts[name] += statistics.channel_message_counts.get(channel, 0)
    return counts


def _next_record(stream: BinaryIO, left: int) -> tuple[bytes, bytes]:
    """Header and body of the next record; ``left`` is the size of the rest of the file."""
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise BagTruncated('the end of the file is missing')
    _, length = _HEAD.unpack(head)
    if length > left - _HEAD.size:
        raise BagTruncated(f'a record of {length} bytes does not fit into the file')
    if length > MAX_RECORD_BYTES:
        raise BagCorrupt(f'a record declares {length} bytes, more than {MAX_RECORD_BYTES}')
    body = stream.read(length)
    if len(body) < length:
        raise BagTruncated('the file became shorter while it was read')
    return head, body


def _parsed(opcode: int, body: bytes) -> McapRecord | None:
    """Parse a record; None for message indexes and unknown kinds."""
    kind = _KINDS.get(opcode)
    if kind is None:
        return None
    stream = ReadDataStream(BytesIO(body))
    record: McapRecord = kind.read(stream)
    if stream.count != len(body):  # a length within the record is damaged
        raise BagCorrupt(f'{kind.__name__} record of {len(body)} bytes uses only {stream.count}')
    return record


def _check_attachment(body: bytes) -> None:
    (crc,) = struct.unpack('<I', body[-4:])
    if crc and zlib.crc32(body[:-4]) != crc:
        raise BagCorrupt('attachment contradicts its checksum')


def _read_tail(stream: BinaryIO, length: int) -> bytes:
    if length > MAX_RECORD_BYTES:
        raise BagCorrupt(f'{length} bytes behind the data')
    return stream.read()


def _summary(tail: bytes, start: int) -> tuple[Statistics | None, dict[int, str]]:
    """Check everything behind the data.

    Args:
        tail: bytes from the end of the data to the end of the file.
        start: offset of ``tail`` in the file.

    Returns:
        The statistics, if any, and topic names by channel number.
    """
    footer = _footer(tail[-_TAIL_BYTES:])
    summary = tail[:-_TAIL_BYTES]
    if footer.summary_start not in (start, 0) or bool(summary) != bool(footer.summary_start):
        raise BagCorrupt(f'footer places the summary at {footer.summary_start}, not at {start}')
    if footer.summary_crc and footer.summary_crc != zlib.crc32(tail[:-len(MAGIC) - 4]):
        raise BagCorrupt('summary contradicts its checksum')
    statistics: Statistics | None = None
    names: dict[int, str] = {}
    place = 0
    while place < len(summary):
        opcode, length = _HEAD.unpack_from(summary, place)
        place += _HEAD.size
        body = summary[place:place + length]
        if opcode == Opcode.STATISTICS:
            statistics = Statistics.read(ReadDataStream(BytesIO(body)))
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(body)))
            names[channel.id] = channel.topic
        place += length
    return statistics, names


def _footer(tail: bytes) -> Footer:
    if len(tail) < _TAIL_BYTES or tail[-len(MAGIC):] != MAGIC:
        raise BagTruncated('the end of the file is missing')
    opcode, length = _HEAD.unpack_from(tail)
    if (opcode, length) != (Opcode.FOOTER, _FOOTER_BYTES - _HEAD.size):
        raise BagCorrupt('malformed footer')
    return Footer.read(ReadDataStream(BytesIO(tail[_HEAD.size:])))
