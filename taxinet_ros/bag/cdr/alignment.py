"""Alignment gaps of serialised messages, which are set to zero.

CDR aligns its fields, and middleware leaves old buffer content in the gaps, so equal messages may
differ in bytes. Gaps of recorded messages are zeroed, so that equal runs give equal bags. A message
type is converted to a short list of strides, each of which merges fields of constant size; walking
a message takes a few microseconds, serialising it again ten times that. Layout: OMG Common Data
Representation, version 1 (CORBA 3.3, part 2, section 9.3), which ROS 2 uses: every field is aligned
to its own size, counted from the end of the encapsulation.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import Any, Generic, TypeVar

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.bag.topics import TopicInfo, types_of

BODY = 4
"""Bytes of encapsulation before the first field."""
FORMATS = {
    'bool': '?', 'byte': 'B', 'char': 'B', 'octet': 'B', 'int8': 'b', 'uint8': 'B', 'int16': 'h',
    'uint16': 'H', 'int32': 'i', 'uint32': 'I', 'float32': 'f', 'int64': 'q', 'uint64': 'Q',
    'float64': 'd',
}
""":mod:`struct` format character by field type of constant size."""
_COUNT = struct.Struct('<I')
_SIZES = {name: struct.calcsize('<' + form) for name, form in FORMATS.items()}
_TEXT = 1
_MAX_TAIL = 3
"""Middleware rounds the length of a message up to a multiple of four bytes."""
MOST_LAYOUTS = 16
"""Maximum number of cached layouts per message type."""

T = TypeVar('T')


class Trail:
    """Positions recorded during a walk.

    Attributes:
        gaps: start and end (exclusive) of each alignment gap.
        counts: first byte of each count.
    """

    def __init__(self) -> None:
        """Start empty."""
        self.gaps: list[tuple[int, int]] = []
        self.counts: list[int] = []

    def aligned(self, at: int, align: int) -> int:
        """Start of a field at or after ``at``; records the gap before it."""
        short = (BODY - at) % align
        if short:
            self.gaps.append((at, at + short))
        return at + short

    def counted(self, cdr: bytes, at: int) -> tuple[int, int]:
        """Read the count at or after ``at``; return it and its end, and record it and its gap."""
        at = self.aligned(at, _COUNT.size)
        self.counts.append(at)
        (count,) = _COUNT.unpack_from(cdr, at)
        return count, at + _COUNT.size


class _Stride:
    """A block of constant size, aligned at its start, without gaps inside."""

    def __init__(self, align: int, size: int) -> None:
        self.align, self.size = align, size

    def joins(self, other: _Stride) -> bool:
        """Whether ``other`` can follow without a gap for any start of this one."""
        return other.align <= self.align and self.size % other.align == 0

    def walk(self, cdr: bytes, at: int, trail: Trail) -> int:
        """End of the field if it starts at or after ``at``; positions are added to ``trail``."""
        return trail.aligned(at, self.align) + self.size


class _Counted:
    """A count and its elements: a string, or a sequence of fields of constant size."""

    def __init__(self, size: int) -> None:
        self._size = size

    def walk(self, cdr: bytes, at: int, trail: Trail) -> int:
        """See :meth:`_Stride.walk`."""
        count, at = trail.counted(cdr, at)
        if not count:
            return at
        return trail.aligned(at, self._size) + count * self._size


class _Repeated:
    """A sequence or an array of elements of variable size."""

    def __init__(self, steps: Sequence[Any], count: int | None) -> None:
        self._steps, self._count = tuple(steps), count

    def walk(self, cdr: bytes, at: int, trail: Trail) -> int:
        """See :meth:`_Stride.walk`."""
        count = self._count
        if count is None:
            count, at = trail.counted(cdr, at)
        for _ in range(count):
            before = at
            for step in self._steps:
                at = step.walk(cdr, at, trail)
            if at > len(cdr) or at == before:
                raise ValueError(f'{count} elements do not fit')
        return at


class _Layout:
    """Layout of a message of a type; it is determined by the message's counts."""

    def __init__(self, cdr: bytes, trail: Trail) -> None:
        """Derive the layout from a message with zeros in its gaps."""
        counts = [(at, at + _COUNT.size) for at in trail.counts]
        spans = [*trail.gaps, *counts]
        self._size = max((end for _, end in spans), default=0)
        marked = bytearray(self._size)
        for start, end in spans:
            marked[start:end] = b'\xff' * (end - start)
        self._mask = int.from_bytes(marked, 'little')
        self._values = int.from_bytes(cdr[:self._size], 'little') & self._mask

    def has(self, cdr: bytes) -> bool:
        """Whether a message of the same length has the same counts, and zeros in its gaps."""
        return int.from_bytes(cdr[:self._size], 'little') & self._mask == self._values


