"""Copy what can be read of a damaged or unfinished bag to a new, complete one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from taxinet_ros.bag.description import read_description
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError
from taxinet_ros.bag.layout import storage_files
from taxinet_ros.bag.reader import intact_records, read_contents
from taxinet_ros.bag.rewrite.copying import (
    NamedMessage,
    copy_of,
    named_message,
    storable_topic,
    write_steps,
)
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

    ``source`` is not modified.

    Args:
        source: a run folder or an ``.mcap`` file.
        folder: the new run folder.

    Raises:
        BagEmpty: nothing can be read; no folder is created.
        BagForeign, UsageError: as ``reader.read_messages`` and :class:`BagWriter`.
        BagWriteError: the new bag does not fit on the disk.
    """
    contents = read_contents(source, lambda topic: 0)
    info = contents.info
    if not any(info.counts.values()):
        raise BagEmpty(f'{source}: nothing can be recovered: {info.trouble or "no messages"}',
                       path=source)
    damage = [str(error) for _, error in contents.damage]
    storable = (storable_topic(topic, damage.append) for topic in info.topics)
    topics = {topic.name: topic for topic in storable if topic is not None}
    other: Counter[tuple[str, str]] = Counter()

    def messages() -> Iterator[NamedMessage]:
        for record in intact_records(source):
            if isinstance(record, StoredMessage) and record.topic.name in topics:
                declared = contents.topics[record.topic.name]
                if (record.topic.type, record.topic.type_hash) == (
                    declared.type, declared.type_hash
                ):
                    yield named_message(record)
                else:  # another recorder's topic may have several types
                    other[declared.name, record.topic.type] += 1

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
            error.path for _, error in contents.damage
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
