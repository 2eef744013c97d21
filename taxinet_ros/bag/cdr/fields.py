"""Numbers filled into a serialised message, without making a message object of it.

A run's messages of a topic have the same texts, hence the same layout: where the numbers lie is
found once.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype

from taxinet_ros.bag.cdr.alignment import BODY, FORMATS, Trail, steps_of, walk_of
from taxinet_ros.bag.cdr.decode import typestore
from taxinet_ros.bag.topics import TopicInfo


class Number(NamedTuple):
    """A field of constant size: its first byte, and its character in a :mod:`struct` format."""

    at: int
    form: str

    @property
    def end(self) -> int:
        """First byte after it."""
        return self.at + struct.calcsize('<' + self.form)


class Part(NamedTuple):
    """Numbers with nothing but gaps among them: ``first`` to ``end`` of those asked for."""

    layout: struct.Struct
    at: int
    first: int
    end: int


def numbers_of(store: Any, type_name: str, cdr: bytes, trail: Trail) -> dict[str, Number]:
    """Numbers and truth values by their names from the outside in; none within arrays, sequences.

    Args:
        store: rosbags' type store that knows the type.
        type_name: such as ``nav_msgs/msg/Odometry``.
        cdr: the message with its four bytes of encapsulation, little-endian.
        trail: is filled with what lies between the fields.

    Raises:
        ValueError, struct.error: the bytes are no message of the type.
    """
    numbers: dict[str, Number] = {}

    def visit(prefix: str, name: str, at: int) -> int:
        for field, kind in store.fielddefs[name][1]:
            node, what = kind
            if node is Nodetype.NAME:
                at = visit(f'{prefix}{field}.', what, at)
                continue
            for step in steps_of(store, kind):
                at = step.walk(cdr, at, trail)
            if node is Nodetype.BASE and what[0] in FORMATS:
                form = FORMATS[what[0]]
                numbers[prefix + field] = Number(at - struct.calcsize('<' + form), form)
        return at

    visit('', type_name, BODY)
    return numbers


def parts_of(numbers: Sequence[Number], trail: Trail) -> Iterator[Part]:
    """Run together what has only gaps, as ``trail`` has them, between one number and the next."""
    first = 0
    while first < len(numbers):
        end, form = first + 1, '<' + numbers[first].form
        while end < len(numbers):
            between = numbers[end - 1].end, numbers[end].at
            if between[0] != between[1] and between not in trail.gaps:
                break
            form += f'{between[1] - between[0]}x{numbers[end].form}'
            end += 1
        yield Part(struct.Struct(form), numbers[first].at, first, end)
        first = end


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
        numbers = numbers_of(store, topic.type, self._cdr, trail)
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
