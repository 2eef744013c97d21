"""What every new bag out of an old one has: its words and files, and a flush after each step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from mcap.records import Attachment

from taxinet_ros.bag.cdr.decode import definition_hash
from taxinet_ros.bag.description import words_beside
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.layout import storage_files
from taxinet_ros.bag.reader import BagInfo
from taxinet_ros.bag.run.topics import ONCE, is_topic
from taxinet_ros.bag.storage.scan import scan
from taxinet_ros.bag.topics import TopicInfo, check_topics, qos_profiles
from taxinet_ros.bag.writer import MANIFEST, RUN_METADATA, BagWriter
from taxinet_ros.errors import UsageError

NamedMessage = tuple[str, int, bytes]
"""Name of the topic, log time [ns], serialised bytes."""


@contextmanager
def copy_of(
    info: BagInfo, folder: Path, topics: Sequence[TopicInfo], min_free_bytes: int
) -> Iterator[BagWriter]:
    """A new bag with the words and files of an old one; messages are written within the ``with``.

    Args:
        info: of the old bag.
        folder: the new run folder.
        topics: of the new bag.
        min_free_bytes: free space to ask of the disk [bytes].

    Raises:
        UsageError, BagWriteError: as :class:`BagWriter`.
    """
    words = info.metadata.get(RUN_METADATA, {})
    with BagWriter(
        folder, topics, metadata=words, attachments=_attachments(info.path),
        min_free_bytes=min_free_bytes, beside=words_beside(info.path, words),
    ) as bag:
        yield bag
        for name, values in info.metadata.items():
            if name not in ('rosbag2', RUN_METADATA):
                bag.add_metadata(name, values)


def written_steps(bag: BagWriter, messages: Iterable[NamedMessage]) -> Iterator[int]:
    """Write messages, each control step in chunks of its own, as the recorder does it.

    Yields:
        The stamp of each step that is done [ns].
    """
    before: int | None = None
    for topic, stamp_ns, cdr in messages:
        now = None if any(is_topic(topic, name) for name in ONCE) else stamp_ns
        if before is not None and now != before:
            bag.flush()
            yield before
        before = now
        bag.write(topic, cdr, stamp_ns)
    if before is not None:
        yield before


def write_steps(bag: BagWriter, messages: Iterable[NamedMessage]) -> None:
    """:func:`written_steps`, all of them."""
    for _ in written_steps(bag, messages):
        pass


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


def _attachments(source: Path) -> dict[str, bytes]:
    """All files in the bag that are sound, but for the manifest, which the writer makes anew."""
    found: dict[str, bytes] = {}
    for file in storage_files(source):
        for record in scan(file, lambda error: None):
            if isinstance(record, Attachment) and record.name != MANIFEST:
                found[record.name] = record.data
    return found
