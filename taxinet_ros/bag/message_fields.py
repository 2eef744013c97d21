"""Some fields of serialised messages, read without making objects of these.

A run's messages of a topic have the same texts, hence the same layout: where the fields lie is
found once. What is laid out as nothing before it is decoded as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import Any

from taxinet_ros.bag.canonical import LITTLE_ENDIAN
from taxinet_ros.bag.cdr_gaps import Layouts, Trail
from taxinet_ros.bag.decode import decoder, typestore
from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.bag.message_places import parts_of, places_of
from taxinet_ros.bag.topics import TopicInfo


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
        self._places = Layouts[_Places]()

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
            places = _Places(self._topic, cdr, trail, self._numbers, self._texts)
            self._places.learn(cdr, trail, places)
        return values

    def _values(self, places: _Places, cdr: bytes) -> list[Any]:
        try:
            return places.values(cdr)
        except UnicodeDecodeError as error:
            text = f'topic {self._topic.name}: not a {self._topic.type}: {error}'
            raise BagCorrupt(text) from error


class _Places:
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
