"""Read messages and the table of contents of a bag from any ROS 2 recorder.

A damaged or unfinished file is read up to the first damage, which is reported; nothing behind it
is guessed. Each file of a split bag is read by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from mcap.records import Attachment, Metadata

from taxinet_ros.bag.description import read_description
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign, BagTruncated
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


@dataclass(kw_only=True)
class BagInfo:
    """Contents of a bag, as far as it can be read.

    Attributes:
        path: as given.
        counts: number of intact messages by topic name, including zeros.
        metadata: metadata records by name; the last one if a name is repeated.
        attachments: names in the order of the file.
        messages: the selected messages of ROS topics, in the order of recording.
        damage: first damage of each file.
        start_ns, end_ns: minimum and maximum stamp [ns]; 0 without messages.
        back_ns: longest time by which a message is older than one before it [ns].
        unchecked: one line about messages not covered by a checksum, or ''.
    """

    path: Path
    counts: dict[str, int] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[str] = field(default_factory=list)
    messages: list[StoredMessage] = field(default_factory=list)
    damage: list[BagError] = field(default_factory=list)
    start_ns: int = 0
    end_ns: int = 0
    back_ns: int = 0
    unchecked: str = ''
    _topics: dict[str, TopicInfo] = field(default_factory=dict)
    _trouble: str | None = None

    @property
    def topics(self) -> tuple[TopicInfo, ...]:
        """Topics in the order of the file."""
        return tuple(self._topics.values())

    @property
    def count(self) -> int:
        """Number of intact messages."""
        return sum(self.counts.values())

    @property
    def complete(self) -> bool:
        """Whether the recording was finished and nothing is damaged."""
        return not self.trouble

    @property
    def trouble(self) -> str:
        """One line about damage, or about ``metadata.yaml`` of a folder, or ''."""
        if self._trouble is None:
            self._trouble = '; '.join([*map(str, self.damage), *self._folder_trouble()])
        return self._trouble

    @property
    def duration_s(self) -> float:
        """Simulated time between the first and the last message [s]."""
        return (self.end_ns - self.start_ns) / 1e9

    def note(self, record: Stored, kept_bytes: KeptBytes) -> None:
        """Add a topic, message, metadata record or attachment."""
        if isinstance(record, StoredMessage):
            topic, stamp_ns, cdr, _ = record
            if not self.start_ns <= stamp_ns == self.end_ns:
                self._note_stamp(stamp_ns)
            self.counts[topic.name] += 1
            size = kept_bytes(topic.name) if topic.encoding == 'cdr' else 0
            if size >= len(cdr):
                self.messages.append(record)
            elif size:
                self.messages.append(record._replace(cdr=cdr[:size]))
        elif isinstance(record, TopicInfo):
            # A later copy counts: in a chunk it has a checksum, before the chunks it has none.
            if self._topics.setdefault(record.name, record).type == record.type:
                self._topics[record.name] = record
            self.counts.setdefault(record.name, 0)
        elif isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata
        else:
            self.attachments.append(record.name)

    def _note_stamp(self, stamp_ns: int) -> None:
        first = not any(self.counts.values())
        self.start_ns = stamp_ns if first else min(self.start_ns, stamp_ns)
        self.end_ns = max(self.end_ns, stamp_ns)
        self.back_ns = max(self.back_ns, self.end_ns - stamp_ns)

    def _folder_trouble(self) -> Iterator[str]:
        """Contradiction between ``metadata.yaml`` and the bag, if it is a folder."""
        if self.path.is_file():
            return
        try:
            declared = read_description(self.path)['message_count']
        except BagError as error:
            yield str(error)
            return
        if declared != self.count:
            file = self.path / METADATA_FILE
            yield f'{file}: declares {declared} messages, the bag holds {self.count}'


def records(info: BagInfo) -> Iterator[Stored]:
    """Yield topics, messages, metadata and attachments of a bag, up to each file's first damage.

    Args:
        info: names the bag; damage and what is not under checksums are added to it.

    Raises:
        BagEmpty, BagForeign, UsageError: as :func:`read_messages`.
    """
    messages, unread = 0, list[BagError]()
    for file in map(McapFile, storage_files(info.path)):
        try:
            yield from file.records()
        except (BagTruncated, BagCorrupt) as error:
            info.damage.append(error)
        except (BagEmpty, BagForeign) as error:
            unread.append(error)
        messages += file.messages
        if file.unchecked:
            info.unchecked = (
                f'{file.path.name}: {file.unchecked} of {file.messages} messages have no '
                'checksum, so that damage in them cannot be detected'
            )
    if unread and not messages:  # Of a split bag the files beside it are read.
        raise unread[0]
    info.damage += unread


def read_messages(path: Path, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
    """Yield the messages of a bag in the order of recording.

    Args:
        path: a run folder or an ``.mcap`` file.
        topics: names to keep; default all.

    Raises:
        BagTruncated, BagCorrupt: raised after all intact messages were yielded.
        BagEmpty, BagForeign: nothing to read, or an unsupported bag.
        UsageError: ``path`` does not exist.
    """
    wanted = None if topics is None else frozenset(topics).__contains__
    for topic, stamp_ns, cdr, _ in stored_messages(path, wanted):
        yield RawMessage(topic.name, topic.type, stamp_ns, cdr)


def stored_messages(path: Path, wanted: Wanted | None = None) -> Iterator[StoredMessage]:
    """Like :func:`read_messages`, with the topics' definitions."""
    info = BagInfo(path=path)
    for record in records(info):
        if isinstance(record, StoredMessage) and (wanted is None or wanted(record.topic.name)):
            yield record
    for error in info.damage:
        raise error


def read_info(path: Path) -> BagInfo:
    """Read the table of contents; damage is reported in the result, not raised.

    Args:
        path: a run folder or an ``.mcap`` file.

    Raises:
        BagEmpty, BagForeign, UsageError: as :func:`read_messages`.
    """
    return read_contents(path, lambda topic: 0)


def read_contents(path: Path, kept_bytes: KeptBytes) -> BagInfo:
    """Read a bag in one pass; damage is reported in the result, not raised.

    Args:
        path: a bag's folder or an ``.mcap`` file.
        kept_bytes: number of bytes to keep of each message of a topic; 0 drops its messages.

    Raises:
        BagEmpty, BagForeign, UsageError: as :func:`read_messages`.
    """
    info = BagInfo(path=path)
    for record in records(info):
        info.note(record, kept_bytes)
    return info


def read_attachment(path: Path, name: str) -> bytes:
    """Read the attachment ``name``; the last one if there are several.

    Raises:
        UsageError: no such attachment.
        BagError: as :func:`read_messages`, if the bag is damaged and the attachment not found.
    """
    info = BagInfo(path=path)
    there = {one.name: one.data for one in records(info) if isinstance(one, Attachment)}
    if name in there:
        return there[name]
    for error in info.damage:
        raise error
    raise UsageError(f'{path}: no attachment {name!r}; it has {", ".join(there) or "none"}')
