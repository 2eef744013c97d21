"""Read messages and the table of contents of a bag from any ROS 2 recorder.

:func:`read_contents` reads a bag in one pass: its table of contents and selected messages. An
intact file is read a few times faster than by a scan, still with all checksums and counts verified;
if one fails, a scan locates the damage and recovers the rest.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Header, Message, Metadata, Schema

from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.description import read_description
from taxinet_ros.bag.errors import BagCorrupt, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.layout import METADATA_FILE, compressed, storage_files
from taxinet_ros.bag.storage.records import (
    HEAD,
    MAGIC,
    ReadBudget,
    check_message_index,
    open_chunk,
    parse_record,
)
from taxinet_ros.bag.storage.scan import PROFILE, OnDamage, scan, unchecked
from taxinet_ros.bag.storage.summary import check_summary
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.errors import UsageError

_ZSTD = b'\x28\xb5\x2f\xfd'
"""Start of a message compressed by rosbag2; a CDR message starts with a zero."""
_TROUBLES_TOLD = 3
"""Maximum number of damaged places in one line; a damaged disk may cause hundreds."""
Wanted = Callable[[str], bool]
"""Whether to read the topic of a name."""
KeptBytes = Callable[[str], int]
"""Number of bytes to keep of each message on the topic of a name."""
_MOST_AT_ONCE_BYTES = 1 << 28
"""Larger files are scanned piece by piece, not read into memory."""
_IN_SOUND_FILES = frozenset({
    Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK, Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END,
})


class RawMessage(NamedTuple):
    """One message as stored: topic and type name, log time [ns], serialised bytes."""

    topic: str
    type: str
    stamp_ns: int
    cdr: bytes


class StoredMessage(NamedTuple):
    """One message with its topic's description; log time and publish time [ns]."""

    topic: TopicInfo
    stamp_ns: int
    cdr: bytes
    published_ns: int


@dataclass(frozen=True, kw_only=True)
class BagInfo:
    """Table of contents of a bag, as far as it can be read.

    Attributes:
        path: as given.
        topics: topics in the order of the file.
        counts: number of intact messages by topic name, including zeros.
        start_ns, end_ns: minimum and maximum stamp [ns]; 0 without messages.
        metadata: metadata records by name; the last one if a name is repeated.
        attachments: names in the order of the file.
        complete: the recording was finished and nothing is damaged.
        trouble: one line describing the damage, or empty.
        back_ns: longest time by which a message is older than one before it [ns].
        unchecked: one line about messages not covered by a checksum, or empty.
    """

    path: Path
    topics: tuple[TopicInfo, ...]
    counts: Mapping[str, int]
    start_ns: int
    end_ns: int
    metadata: Mapping[str, Mapping[str, str]]
    attachments: tuple[str, ...]
    complete: bool
    trouble: str
    back_ns: int = 0
    unchecked: str = ''

    @property
    def duration_s(self) -> float:
        """Simulated time between the first and the last message [s]."""
        return (self.end_ns - self.start_ns) / 1e9


