"""The canonical bytes of a message.

CDR aligns its fields, and middleware leaves whatever was in the buffer in the gaps, so two equal
messages may differ in bytes. Recorded messages are written again with every gap zero, so that
equal runs give equal bags.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.bag.topics import TopicInfo

_TIME = struct.Struct('<iI')
_LITTLE_ENDIAN = b'\x00\x01'


def stamp_of_cdr(cdr: bytes) -> int:
    """Stamp [ns] of a serialised message that begins with a Header or a Time.

    Raises:
        BagCorrupt: it is too short, or not little-endian CDR.
    """
    if len(cdr) < 12 or cdr[:2] != _LITTLE_ENDIAN:
        raise BagCorrupt(f'message of {len(cdr)} bytes is not little-endian CDR with a stamp')
    sec, nanosec = _TIME.unpack_from(cdr, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


class Canonical:
    """Writes messages of some topics again, byte for byte the same for equal content."""

    def __init__(self, topics: Sequence[TopicInfo]) -> None:
        """Learn the types of ``topics`` from their definitions."""
        self._types = {topic.name: topic.type for topic in topics}
        self._store = get_typestore(Stores.EMPTY)
        for topic in topics:
            types = get_types_from_msg(topic.definition, topic.type)
            known = self._store.types
            self._store.register({name: kind for name, kind in types.items() if name not in known})

    def message(self, topic: str, cdr: bytes) -> bytes:
        """The same message with every alignment gap zero.

        Args:
            topic: name of one of the topics.
            cdr: the message with its four bytes of encapsulation.

        Raises:
            BagCorrupt: the bytes are no message of the topic's type.
        """
        kind = self._types[topic]
        try:
            return bytes(self._store.serialize_cdr(self._store.deserialize_cdr(cdr, kind), kind))
        except Exception as error:
            raise BagCorrupt(f'{topic}: {len(cdr)} bytes are no {kind}: {error}') from error
