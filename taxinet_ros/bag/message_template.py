"""Serialised messages of one kind, of which only some numbers change from one to the next.

A run's messages of a topic have the same texts, hence the same layout: what is said in every
control step is filled into bytes that were serialised once, for a fraction of what it costs to make
a message object and to serialise that.
"""

from __future__ import annotations

from collections.abc import Sequence

from taxinet_ros.bag.cdr_gaps import Trail, walk_of
from taxinet_ros.bag.decode import typestore
from taxinet_ros.bag.message_places import parts_of, places_of
from taxinet_ros.bag.topics import TopicInfo


class MessageTemplate:
    """One serialised message, to be filled with other numbers."""

    def __init__(self, topic: TopicInfo, cdr: bytes, fields: Sequence[str]) -> None:
        """Find the numbers that change.

        Args:
            topic: says the type of the message, whatever its name.
            cdr: the message with its four bytes of encapsulation, little-endian.
            fields: names of numbers and truth values, from the outside in, e.g.
                ``header.stamp.sec``; not of those within arrays and sequences.

        Raises:
            BagForeign: the topic carries no definition that could be used.
            KeyError: the type has no such field.
            ValueError, struct.error: the bytes are no message of the type.
        """
        store = typestore(topic)
        self._cdr = walk_of(store, topic.type).without_gaps(cdr)
        trail = Trail()
        numbers = places_of(store, topic.type, self._cdr, trail).numbers
        parts = parts_of([numbers[name] for name in fields], trail)
        self._parts = tuple((part.layout.pack_into, *part[1:]) for part in parts)

    def filled(self, *values: float) -> bytes:
        """The message with other numbers, zeros in its gaps, and nothing after its last field.

        Args:
            values: one for each of the fields, in their order.

        Raises:
            struct.error: there are too few, or one is not in its field's range.
        """
        cdr = bytearray(self._cdr)
        for pack_into, at, first, end in self._parts:
            pack_into(cdr, at, *values[first:end])
        return bytes(cdr)
