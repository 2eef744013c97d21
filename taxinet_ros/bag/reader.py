"""Read messages and the table of contents of a bag from any ROS 2 recorder.

A damaged or unfinished file is read up to the first damage, which is reported; nothing behind it
is guessed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Attachment, Metadata

from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.description import read_description
from taxinet_ros.bag.errors import BagCorrupt, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.layout import METADATA_FILE, storage_files
from taxinet_ros.bag.storage.reader import McapFile, Stored, StoredMessage
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.errors import UsageError

Wanted = Callable[[str], bool]
"""Whether to read the topic of a name."""
KeptBytes = Callable[[str], int]
"""Number of bytes to keep of each message on the topic of a name."""


class RawMessage(NamedTuple):
    """One message as stored: topic and type name, log time [ns], serialised bytes."""

    topic: str
    type: str
    stamp_ns: int
    cdr: bytes


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
        BagTruncated, BagCorrupt: raised after all messages before the damage were yielded.
        BagEmpty, BagForeign: nothing to read, or an unsupported bag.
        UsageError: ``path`` does not exist.
    """
    wanted = None if topics is None else frozenset(topics).__contains__
    for topic, stamp_ns, cdr, _ in stored_messages(path, wanted):
        yield RawMessage(topic.name, topic.type, stamp_ns, cdr)


def stored_messages(path: Path, wanted: Wanted | None = None) -> Iterator[StoredMessage]:
    """Like :func:`read_messages`, with the topics' definitions."""
    for file in storage_files(path):
        for record in McapFile(file).records():
            if isinstance(record, StoredMessage) and (wanted is None or wanted(record.topic.name)):
                _check_encoding(path, record.topic)
                yield record


def read_info(path: Path) -> BagInfo:
    """Read the table of contents; damage is reported in the result, not raised.

    Args:
        path: a run folder or an ``.mcap`` file.

    Raises:
        BagEmpty, BagForeign, UsageError: as :func:`read_messages`.
    """
    return read_contents(path, lambda topic: 0).info


def intact_records(
    path: Path, on_damage: Callable[[BagError], None] = lambda error: None
) -> Iterator[Stored]:
    """Yield topics, messages, metadata and attachments of a bag; damage is not raised.

    Each file of the bag is read up to its first damage, which is passed to ``on_damage``.
    """
    for file in storage_files(path):
        try:
            yield from McapFile(file).records()
        except (BagTruncated, BagCorrupt) as error:
            on_damage(error)


def read_attachment(path: Path, name: str) -> bytes:
    """Read the attachment ``name``; the last one if there are several.

    Raises:
        UsageError: no such attachment.
        BagError: as :func:`read_messages`, if the bag is damaged and the attachment not found.
    """
    damage: list[BagError] = []
    there = {
        record.name: record.data for record in intact_records(path, damage.append)
        if isinstance(record, Attachment)
    }
    if name in there:
        return there[name]
    if damage:
        raise damage[0]
    raise UsageError(f'{path}: no attachment {name!r}; it has {", ".join(there) or "none"}')


def _check_encoding(path: Path, topic: TopicInfo) -> None:
    if topic.encoding != 'cdr':
        text = f'{path}: topic {topic.name}: messages are {topic.encoding!r}, not cdr'
        raise BagForeign(text, path=path)


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
        damage: first damage of each file, with the number of ``messages`` before it.
        unchecked: one line about messages not covered by a checksum, or ''.
    """

    path: Path
    topics: dict[str, TopicInfo] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[str] = field(default_factory=list)
    messages: list[StoredMessage] = field(default_factory=list)
    damage: list[tuple[int, BagError]] = field(default_factory=list)
    unchecked: str = ''
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
            trouble='; '.join(trouble),
            back_ns=self._back_ns,
            unchecked=self.unchecked,
        )

    def note(self, record: Stored, kept_bytes: KeptBytes) -> None:
        """Process a topic, message, metadata record or attachment."""
        if isinstance(record, StoredMessage):
            topic, stamp_ns, cdr, _ = record
            self.counts[topic.name] += 1
            if stamp_ns != self._latest_ns or self._start_ns is None:
                self._note_stamp(stamp_ns)
            size = self._kept_bytes[topic.name]
            if size:
                _check_encoding(self.path, topic)
            if size >= len(cdr):
                self.messages.append(record)
            elif size:
                self.messages.append(record._replace(cdr=cdr[:size]))
        elif isinstance(record, TopicInfo):
            # A later copy counts: in a chunk it has a checksum, before the chunks it has none.
            if self.topics.setdefault(record.name, record).type == record.type:
                self.topics[record.name] = record
            self.counts.setdefault(record.name, 0)
            self._kept_bytes[record.name] = kept_bytes(record.name)
        elif isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata
        else:
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
    contents, unchecked = Contents(path), []
    for file in map(McapFile, storage_files(path)):
        try:
            for record in file.records():
                contents.note(record, kept_bytes)
        except (BagTruncated, BagCorrupt) as error:
            contents.damage.append((len(contents.messages), error))
        unchecked.append(file.unchecked)
    contents.unchecked = '; '.join(filter(None, unchecked))
    return contents


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
        raise type(error)(text, path=path) from error
