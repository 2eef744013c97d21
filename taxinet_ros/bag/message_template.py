"""Serialised messages of one kind, of which only some numbers change from one to the next.

A run's messages of a topic have the same texts, hence the same layout: what is said in every
control step is filled into bytes that were serialised once, for a fraction of what it costs to make
a message object and to serialise that.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype

from taxinet_ros.bag.cdr_gaps import BODY, FORMATS, Trail, steps_of, walk_of
from taxinet_ros.bag.decode import typestore
from taxinet_ros.bag.topics import TopicInfo


class _Number(NamedTuple):
    """A field of constant size: its first byte, and its character in a :mod:`struct` format."""

    at: int
    form: str

    @property
    def end(self) -> int:
        """First byte after it."""
        return self.at + struct.calcsize('<' + self.form)


class _Part(NamedTuple):
    """Numbers with nothing but gaps among them.

    They are values ``first`` to ``end`` of those that are filled in.
    """

    pack_into: Callable[..., None]
    at: int
    first: int
    end: int


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
        numbers = _numbers(store, topic.type, self._cdr, trail)
        self._parts = tuple(_parts([numbers[name] for name in fields], trail))

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


def _numbers(store: Any, type_name: str, cdr: bytes, trail: Trail) -> dict[str, _Number]:
    """The numbers of a message by name; what lies between goes to ``trail``."""
    numbers: dict[str, _Number] = {}

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
                numbers[prefix + field] = _Number(at - struct.calcsize('<' + form), form)
        return at

    visit('', type_name, BODY)
    return numbers


def _parts(numbers: Sequence[_Number], trail: Trail) -> Iterator[_Part]:
    first = 0
    while first < len(numbers):
        end, form = first + 1, '<' + numbers[first].form
        while end < len(numbers):
            between = numbers[end - 1].end, numbers[end].at
            if between[0] != between[1] and between not in trail.gaps:
                break
            form += f'{between[1] - between[0]}x{numbers[end].form}'
            end += 1
        yield _Part(struct.Struct(form).pack_into, numbers[first].at, first, end)
        first = end
