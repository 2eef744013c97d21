"""Saving what is sound of a damaged or unfinished bag into a new one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mcap.records import Attachment

from taxinet_ros.bag.errors import BagEmpty, BagError
from taxinet_ros.bag.layout import storage_files
from taxinet_ros.bag.reader import read_info, stored_messages
from taxinet_ros.bag.scan import scan
from taxinet_ros.bag.writer import MANIFEST, RUN_METADATA, BagSummary, BagWriter


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """The outcome of a rescue.

    Attributes:
        bag: the new, whole bag.
        damage: one line for each damaged place; empty if nothing of the data was lost.
    """

    bag: BagSummary
    damage: tuple[str, ...]


def recover(source: Path, folder: Path) -> Recovery:
    """Copy every sound message, attachment and word of ``source`` into the new run ``folder``.

    A damaged chunk costs that chunk. Where a record's length is damaged the next record cannot be
    found, and the rest of the file is lost.

    Raises:
        BagEmpty: nothing could be saved; no folder is made.
        BagForeign, UsageError: as ``reader.read_messages`` and :class:`BagWriter`.
    """
    info = read_info(source)
    if not info.topics:
        raise BagEmpty(f'{source}: nothing can be saved: {info.trouble}', path=source)
    damage: list[BagError] = []
    words = info.metadata.get(RUN_METADATA, {})
    with BagWriter(folder, info.topics, metadata=words, attachments=_attachments(source)) as bag:
        for topic, stamp_ns, cdr in stored_messages(source, on_damage=damage.append):
            bag.write(topic.name, cdr, stamp_ns)
        for name, values in info.metadata.items():
            if name not in ('rosbag2', RUN_METADATA):
                bag.add_metadata(name, values)
        summary = bag.close()
    return Recovery(bag=summary, damage=tuple(map(str, damage)))


def _attachments(source: Path) -> dict[str, bytes]:
    """All files in the bag that are sound, but for the manifest, which the writer makes anew."""
    found: dict[str, bytes] = {}
    for file in storage_files(source):
        for record in scan(file, lambda error: None):
            if isinstance(record, Attachment) and record.name != MANIFEST:
                found[record.name] = record.data
    return found
