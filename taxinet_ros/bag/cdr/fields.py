"""Fields of serialised messages, read and filled in without making message objects.

A run's messages of a topic have the same texts, hence the same layout: where the fields lie is
found once. :class:`FieldReader` reads some of them, :class:`MessageTemplate` fills other
numbers into bytes that were serialised once. A message of another layout is decoded as a whole.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype

from taxinet_ros.bag.cdr.alignment import (
    BODY,
    FORMATS,
    LITTLE_ENDIAN,
    Layouts,
    Trail,
    steps_of,
    walk_of,
)
from taxinet_ros.bag.cdr.decode import decoder, typestore
from taxinet_ros.bag.errors import BagCorrupt
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


class Places(NamedTuple):
    """Fields by their names from the outside in, but for those within arrays and sequences.

    Attributes:
        numbers: numbers and truth values.
        texts: their first bytes, and the first after them; their terminating zero is left out.
    """

    numbers: dict[str, Number]
    texts: dict[str, slice]


def places_of(store: Any, type_name: str, cdr: bytes, trail: Trail) -> Places:
    """Walk through a message; what lies between its fields goes to ``trail``.

    Args:
        store: rosbags' type store that knows the type.
        type_name: such as ``nav_msgs/msg/Odometry``.
        cdr: the message with its four bytes of encapsulation, little-endian.
        trail: to be filled.

    Raises:
        ValueError, struct.error: the bytes are no message of the type.
    """
    places = Places({}, {})

    def visit(prefix: str, name: str, at: int) -> int:
        for field, kind in store.fielddefs[name][1]:
            node, what = kind
            if node is Nodetype.NAME:
                at = visit(f'{prefix}{field}.', what, at)
                continue
            for step in steps_of(store, kind):
                at = step.walk(cdr, at, trail)
            if node is Nodetype.BASE and what[0] == 'string':
                begin = trail.counts[-1] + BODY
                places.texts[prefix + field] = slice(begin, max(at - 1, begin))
            elif node is Nodetype.BASE and what[0] in FORMATS:
                form = FORMATS[what[0]]
                places.numbers[prefix + field] = Number(at - struct.calcsize('<' + form), form)
        return at

    visit('', type_name, BODY)
    return places


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


class FieldReader:
    """Reads the same fields of many messages of one type."""

    def __init__(self, topic: TopicInfo, numbers: Sequence[str], texts: Sequence[str] = ()) -> None:
        """Name the fields from the outside in, e.g. ``header.stamp.sec``.

        Args:
            topic: says the type of the messages.
            numbers: numbers and truth values, not those within arrays and sequences.
            texts: texts, not those within arrays and sequences.

        Raises:
            BagForeign: the topic carries no definition that could be used.
        """
        self._topic = topic
        self._numbers, self._texts = tuple(numbers), tuple(texts)
        self._decode = decoder(topic)
        self._places = Layouts[_FieldPlaces]()

    def __call__(self, cdr: bytes) -> list[Any]:
        """The values of the numbers, then of the texts, in the order in which they were named.

        Raises:
            BagCorrupt: the bytes are no message of the topic's type.
            AttributeError, KeyError: the type has no such field, or it is of another kind.
        """
        little = cdr[:2] == LITTLE_ENDIAN
        if little and (places := self._places.find(cdr)) is not None:
            return self._values(places, cdr)
        message = self._decode(cdr)
        values = [attrgetter(name)(message) for name in (*self._numbers, *self._texts)]
        if little:
            trail = Trail()
            places = _FieldPlaces(self._topic, cdr, trail, self._numbers, self._texts)
            self._places.learn(cdr, trail, places)
        return values

    def _values(self, places: _FieldPlaces, cdr: bytes) -> list[Any]:
        try:
            return places.values(cdr)
        except UnicodeDecodeError as error:
            text = f'topic {self._topic.name}: not a {self._topic.type}: {error}'
            raise BagCorrupt(text) from error


class _FieldPlaces:
    """Where the fields lie in messages that are laid out like one of them."""

    def __init__(
        self, topic: TopicInfo, cdr: bytes, trail: Trail, numbers: Sequence[str],
        texts: Sequence[str],
    ) -> None:
        places = places_of(typestore(topic), topic.type, cdr, trail)
        parts = parts_of([places.numbers[name] for name in numbers], trail)
        self._parts = tuple((part.layout.unpack_from, part.at) for part in parts)
        self._texts = tuple(places.texts[name] for name in texts)

    def values(self, cdr: bytes) -> list[Any]:
        found: list[Any] = []
        for unpack_from, at in self._parts:
            found += unpack_from(cdr, at)
        for place in self._texts:
            found.append(cdr[place].decode())
        return found


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
