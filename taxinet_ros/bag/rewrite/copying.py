"""Copy a bag: its metadata and attachments, with a flush after each control step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from mcap.records import Attachment, Metadata

from taxinet_ros.bag.cdr.decode import definition_hash
from taxinet_ros.bag.description import words_beside
from taxinet_ros.bag.errors import BagCorrupt, BagError
from taxinet_ros.bag.reader import BagInfo, records
from taxinet_ros.bag.run.topics import ONCE, is_topic
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import TopicInfo, check_topics, qos_profiles
from taxinet_ros.bag.writer import MANIFEST, RUN_METADATA, BagWriter, is_own_manifest
from taxinet_ros.errors import UsageError


@contextmanager
def copy_of(
    info: BagInfo, folder: Path, topics: Sequence[TopicInfo], min_free_bytes: int
) -> Iterator[BagWriter]:
    """Context with a new bag that has the metadata and attachments of an old one."""
    words = info.metadata.get(RUN_METADATA, {})
    attachments, metadata = _besides_messages(info.path)
    with BagWriter(
        folder, topics, metadata=words, attachments={}, min_free_bytes=min_free_bytes,
        beside=words_beside(info.path, words),
    ) as bag:
        for attachment in attachments:
            bag.copy_attachment(attachment)
        yield bag
        for record in metadata:
            bag.add_metadata(record.name, record.metadata)


def written_steps(bag: BagWriter, messages: Iterable[StoredMessage]) -> Iterator[int]:
    """Write messages with separate chunks for each control step, like the recorder.

    Yields:
        Stamp of each completed step [ns].
    """
    before: int | None = None
    for topic, stamp_ns, cdr, published_ns in messages:
        now = None if any(is_topic(topic.name, name) for name in ONCE) else stamp_ns
        if before is not None and now != before:
            bag.flush()
            yield before
        before = now
        bag.write(topic.name, cdr, stamp_ns, published_ns)
    if before is not None:
        yield before


def write_steps(bag: BagWriter, messages: Iterable[StoredMessage]) -> None:
    """Write all steps; see :func:`written_steps`."""
    for _ in written_steps(bag, messages):
        pass


def storable_topic(topic: TopicInfo, leave_out: Callable[[str], None]) -> TopicInfo | None:
    """The topic, completed with data that other recorders omit; None if not storable.

    A definition that contradicts its type hash is damaged, and its messages could be misread.
    """
    try:
        qos_profiles(topic.qos)
    except ValueError:
        topic = replace(topic, qos='[]\n')
    try:
        found = definition_hash(topic)
        if topic.type_hash not in ('', found):
            raise BagCorrupt(f'topic {topic.name!r}: its definition contradicts its type hash')
        topic = replace(topic, type_hash=found)
        check_topics([topic])
    except (BagError, UsageError) as error:
        leave_out(f'left out: {error}')
        return None
    return topic


def _besides_messages(source: Path) -> tuple[list[Attachment], list[Metadata]]:
    """Intact attachments and metadata of the bag, except those that the writer creates.

    Names may be repeated: another recorder's may mean a sequence by that.
    """
    attachments, metadata = [], []
    for record in records(BagInfo(path=source)):
        if isinstance(record, Attachment) and not (
            record.name == MANIFEST and is_own_manifest(record.data)
        ):
            attachments.append(record)
        elif isinstance(record, Metadata) and record.name not in ('rosbag2', RUN_METADATA):
            metadata.append(record)
    return attachments, metadata