class Layouts(Generic[T]):
    """Cache of results for messages of one type, by layout."""

    def __init__(self) -> None:
        """Start empty."""
        self._known: dict[int, list[tuple[_Layout, T]]] = {}  # by length

    def find(self, cdr: bytes) -> T | None:
        """Result for messages with the layout of ``cdr``, or None."""
        for layout, what in self._known.get(len(cdr), ()):
            if layout.has(cdr):
                return what
        return None

    def learn(self, cdr: bytes, trail: Trail, what: T) -> None:
        """Store the result ``what`` for the layout of ``cdr``, with the positions of its walk."""
        if sum(map(len, self._known.values())) == MOST_LAYOUTS:
            self._known.clear()
        self._known.setdefault(len(cdr), []).append((_Layout(cdr, trail), what))


class Walk:
    """Sequence of steps through the messages of one type."""

    def __init__(self, steps: Iterable[Any]) -> None:
        """Merge strides; ``steps`` come from :func:`walk_of`."""
        self._steps = tuple(_joined(steps))
        self._sound = Layouts[bool]()

    def without_gaps(self, cdr: bytes) -> bytes:
        """Return the message with zeros in its gaps, cut after its last field.

        Raises:
            ValueError, struct.error: not a message of the type.
        """
        # Most messages are already canonical and have the layout of the previous one.
        if self._sound.find(cdr):
            return cdr
        at = BODY
        trail = Trail()
        for step in self._steps:
            at = step.walk(cdr, at, trail)
        if not at <= len(cdr) <= at + _MAX_TAIL:
            raise ValueError(f'fields end at byte {at}')
        wrong = [(start, end) for start, end in trail.gaps if any(cdr[start:end])]
        if not wrong and len(cdr) == at:
            self._sound.learn(cdr, trail, True)
            return cdr
        fixed = bytearray(cdr[:at])
        for start, end in wrong:
            fixed[start:end] = bytes(end - start)
        return bytes(fixed)


def walk_of(store: Any, type_name: str) -> Walk:
    """Create the walk of a message type.

    Args:
        store: rosbags type store with the type.
        type_name: such as ``nav_msgs/msg/Odometry``.

    Raises:
        KeyError: the type is not in the store, or has an unsupported field such as a wstring.
    """
    return Walk(_steps(store, type_name))


def _steps(store: Any, type_name: str) -> list[Any]:
    return [step for _, kind in store.fielddefs[type_name][1] for step in steps_of(store, kind)]


def steps_of(store: Any, kind: Any) -> list[Any]:
    """Steps of one field, given by rosbags' ``fielddefs``; errors as :func:`walk_of`."""
    node, what = kind
    if node is Nodetype.BASE:
        name = what[0]
        return [_Counted(_TEXT) if name == 'string' else _Stride(_SIZES[name], _SIZES[name])]
    if node is Nodetype.NAME:
        return _steps(store, what)
    element, count = what
    inner = _joined(steps_of(store, element))
    if node is Nodetype.ARRAY and _constant(inner):
        return [_Stride(inner[0].align, inner[0].size) for _ in range(count)]
    if node is Nodetype.ARRAY:
        return [_Repeated(inner, count)]
    if element[0] is Nodetype.BASE and element[1][0] != 'string':
        return [_Counted(_SIZES[element[1][0]])]
    return [_Repeated(inner, None)]


def _constant(steps: Sequence[Any]) -> bool:
    return len(steps) == 1 and isinstance(steps[0], _Stride)


def _joined(steps: Iterable[Any]) -> list[Any]:
    done: list[Any] = []
    for step in steps:
        last = done[-1] if done else None
        if isinstance(step, _Stride) and isinstance(last, _Stride) and last.joins(step):
            done[-1] = _Stride(last.align, last.size + step.size)
        else:
            done.append(step)
    return done


_TIME = struct.Struct('<iI')
LITTLE_ENDIAN = b'\x00\x01'
"""Start of a little-endian message (CDR version 1)."""


def stamp_of_cdr(cdr: bytes) -> int:
    """Stamp [ns] of a serialised message that starts with a Header or a Time.

    Raises:
        BagCorrupt: the message is too short or not little-endian CDR.
    """
    if len(cdr) < 12 or cdr[:2] != LITTLE_ENDIAN:
        raise BagCorrupt(f'message of {len(cdr)} bytes is not little-endian CDR with a stamp')
    sec, nanosec = _TIME.unpack_from(cdr, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


class Canonical:
    """Canonicalises messages: equal content gives equal bytes."""

    def __init__(self, topics: Sequence[TopicInfo]) -> None:
        """Prepare for the types of ``topics``, given by their definitions."""
        store = get_typestore(Stores.EMPTY)
        self._walks: dict[str, Walk] = {}
        for topic in topics:
            types = types_of(topic.definition, topic.type)
            store.register({name: kind for name, kind in types.items() if name not in store.types})
            self._walks[topic.name] = walk_of(store, topic.type)

    def message(self, topic: str, cdr: bytes) -> bytes:
        """Return the message with zeros in its gaps, cut after its last field.

        Args:
            topic: name of one of the topics.
            cdr: the message with its encapsulation of four bytes.

        Raises:
            BagCorrupt: not a message of the topic's type.
        """
        try:
            if cdr[:2] != LITTLE_ENDIAN:
                raise ValueError('not little-endian CDR')
            return self._walks[topic].without_gaps(cdr)
        except (struct.error, ValueError) as error:
            raise BagCorrupt(f'{topic}: {len(cdr)} bytes are no message of it: {error}') from error
