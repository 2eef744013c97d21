"""Where the alignment gaps of a serialised message are, and messages with zeros in them.

CDR aligns its fields, and middleware leaves whatever was in the buffer in the gaps, so two
equal messages may differ in bytes. Recorded messages get every gap zero, so that equal runs
give equal bags. A message type becomes a short list of strides, as long as its fields of
constant size can be run together; walking a message along them costs a few microseconds,
writing it anew ten times that. Layout: OMG Common Data Representation, version 1 (CORBA 3.3,
part 2, section 9.3), which ROS 2 uses: every field is aligned to its own size, counted from the
end of the encapsulation.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import Any, Generic, TypeVar

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.bag.topics import TopicInfo

BODY = 4
"""Bytes of encapsulation before the first field."""
FORMATS = {
    'bool': '?', 'byte': 'B', 'char': 'B', 'octet': 'B', 'int8': 'b', 'uint8': 'B', 'int16': 'h',
    'uint16': 'H', 'int32': 'i', 'uint32': 'I', 'float32': 'f', 'int64': 'q', 'uint64': 'Q',
    'float64': 'd',
}
"""Character of a :mod:`struct` format by type of field, where that has a constant size."""
_COUNT = struct.Struct('<I')
_SIZES = {name: struct.calcsize('<' + form) for name, form in FORMATS.items()}
_TEXT = 1
_MAX_TAIL = 3
"""Middleware rounds the length of a message up to a multiple of four bytes."""
MOST_LAYOUTS = 16
"""Layouts that are remembered of the messages of one type."""

T = TypeVar('T')


class Trail:
    """What a walk came past.

    Attributes:
        gaps: first byte of each alignment gap, and the first after it.
        counts: first byte of each count.
    """

    def __init__(self) -> None:
        """Begin."""
        self.gaps: list[tuple[int, int]] = []
        self.counts: list[int] = []

    def aligned(self, at: int, align: int) -> int:
        """Where a field begins at or after ``at``; the gap before it is noted."""
        short = (BODY - at) % align
        if short:
            self.gaps.append((at, at + short))
        return at + short

    def counted(self, cdr: bytes, at: int) -> tuple[int, int]:
        """The count at or after ``at``, and where it ends; both it and its gap are noted."""
        at = self.aligned(at, _COUNT.size)
        self.counts.append(at)
        (count,) = _COUNT.unpack_from(cdr, at)
        return count, at + _COUNT.size


class _Stride:
    """Bytes of constant number, the first aligned, without gaps among them."""

    def __init__(self, align: int, size: int) -> None:
        self.align, self.size = align, size

    def joins(self, other: _Stride) -> bool:
        """Whether ``other`` can follow without a gap, wherever this one begins."""
        return other.align <= self.align and self.size % other.align == 0

    def walk(self, cdr: bytes, at: int, trail: Trail) -> int:
        """Where it ends if it begins at or after ``at``; what it comes past goes to ``trail``."""
        return trail.aligned(at, self.align) + self.size


class _Counted:
    """A count, then so many elements: a text, or a sequence of fields of constant size."""

    def __init__(self, size: int) -> None:
        self._size = size

    def walk(self, cdr: bytes, at: int, trail: Trail) -> int:
        """See :meth:`_Stride.walk`."""
        count, at = trail.counted(cdr, at)
        if not count:
            return at
        return trail.aligned(at, self._size) + count * self._size


class _Repeated:
    """A sequence, or an array, of what has no constant size."""

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
    """How a message of a type is laid out: its counts decide that, and nothing else does."""

    def __init__(self, cdr: bytes, trail: Trail) -> None:
        """Learn from a message with zeros in its gaps."""
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
    """What was found out about messages of one type, by how they are laid out."""

    def __init__(self) -> None:
        """Begin."""
        self._known: dict[int, list[tuple[_Layout, T]]] = {}  # by length

    def find(self, cdr: bytes) -> T | None:
        """What was found out about one that is laid out like ``cdr``; None where none was seen."""
        for layout, what in self._known.get(len(cdr), ()):
            if layout.has(cdr):
                return what
        return None

    def learn(self, cdr: bytes, trail: Trail, what: T) -> None:
        """Remember ``what`` of those like ``cdr``, through which ``trail`` leads."""
        if sum(map(len, self._known.values())) == MOST_LAYOUTS:
            self._known.clear()
        self._known.setdefault(len(cdr), []).append((_Layout(cdr, trail), what))


class Walk:
    """The way through the messages of one type."""

    def __init__(self, steps: Iterable[Any]) -> None:
        """Run together what can be; ``steps`` come from :func:`walk_of`."""
        self._steps = tuple(_joined(steps))
        self._sound = Layouts[bool]()

    def without_gaps(self, cdr: bytes) -> bytes:
        """The message with zeros in its gaps, cut after its last field.

        Raises:
            ValueError, struct.error: the bytes are no message of the type.
        """
        # Most messages are as they should be, and laid out like the one before them.
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
        mended = bytearray(cdr[:at])
        for start, end in wrong:
            mended[start:end] = bytes(end - start)
        return bytes(mended)


def walk_of(store: Any, type_name: str) -> Walk:
    """The way through messages of a type.

    Args:
        store: rosbags' type store that knows it.
        type_name: such as ``nav_msgs/msg/Odometry``.

    Raises:
        KeyError: the store does not know it, or one of its fields is of a type like wide text.
    """
    return Walk(_steps(store, type_name))


def _steps(store: Any, type_name: str) -> list[Any]:
    return [step for _, kind in store.fielddefs[type_name][1] for step in steps_of(store, kind)]


def steps_of(store: Any, kind: Any) -> list[Any]:
    """The way through one field of a kind that rosbags' ``fielddefs`` names; errors as above."""
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
