"""Templates: write numbers into a serialised message without creating a message object.

A run's messages of a topic have the same strings and so the same layout; the positions of the
numbers are determined once.
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
    """A field of constant size: its first byte and :mod:`struct` format character."""

    at: int
    form: str

    @property
    def end(self) -> int:
        """First byte after it."""
        return self.at + struct.calcsize('<' + self.form)


class Part(NamedTuple):
    """Consecutive numbers with only gaps between them: ``first`` to ``end`` of the fields."""

    layout: struct.Struct
    at: int
    first: int
    end: int


def numbers_of(store: Any, type_name: str, cdr: bytes, trail: Trail) -> dict[str, Number]:
    """Positions of numbers and booleans by dotted name, except those in sequences.

    Elements of an array are ``name[0]``, ``name[1]``, and so on.

    Args:
        store: rosbags type store with the type.
        type_name: such as ``nav_msgs/msg/Odometry``.
        cdr: the message with its encapsulation of four bytes, little-endian.
        trail: output: gaps and counts.

    Raises:
        ValueError, struct.error: not a message of the type.
    """
    numbers: dict[str, Number] = {}

    def visit(prefix: str, name: str, at: int) -> int:
        for field, kind in store.fielddefs[name][1]:
            node, what = kind
            if node is Nodetype.NAME:
                at = visit(f'{prefix}{field}.', what, at)
                continue
            steps = steps_of(store, kind)
            for number, step in enumerate(steps):
                at = step.walk(cdr, at, trail)
                if node is Nodetype.ARRAY and what[0][1][0] in FORMATS:
                    form = FORMATS[what[0][1][0]]
                    numbers[f'{prefix}{field}[{number}]'] = Number(
                        at - struct.calcsize('<' + form), form
                    )
            if node is Nodetype.BASE and what[0] in FORMATS:
                form = FORMATS[what[0]]
                numbers[prefix + field] = Number(at - struct.calcsize('<' + form), form)
        return at

    visit('', type_name, BODY)
    return numbers


def parts_of(numbers: Sequence[Number], trail: Trail) -> Iterator[Part]:
    """Merge numbers with only gaps (given by ``trail``) between them."""
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
    """A serialised message whose numbers can be replaced."""

    def __init__(self, topic: TopicInfo, cdr: bytes, fields: Sequence[str]) -> None:
        """Determine the positions of the numbers.

        Args:
            topic: topic of the message's type; its name is not used.
            cdr: the message with its encapsulation of four bytes, little-endian.
            fields: dotted names of numbers and booleans, e.g. ``header.stamp.sec``, also of an
                array, ``covariance[0]``; not in sequences.

        Raises:
            BagForeign: the topic has no usable definition.
            KeyError: the type has no such field.
            ValueError, struct.error: not a message of the type.
        """
        store = typestore(topic)
        self._cdr = walk_of(store, topic.type).without_gaps(cdr)
        trail = Trail()
        numbers = numbers_of(store, topic.type, self._cdr, trail)
        parts = parts_of([numbers[name] for name in fields], trail)
        self._parts = tuple((part.layout.pack_into, *part[1:]) for part in parts)

    def filled(self, *values: float) -> bytes:
        """Return the message with new numbers, zeros in its gaps, cut after its last field.

        Args:
            values: one per field, in their order.

        Raises:
            struct.error: too few values, or one out of its field's range.
        """
        cdr = bytearray(self._cdr)
        for pack_into, at, first, end in self._parts:
            pack_into(cdr, at, *values[first:end])
        return bytes(cdr)
