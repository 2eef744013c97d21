"""Where the fields of one serialised message lie."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype

from taxinet_ros.bag.cdr_gaps import BODY, FORMATS, Trail, steps_of


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
