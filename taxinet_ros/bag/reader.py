"""Messages and the table of contents of a bag, ours or another ROS 2 recorder's.

:func:`sound_messages` reads some topics of a sound file several times as fast as a scan, for
those who go through thousands of bags. It holds every checksum and count against the data all
the same; where one fails, the scan tells which, and what can be saved.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Message, Metadata, Schema

from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.description import read_description
from taxinet_ros.bag.errors import BagCorrupt, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.layout import METADATA_FILE, compressed, storage_files
from taxinet_ros.bag.storage.records import HEAD, MAGIC, ReadBudget, open_chunk, parse_record
from taxinet_ros.bag.storage.scan import OnDamage, scan, unchecked
from taxinet_ros.bag.storage.summary import check_summary
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.errors import UsageError

_ZSTD = b'\x28\xb5\x2f\xfd'
"""How a message begins that rosbag2 has compressed; one of CDR begins with a zero."""
_TROUBLES_TOLD = 3
"""Places that one line names; a damaged disk may have made hundreds."""
Wanted = Callable[[str], bool]
"""Whether the topic of this name is to be read."""


class RawMessage(NamedTuple):
    """One message as stored: topic and type name, log time [ns], serialised bytes."""

    topic: str
    type: str
    stamp_ns: int
    cdr: bytes


class StoredMessage(NamedTuple):
    """One message with all that is known of its topic; stamp is the log time [ns]."""

    topic: TopicInfo
    stamp_ns: int
    cdr: bytes


@dataclass(frozen=True, kw_only=True)
class BagInfo:
    """Table of contents of a bag, as far as it can be read.

    Attributes:
        path: as given.
        topics: in the order of the file.
        counts: sound messages by topic name, zeros included.
        start_ns, end_ns: least and greatest stamp [ns]; 0 without messages.
        metadata: metadata records by name; of several by one name, the last.
        attachments: their names, in the order of the file.
        complete: the recording was finished and nothing is damaged.
        trouble: one line on what is wrong, or empty.
        back_ns: by how much the stamps go back at most from one message to the next [ns].
        unchecked: one line on messages that no checksum covers, or empty.
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
    """Yield the messages of a bag in the order in which they were recorded.

    Args:
        path: a run folder or an ``.mcap`` file.
        topics: names to keep; default all.

    Raises:
        BagTruncated, BagCorrupt: only after everything sound before the damage was yielded; the
            error's ``recovered`` counts it.
        BagEmpty, BagForeign: there is nothing to read, or nothing that can be.
        UsageError: there is nothing at ``path``.
    """
    wanted = None if topics is None else frozenset(topics).__contains__
    for topic, stamp_ns, cdr in stored_messages(path, wanted):
        yield RawMessage(topic.name, topic.type, stamp_ns, cdr)


def stored_messages(
    path: Path, wanted: Wanted | None = None, on_damage: OnDamage | None = None
) -> Iterator[StoredMessage]:
    """Like :func:`read_messages`, with definitions; damage may be handed over, see ``scan``."""
    count = 0
    try:
        for file in storage_files(path):
            infos = _Topics()
            for record in scan(file, on_damage):
                infos.note(record)
                if not isinstance(record, Message):
                    continue
                info = infos.by_channel[record.channel_id]
                if record.data.startswith(_ZSTD):
                    raise BagForeign(compressed(file, 'message'), path=file)
                if wanted is None or wanted(info.name):
                    infos.check_cdr(record.channel_id, file)
                    yield StoredMessage(info, record.log_time, record.data)
                    count += 1
    except (BagTruncated, BagCorrupt) as error:
        message = f'{error}; {count} sound messages before'
        raise type(error)(
            message, path=error.path, recovered=count, offset=error.offset
        ) from error