def read_messages(path: Path, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
    """Yield the messages of a bag in the order of recording.

    Args:
        path: a run folder or an ``.mcap`` file.
        topics: names to keep; default all.

    Raises:
        BagTruncated, BagCorrupt: raised after all intact messages before the damage were yielded;
            ``recovered`` is their number.
        BagEmpty, BagForeign: nothing to read, or an unsupported bag.
        UsageError: ``path`` does not exist.
    """
    wanted = None if topics is None else frozenset(topics).__contains__
    for topic, stamp_ns, cdr, _ in stored_messages(path, wanted):
        yield RawMessage(topic.name, topic.type, stamp_ns, cdr)


def stored_messages(
    path: Path, wanted: Wanted | None = None, on_damage: OnDamage | None = None
) -> Iterator[StoredMessage]:
    """Like :func:`read_messages`, with definitions and an optional damage callback (``scan``)."""
    count = 0
    try:
        for file in storage_files(path):
            infos = _Topics()
            for record in scan(file, on_damage):
                infos.note(record)
                if not isinstance(record, Message):
                    continue
                info = infos.by_channel[record.channel_id]
                asked_for = wanted is None or wanted(info.name)
                infos.check(record, file, wanted=asked_for)
                if asked_for:
                    yield _stored(info, record)
                    count += 1
    except (BagTruncated, BagCorrupt) as error:
        message = f'{error}; {count} intact messages before'
        raise type(error)(
            message, path=error.path, recovered=count, offset=error.offset
        ) from error


def _stored(topic: TopicInfo, message: Message) -> StoredMessage:
    return StoredMessage(topic, message.log_time, message.data, message.publish_time)


def read_info(path: Path, on_damage: OnDamage | None = None) -> BagInfo:
    """Read the table of contents; damage is reported in the result, not raised.

    Args:
        path: a run folder or an ``.mcap`` file.
        on_damage: called for each damaged place in the storage files.

    Raises:
        BagEmpty, BagForeign, UsageError: as :func:`read_messages`.
    """
    contents = read_contents(path, lambda topic: 0)
    if on_damage is not None:
        for _, error in contents.damage:
            on_damage(error)
    return contents.info


def unchecked_files(path: Path) -> str:
    """One line about messages not covered by a checksum, or ''; see ``scan.unchecked``."""
    return '; '.join(filter(None, map(unchecked, storage_files(path))))


def read_attachment(path: Path, name: str) -> bytes:
    """Read the attachment ``name``; the last one if there are several.

    Raises:
        UsageError: no such attachment.
        BagError: as :func:`read_messages`, if the bag is damaged and the attachment not found.
    """
    found: bytes | None = None
    names: list[str] = []
    trouble: list[BagError] = []
    for file in storage_files(path):
        for record in scan(file, trouble.append):
            if isinstance(record, Attachment):
                names.append(record.name)
                found = record.data if record.name == name else found
    if found is not None:
        return found
    if trouble:
        raise trouble[0]
    raise UsageError(f'{path}: no attachment {name!r}; it has {", ".join(names) or "none"}')


class _Topics:
    """Topics of one file, collected from its records."""

    def __init__(self) -> None:
        self.by_channel: dict[int, TopicInfo] = {}
        self._schemas: dict[int, Schema] = {}
        self._encodings: dict[int, str] = {}

    def note(self, record: object) -> None:
        """Process a record."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self.by_channel[record.id] = self._info(record)
            self._encodings[record.id] = record.message_encoding

    def check(self, message: Message, file: Path, *, wanted: bool) -> None:
        """Raise :class:`BagForeign` for a compressed message, or a wanted one that is not CDR."""
        encoding = self._encodings[message.channel_id]
        if message.data.startswith(_ZSTD) and (wanted or encoding == 'cdr'):
            raise BagForeign(compressed(file, 'message'), path=file)
        if wanted and encoding != 'cdr':
            name = self.by_channel[message.channel_id].name
            raise BagForeign(f'{file}: topic {name}: messages are {encoding!r}, not cdr', path=file)

    def _info(self, channel: Channel) -> TopicInfo:
        schema = self._schemas[channel.schema_id]
        readable = schema.encoding == 'ros2msg'
        return TopicInfo(
            name=channel.topic,
            type=schema.name,
            qos=channel.metadata.get('offered_qos_profiles', ''),
            definition=schema.data.decode('utf-8', 'replace') if readable else '',
            type_hash=channel.metadata.get('topic_type_hash', ''),
            encoding=channel.message_encoding,
        )


@dataclass
class Contents:
    """Result of one pass over a bag.

    Attributes:
        path: as given.
        topics: topics by name, in the order of the file.
        counts: number of intact messages by topic name, including zeros.
        metadata: metadata records by name; the last one if a name is repeated.
        attachments: names of the attachments.
        messages: the selected messages, in the order of recording.
        damage: damaged places, each with the number of ``messages`` before it.
        checked: the bag is one file, completely covered by valid checksums.
    """

    path: Path
    topics: dict[str, TopicInfo] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[str] = field(default_factory=list)
    messages: list[StoredMessage] = field(default_factory=list)
    damage: list[tuple[int, BagError]] = field(default_factory=list)
    checked: bool = False
    _kept_bytes: dict[str, int] = field(default_factory=dict)
    _start_ns: int | None = None
    _end_ns: int = 0
    _back_ns: int = 0
    _latest_ns: int = 0

    @cached_property
    def info(self) -> BagInfo:
        """Table of contents, compared with ``metadata.yaml`` if the bag is a folder."""
        trouble = [str(error) for _, error in self.damage]
        trouble += _folder_trouble(self.path, sum(self.counts.values()))
        return BagInfo(
            path=self.path,
            topics=tuple(self.topics.values()),
            counts=self.counts,
            start_ns=self._start_ns or 0,
            end_ns=self._end_ns,
            metadata=self.metadata,
            attachments=tuple(self.attachments),
            complete=not trouble,
            trouble='; '.join(trouble[:_TROUBLES_TOLD]) + _more(len(trouble) - _TROUBLES_TOLD),
            back_ns=self._back_ns,
            unchecked='' if self.checked else unchecked_files(self.path),
        )

    def note(self, record: object, kept_bytes: KeptBytes) -> None:
        """Process a topic, message, metadata record or attachment."""
        if isinstance(record, StoredMessage):
            topic, stamp_ns, cdr, _ = record
            self.counts[topic.name] += 1
            if stamp_ns != self._latest_ns or self._start_ns is None:
                self._note_stamp(stamp_ns)
            size = self._kept_bytes[topic.name]
            if size >= len(cdr):
                self.messages.append(record)
            elif size:
                self.messages.append(record._replace(cdr=cdr[:size]))
        elif isinstance(record, TopicInfo):
            self.topics.setdefault(record.name, record)
            self.counts.setdefault(record.name, 0)
            self._kept_bytes[record.name] = kept_bytes(record.name)
        elif isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata
        elif isinstance(record, Attachment):
            self.attachments.append(record.name)

    def _note_stamp(self, stamp_ns: int) -> None:
        self._start_ns = stamp_ns if self._start_ns is None else min(self._start_ns, stamp_ns)
        self._end_ns = max(self._end_ns, stamp_ns)
        self._back_ns = max(self._back_ns, self._end_ns - stamp_ns)
        self._latest_ns = stamp_ns


def read_contents(path: Path, kept_bytes: KeptBytes) -> Contents:
    """Read a bag in one pass; damage is reported in the result, not raised.

    Args:
        path: a bag's folder or an ``.mcap`` file.
        kept_bytes: number of bytes to keep of each message of a topic; 0 drops its messages.

    Raises:
        BagEmpty, BagForeign, UsageError: as :func:`read_messages`.
    """
    files = storage_files(path)
    if len(files) == 1 and files[0].stat().st_size <= _MOST_AT_ONCE_BYTES:
        contents = Contents(path, checked=True)
        try:
            for record in _SoundFile(files[0].read_bytes()).records():
                contents.note(record, kept_bytes)
        except (OSError, BagError, struct.error, LookupError, UnicodeDecodeError):
            pass  # The scan below locates the damage and reads on after it.
        else:
            return contents
    contents = Contents(path)

    def note_damage(error: BagError) -> None:
        contents.damage.append((len(contents.messages), error))

    for file in files:
        for record in _scanned(file, kept_bytes, note_damage):
            contents.note(record, kept_bytes)
    return contents


def _scanned(
    file: Path, kept_bytes: KeptBytes, on_damage: OnDamage | None
) -> Iterator[TopicInfo | StoredMessage | Metadata | Attachment]:
    """Records of a scan, messages with their topics."""
    infos = _Topics()
    for record in scan(file, on_damage):
        infos.note(record)
        if isinstance(record, Message):
            info = infos.by_channel[record.channel_id]
            infos.check(record, file, wanted=kept_bytes(info.name) > 0)
            yield _stored(info, record)
        elif isinstance(record, Channel):
            yield infos.by_channel[record.id]
        elif isinstance(record, Metadata | Attachment):
            yield record


def _more(count: int) -> str:
    return f'; and {count} more' if count > 0 else ''


def _folder_trouble(path: Path, messages: int) -> list[str]:
    """Contradictions between ``metadata.yaml`` and the bag in the folder ``path``."""
    if path.is_file():
        return []
    try:
        declared = read_description(path)['message_count']
    except BagError as error:
        return [str(error)]
    if declared != messages:
        file = path / METADATA_FILE
        return [f'{file}: declares {declared} messages, the bag holds {messages}']
    return []


def decode_of(path: Path, stored: StoredMessage, count: int) -> Any:
    """Decode a message of the bag at ``path``; ``count`` intact ones were read before it.

    Raises:
        BagCorrupt, BagForeign: the message does not match its topic's definition.
    """
    try:
        return decode(stored.topic, stored.cdr)
    except BagError as error:
        text = f'{path}: at {stored.stamp_ns} ns: {error}; {count} intact messages before'
        raise type(error)(text, path=path, recovered=count) from error


_MESSAGE = struct.Struct('<HIQQ')


class _SoundFile:
    """One pass over a file in memory; anything unusual raises an error.

    Records are verified only after all have been read.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._infos = _Topics()
        self._count = 0
        self._work = ReadBudget(len(data))
        self._chunks: set[bytes] = set()

    def records(self) -> Iterator[TopicInfo | StoredMessage | Metadata | Attachment]:
        data, offset = self._data, len(MAGIC)
        if not data.startswith(MAGIC):
            raise BagCorrupt('not an MCAP file')
        while True:
            opcode, length = HEAD.unpack_from(data, offset)
            body = data[offset + HEAD.size:offset + HEAD.size + length]
            if opcode not in _IN_SOUND_FILES or len(body) != length:
                raise BagCorrupt('a misplaced or truncated record')
            behind = offset + HEAD.size + length
            if opcode == Opcode.MESSAGE_INDEX:
                check_message_index(body)
            else:
                record = parse_record(opcode, body)
                if isinstance(record, DataEnd):
                    self._finish(record, offset, behind)
                    return
                yield from self._within(record, body)
            offset = behind

    def _within(
        self, record: object, body: bytes
    ) -> Sequence[TopicInfo | StoredMessage | Metadata | Attachment]:
        if isinstance(record, Chunk):
            if body in self._chunks:
                raise BagCorrupt('a repeated chunk')
            self._chunks.add(body)
            return self._in_chunk(open_chunk(record, self._work))
        if isinstance(record, Metadata | Attachment):
            return (record,)
        if isinstance(record, Header) and record.profile != PROFILE:
            raise BagCorrupt(f'MCAP of profile {record.profile!r}')
        return self._declared(record)

    def _in_chunk(self, raw: bytes) -> Sequence[TopicInfo | StoredMessage]:
        found: list[TopicInfo | StoredMessage] = []
        start = 0
        while start < len(raw):
            opcode, length = HEAD.unpack_from(raw, start)
            self._work.record(opcode, length)
            start += HEAD.size
            end = start + length
            if opcode == Opcode.MESSAGE:
                channel, _, stamp_ns, published_ns = _MESSAGE.unpack_from(raw, start)
                self._count += 1
                cdr = raw[start + _MESSAGE.size:end]
                if cdr.startswith(_ZSTD):
                    raise BagCorrupt('a message is compressed')
                info = self._infos.by_channel[channel]
                found.append(StoredMessage(info, stamp_ns, cdr, published_ns))
            else:
                found += self._declared(parse_record(opcode, raw[start:end]))
            start = end
        if start != len(raw):
            raise BagCorrupt('records do not fill their chunk')
        return found

    def _declared(self, record: object) -> Sequence[TopicInfo]:
        known = self._infos.by_channel.get(record.id) if isinstance(record, Channel) else None
        self._infos.note(record)
        if not isinstance(record, Channel):
            return ()
        info = self._infos.by_channel[record.id]
        if record.message_encoding != 'cdr' or not info.definition:
            raise BagCorrupt(f'topic {record.topic} has another encoding')
        if known not in (None, info):
            raise BagCorrupt(f'channel {record.id} has two different definitions')
        return (info,)

    def _finish(self, end: DataEnd, offset: int, behind: int) -> None:
        statistics, _ = check_summary(self._data[behind:], behind)
        if statistics is None or statistics.message_count != self._count:
            raise BagCorrupt('messages are missing')
        if end.data_section_crc != zlib.crc32(memoryview(self._data)[:offset]):
            raise BagCorrupt('the data contradicts its checksum')
