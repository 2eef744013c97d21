"""Copy what can be read of a damaged or unfinished bag to a new, complete one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from taxinet_ros.bag.description import read_description
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError
from taxinet_ros.bag.layout import storage_files
from taxinet_ros.bag.reader import BagInfo, read_info, records
from taxinet_ros.bag.rewrite.copying import copy_of, storable_topic, write_steps
from taxinet_ros.bag.storage.reader import StoredMessage, read_statistics
from taxinet_ros.bag.writer import BagSummary


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """Result of a recovery.

    Attributes:
        bag: the new, complete bag.
        damage: one line per damaged place and per omitted topic; empty if no data were lost.
        declared: number of messages declared in the source, or None if that is lost.
        unchecked: one line about messages not covered by a checksum, or ''.
        damaged_files: files with data behind the damage, which are not read.
    """

    bag: BagSummary
    damage: tuple[str, ...]
    declared: int | None
    unchecked: str
    damaged_files: tuple[Path, ...]

    @property
    def saved(self) -> int:
        """Number of messages in the new bag."""
        return sum(self.bag.message_counts.values())


def recover(source: Path, folder: Path) -> Recovery:
    """Copy messages, attachments and metadata of ``source`` up to the first damage.

    ``source``, a run folder or an ``.mcap`` file, is not modified.

    Raises:
        BagEmpty: nothing can be read; no folder is created.
        BagError, UsageError: as ``reader.read_messages`` and :class:`BagWriter`.
    """
    info = read_info(source)
    if not info.count:
        raise BagEmpty(f'{source}: nothing can be recovered: {info.trouble or "no messages"}',
                       path=source)
    damage = [str(error) for error in info.damage]
    storable = (storable_topic(topic, damage.append) for topic in info.topics)
    topics = {topic.name: topic for topic in storable if topic is not None}
    if not topics:
        raise BagEmpty(f'{source}: nothing can be recovered: {damage[0]}', path=source)
    declared = {topic.name: (topic.type, topic.type_hash) for topic in info.topics}
    other: Counter[tuple[str, str]] = Counter()

    def messages() -> Iterator[StoredMessage]:
        for record in records(BagInfo(path=source)):
            if isinstance(record, StoredMessage) and record.topic.name in topics:
                name, kind = record.topic.name, (record.topic.type, record.topic.type_hash)
                if kind == declared[name]:
                    yield record
                else:  # another recorder's topic may have several types
                    other[name, kind[0]] += 1

    size = sum(file.stat().st_size for file in storage_files(source))
    with copy_of(info, folder, list(topics.values()), size) as bag:
        write_steps(bag, messages())
    damage += [
        f'left out: topic {name!r}: {count} messages of type {kind}, as it is declared with '
        f'another: {topics[name].type}' for (name, kind), count in other.items()
    ]
    return Recovery(
        bag=bag.summary, damage=tuple(damage), declared=_declared(source),
        unchecked=info.unchecked, damaged_files=tuple(
            error.path for error in info.damage
            if isinstance(error, BagCorrupt) and error.path is not None
        ),
    )


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