def read_info(path: Path, on_damage: OnDamage | None = None) -> BagInfo:
    """Read the table of contents; damage is told in the result, not raised.

    Args:
        path: a run folder or an ``.mcap`` file.
        on_damage: called with each damaged place of the storage files.

    Raises:
        BagEmpty, BagForeign, UsageError: as :func:`read_messages`.
    """
    contents = _Contents()
    trouble: list[str] = []

    def note_damage(error: BagError) -> None:
        trouble.append(str(error))
        if on_damage is not None:
            on_damage(error)

    for file in storage_files(path):
        infos = _Topics()
        for record in scan(file, note_damage):
            infos.note(record)
            contents.note(record, infos)
    trouble += _folder_trouble(path, sum(contents.counts.values()))
    return BagInfo(
        path=path,
        topics=tuple(contents.topics.values()),
        counts=contents.counts,
        start_ns=contents.start_ns or 0,
        end_ns=contents.end_ns,
        metadata=contents.metadata,
        attachments=tuple(contents.attachments),
        complete=not trouble,
        trouble='; '.join(trouble[:_TROUBLES_TOLD]) + _more(len(trouble) - _TROUBLES_TOLD),
        back_ns=contents.back_ns,
        unchecked=unchecked_files(path),
    )


def unchecked_files(path: Path) -> str:
    """One line on messages of a bag that no checksum covers, or ''; see ``scan.unchecked``."""
    return '; '.join(filter(None, map(unchecked, storage_files(path))))


def read_attachment(path: Path, name: str) -> bytes:
    """The file that was put into the bag as ``name``; the last one, if several.

    Raises:
        UsageError: there is none by that name.
        BagError: as :func:`read_messages`, if the bag is damaged and it was not found before that.
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
    """The topics of one file, as they turn up."""

    def __init__(self) -> None:
        self.by_channel: dict[int, TopicInfo] = {}
        self._schemas: dict[int, Schema] = {}
        self._encodings: dict[int, str] = {}

    def note(self, record: object) -> None:
        """Take in a record."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self.by_channel[record.id] = self._info(record)
            self._encodings[record.id] = record.message_encoding

    def check_cdr(self, channel: int, file: Path) -> None:
        """Raise :class:`BagForeign` unless the channel's messages are CDR."""
        if (encoding := self._encodings[channel]) != 'cdr':
            name = self.by_channel[channel].name
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
        )


@dataclass
class _Contents:
    """What :func:`read_info` gathers."""

    topics: dict[str, TopicInfo] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[str] = field(default_factory=list)
    start_ns: int | None = None
    end_ns: int = 0
    back_ns: int = 0
    latest_ns: int = 0

    def note(self, record: object, infos: _Topics) -> None:
        """Take in a record."""
        if isinstance(record, Channel):
            self.topics.setdefault(record.topic, infos.by_channel[record.id])
            self.counts.setdefault(record.topic, 0)
        elif isinstance(record, Message):
            self.counts[infos.by_channel[record.channel_id].name] += 1
            stamp = record.log_time
            self.start_ns = stamp if self.start_ns is None else min(self.start_ns, stamp)
            self.end_ns = max(self.end_ns, stamp)
            self.back_ns = max(self.back_ns, self.latest_ns - stamp)
            self.latest_ns = stamp
        elif isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata
        elif isinstance(record, Attachment):
            self.attachments.append(record.name)


def _more(count: int) -> str:
    return f'; and {count} more' if count > 0 else ''


def _folder_trouble(path: Path, messages: int) -> list[str]:
    """What ``metadata.yaml`` says against the bag in the folder ``path``."""
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


class DecodedMessage(NamedTuple):
    """One message: topic name, log time [ns] and the object with its fields."""

    topic: str
    stamp_ns: int
    message: Any


def decoded_messages(path: Path, wanted: Wanted | None = None) -> Iterator[DecodedMessage]:
    """Yield the decoded messages of a bag; errors as ``reader.read_messages``."""
    for count, (topic, stamp_ns, cdr) in enumerate(stored_messages(path, wanted)):
        try:
            message = decode(topic, cdr)
        except BagError as error:
            text = f'{path}: at {stamp_ns} ns: {error}; {count} sound messages before'
            raise type(error)(text, path=path, recovered=count) from error
        yield DecodedMessage(topic.name, stamp_ns, message)


