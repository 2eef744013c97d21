"""Saving what is sound of a damaged or unfinished bag into a new one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from mcap.records import Attachment

from taxinet_ros.bag.cdr.decode import definition_hash
from taxinet_ros.bag.description import read_description, words_beside
from taxinet_ros.bag.errors import BagEmpty, BagError
from taxinet_ros.bag.layout import storage_files
from taxinet_ros.bag.reader import read_info, stored_messages
from taxinet_ros.bag.run.topics import ONCE, is_topic
from taxinet_ros.bag.storage.scan import scan
from taxinet_ros.bag.storage.summary import read_statistics
from taxinet_ros.bag.topics import TopicInfo, check_topics, qos_profiles
from taxinet_ros.bag.writer import MANIFEST, RUN_METADATA, BagSummary, BagWriter
from taxinet_ros.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """The outcome of a rescue.

    Attributes:
        bag: the new, whole bag.
        damage: one line for each damaged place and each topic left out; empty if nothing of the
            data was lost.
        declared: messages that the source says it holds, or None where what would say so is lost.
    """

    bag: BagSummary
    damage: tuple[str, ...]
    declared: int | None

    @property
    def saved(self) -> int:
        """Messages in the new bag."""
        return sum(self.bag.message_counts.values())


def recover(source: Path, folder: Path) -> Recovery:
    """Copy every sound message, attachment and word of ``source`` into the new run ``folder``.

    A damaged chunk costs that chunk, and nothing behind it: see
    :mod:`taxinet_ros.bag.storage.scan`. ``source`` is only read.

    Raises:
        BagEmpty: nothing could be saved; no folder is made.
        BagForeign, UsageError: as ``reader.read_messages`` and :class:`BagWriter`.
        BagWriteError: the new bag does not fit on the disk.
    """
    info = read_info(source)
    if not any(info.counts.values()):
        raise BagEmpty(f'{source}: nothing can be saved: {info.trouble or "no messages"}',
                       path=source)
    damage: list[str] = []
    topics = [t for topic in info.topics if (t := storable_topic(topic, damage.append)) is not None]
    names = {topic.name for topic in topics}
    size = sum(file.stat().st_size for file in storage_files(source))
    words = info.metadata.get(RUN_METADATA, {})
    with BagWriter(
        folder, topics, metadata=words,
        attachments=_attachments(source), min_free_bytes=size,
        beside=words_beside(source, words),
    ) as bag:
        _copy(source, bag, names, lambda error: damage.append(str(error)))
        for name, values in info.metadata.items():
            if name not in ('rosbag2', RUN_METADATA):
                bag.add_metadata(name, values)
        summary = bag.close()
    return Recovery(bag=summary, damage=tuple(damage), declared=_declared(source))


def _copy(
    source: Path, bag: BagWriter, names: set[str], on_damage: Callable[[BagError], None]
) -> None:
    before: int | None = None
    for topic, stamp_ns, cdr in stored_messages(source, names.__contains__, on_damage):
        # As the recorder does it, so that each step lies in chunks of its own.
        once = any(is_topic(topic.name, name) for name in ONCE)
        now = None if once else stamp_ns
        if before is not None and now != before:
            bag.flush()
        before = now
        bag.write(topic.name, cdr, stamp_ns)


def storable_topic(topic: TopicInfo, leave_out: Callable[[str], None]) -> TopicInfo | None:
    """The topic with what an older or foreign recorder did not note, or None."""
    try:
        qos_profiles(topic.qos)
    except ValueError:
        topic = replace(topic, qos='[]\n')
    try:
        if not topic.type_hash:
            topic = replace(topic, type_hash=definition_hash(topic))
        check_topics([topic])
    except (BagError, UsageError) as error:
        leave_out(f'left out: {error}')
        return None
    return topic


def _declared(source: Path) -> int | None:
    """How many messages the bag's own end, or its folder, says that there are."""
    try:
        return sum(sum(read_statistics(file).values()) for file in storage_files(source))
    except BagError:
        pass
    try:
        count = read_description(source)['message_count'] if source.is_dir() else None
    except BagError:
        return None
    return count if isinstance(count, int) else None


def _attachments(source: Path) -> dict[str, bytes]:
    """All files in the bag that are sound, but for the manifest, which the writer makes anew."""
    found: dict[str, bytes] = {}
    for file in storage_files(source):
        for record in scan(file, lambda error: None):
            if isinstance(record, Attachment) and record.name != MANIFEST:
                found[record.name] = record.data
    return found
