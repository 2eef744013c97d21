"""The canonical bytes of a message.

CDR aligns its fields, and middleware leaves whatever was in the buffer in the gaps, so two equal
messages may differ in bytes. Recorded messages get every gap zero, so that equal runs give equal
bags.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from taxinet_ros.bag.cdr_gaps import Walk, walk_of
from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.bag.topics import TopicInfo

_TIME = struct.Struct('<iI')
LITTLE_ENDIAN = b'\x00\x01'
"""How a message begins whose numbers are: CDR of version 1."""


def stamp_of_cdr(cdr: bytes) -> int:
    """Stamp [ns] of a serialised message that begins with a Header or a Time.

    Raises:
        BagCorrupt: it is too short, or not little-endian CDR.
    """
    if len(cdr) < 12 or cdr[:2] != LITTLE_ENDIAN:
        raise BagCorrupt(f'message of {len(cdr)} bytes is not little-endian CDR with a stamp')
    sec, nanosec = _TIME.unpack_from(cdr, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


class Canonical:
    """Makes messages of some topics byte for byte the same for equal content."""

    def __init__(self, topics: Sequence[TopicInfo]) -> None:
        """Learn the types of ``topics`` from their definitions."""
        store = get_typestore(Stores.EMPTY)
        self._walks: dict[str, Walk] = {}
        for topic in topics:
            types = get_types_from_msg(topic.definition, topic.type)
            store.register({name: kind for name, kind in types.items() if name not in store.types})
            self._walks[topic.name] = walk_of(store, topic.type)

    def message(self, topic: str, cdr: bytes) -> bytes:
        """The same message with every alignment gap zero, and nothing after its last field.

        Args:
            topic: name of one of the topics.
            cdr: the message with its four bytes of encapsulation.

        Raises:
            BagCorrupt: the bytes are no message of the topic's type.
        """
        try:
            if cdr[:2] != LITTLE_ENDIAN:
                raise ValueError('not little-endian CDR')
            return self._walks[topic].without_gaps(cdr)
        except (struct.error, ValueError) as error:
            raise BagCorrupt(f'{topic}: {len(cdr)} bytes are no message of it: {error}') from error