_MESSAGE = struct.Struct('<HIQQ')


def sound_messages(path: Path, wanted: Wanted) -> Iterator[StoredMessage]:
    """Yield wanted messages of a file, in its order.

    Args:
        path: an ``.mcap`` file.
        wanted: whether the topic of this name is to be read; asked for every message, so that it
            may depend on those before.

    Yields:
        Messages, of topics without quality of service and type hash. Only once all have come are
        they known to be sound.

    Raises:
        BagCorrupt: the file is not sound through and through, or not of the kind that
            :mod:`.writer` writes.
    """
    try:
        yield from _SoundFile(path.read_bytes()).messages(wanted)
    except (OSError, BagError, struct.error, LookupError, UnicodeDecodeError) as error:
        raise BagCorrupt(f'{path}: {error}', path=path) from error


class _SoundFile:
    """One pass over a file in memory; whatever is unusual raises."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._schemas: dict[int, Schema] = {}
        self._topics: dict[int, TopicInfo] = {}
        self._count = 0
        self._work = ReadBudget(len(data))

    def messages(self, wanted: Wanted) -> Iterator[StoredMessage]:
        data, offset = self._data, len(MAGIC)
        if not data.startswith(MAGIC):
            raise BagCorrupt('not an MCAP file')
        while True:
            opcode, length = HEAD.unpack_from(data, offset)
            body = data[offset + HEAD.size:offset + HEAD.size + length]
            if opcode == Opcode.MESSAGE or len(body) != length:
                raise BagCorrupt('message outside the chunks, or a torn record')
            record = None if opcode == Opcode.MESSAGE_INDEX else parse_record(opcode, body)
            if isinstance(record, Chunk):
                yield from self._chunk_messages(open_chunk(record, self._work), wanted)
            elif isinstance(record, DataEnd):
                self._finish(record, offset, offset + HEAD.size + length)
                return
            elif isinstance(record, Schema | Channel):
                self._note(record)
            offset += HEAD.size + length

    def _chunk_messages(self, raw: bytes, wanted: Wanted) -> Iterator[StoredMessage]:
        start = 0
        while start < len(raw):
            opcode, length = HEAD.unpack_from(raw, start)
            self._work.record(opcode, length)
            start += HEAD.size
            end = start + length
            if opcode == Opcode.MESSAGE:
                channel, _, stamp_ns, _ = _MESSAGE.unpack_from(raw, start)
                topic = self._topics[channel]
                self._count += 1
                if wanted(topic.name):
                    yield StoredMessage(topic, stamp_ns, raw[start + _MESSAGE.size:end])
            else:
                self._note(parse_record(opcode, raw[start:end]))
            start = end
        if start != len(raw):
            raise BagCorrupt('records do not fill their chunk')

    def _note(self, record: object) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            schema = self._schemas[record.schema_id]
            if record.message_encoding != 'cdr' or schema.encoding != 'ros2msg':
                raise BagCorrupt(f'topic {record.topic} is encoded in another way')
            known = self._topics.get(record.id)
            self._topics[record.id] = TopicInfo(
                name=record.topic, type=schema.name, qos='', type_hash='',
                definition=schema.data.decode(),
            )
            if known not in (None, self._topics[record.id]):
                raise BagCorrupt(f'channel {record.id} is told in two ways')

    def _finish(self, end: DataEnd, offset: int, behind: int) -> None:
        statistics, _ = check_summary(self._data[behind:], behind)
        if statistics is None or statistics.message_count != self._count:
            raise BagCorrupt('messages are missing')
        if end.data_section_crc != zlib.crc32(memoryview(self._data)[:offset]):
            raise BagCorrupt('the data contradicts its checksum')
