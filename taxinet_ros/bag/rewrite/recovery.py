"""Copy the intact part of a damaged or unfinished bag to a new one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from taxinet_ros.bag.cdr.decode import definition_hash
from taxinet_ros.bag.description import read_description
from taxinet_ros.bag.errors import BagEmpty, BagError
from taxinet_ros.bag.layout import storage_files
from taxinet_ros.bag.reader import StoredMessage, read_info, stored_messages
from taxinet_ros.bag.rewrite.copying import copy_of, named_message, storable_topic, write_steps
from taxinet_ros.bag.storage.summary import read_statistics
from taxinet_ros.bag.topics import TopicInfo, message_definition, type_hash
from taxinet_ros.bag.writer import BagSummary
from taxinet_ros.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """Result of a recovery.

    Attributes:
        bag: the new, complete bag.
        damage: one line per damaged place and per omitted topic; empty if no data were lost.
        declared: number of messages declared in the source, or None if that is lost.
    """

    bag: BagSummary
    damage: tuple[str, ...]
    declared: int | None

    @property
    def saved(self) -> int:
        """Number of messages in the new bag."""
        return sum(self.bag.message_counts.values())


def recover(source: Path, folder: Path) -> Recovery:
    """Copy all intact messages, attachments and metadata of ``source`` to the new run ``folder``.

    Data after a damaged chunk are kept: see :mod:`taxinet_ros.bag.storage.scan`. ``source`` is not
    modified.

    Raises:
        BagEmpty: nothing could be recovered; no folder is created.
        BagForeign, UsageError: as ``reader.read_messages`` and :class:`BagWriter`.
        BagWriteError: the new bag does not fit on the disk.
    """
    info = read_info(source)
    if not any(info.counts.values()):
        raise BagEmpty(f'{source}: nothing can be recovered: {info.trouble or "no messages"}',
                       path=source)
    damage: list[str] = []
    topics = [t for topic in info.topics if (t := storable_topic(topic, damage.append)) is not None]
    topics = [_with_sound_definition(topic, damage.append) for topic in topics]
    names = {topic.name for topic in topics}
    size = sum(file.stat().st_size for file in storage_files(source))
    sound = stored_messages(
        source, names.__contains__, lambda error: damage.append(str(error))
    )
    other: Counter[tuple[str, str]] = Counter()
    declared = {topic.name: topic for topic in info.topics}

    def fits(stored: StoredMessage) -> bool:
        """Whether a message is of its topic's type; a bag of ours has one type for each."""
        topic = stored.topic
        if not _alike(topic, declared[topic.name]):
            other[topic.name, topic.type] += 1
            return False
        return True

    with copy_of(info, folder, topics, size) as bag:
        write_steps(bag, map(named_message, filter(fits, sound)))
    damage += [
        f'left out: topic {name!r}: {count} messages of type {kind}, as it is declared with '
        f'another: {declared[name].type}' for (name, kind), count in other.items()
    ]
    return Recovery(bag=bag.summary, damage=tuple(damage), declared=_declared(source))


def _with_sound_definition(topic: TopicInfo, tell: Callable[[str], None]) -> TopicInfo:
    """The topic; with the installed definition if its own is damaged and the hashes are equal."""
    try:
        if definition_hash(topic) == topic.type_hash:
            return topic
    except BagError:
        pass
    try:
        if type_hash(topic.type) != topic.type_hash:
            return topic
        definition = message_definition(topic.type)
    except UsageError:
        return topic
    tell(f'topic {topic.name!r}: its definition is damaged; the installed one of {topic.type}, '
         'which has the recorded type hash, takes its place')
    return replace(topic, definition=definition)


def _alike(one: TopicInfo, other: TopicInfo) -> bool:
    """Whether messages of one topic can be read as those of the other."""
    if one.type != other.type or one.definition == other.definition:
        return one.type == other.type
    try:
        return definition_hash(one) == definition_hash(other)
    except BagError:
        return False


def _declared(source: Path) -> int | None:
    """Number of messages declared by the bag's summary or its ``metadata.yaml``."""
    try:
        return sum(sum(read_statistics(file).values()) for file in storage_files(source))
    except BagError:
        pass
    try:
        count = read_description(source)['message_count'] if source.is_dir() else None
    except BagError:
        return None
    return count if isinstance(count, int) else None
