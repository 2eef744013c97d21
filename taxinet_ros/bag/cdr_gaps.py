"""Where the alignment gaps of a serialised message are.

A message type becomes a short list of strides, as long as its fields of constant size can be run
together; walking a message along them costs a few microseconds, writing it anew ten times that.
Layout: OMG Common Data Representation, version 1 (CORBA 3.3, part 2, section 9.3), which ROS 2
uses: every field is aligned to its own size, counted from the end of the encapsulation.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import Any

from rosbags.interfaces import Nodetype

_BODY = 4
"""Bytes of encapsulation before the first field."""

_COUNT = struct.Struct('<I')
_SIZES = {
    'bool': 1, 'byte': 1, 'char': 1, 'octet': 1, 'int8': 1, 'uint8': 1, 'int16': 2, 'uint16': 2,
    'int32': 4, 'uint32': 4, 'float32': 4, 'int64': 8, 'uint64': 8, 'float64': 8,
}
_TEXT = 1
_MAX_TAIL = 3
"""Middleware rounds the length of a message up to a multiple of four bytes."""

_Gaps = list[tuple[int, int]]


class _Stride:
    """Bytes of constant number, the first aligned, without gaps among them."""

    def __init__(self, align: int, size: int) -> None:
        self.align, self.size = align, size

    def joins(self, other: _Stride) -> bool:
        """Whether ``other`` can follow without a gap, wherever this one begins."""
        return other.align <= self.align and self.size % other.align == 0

    def walk(self, cdr: bytes, at: int, gaps: _Gaps) -> int:
        """Where it ends if it begins at or after ``at``; the gap before it goes to ``gaps``."""
        return _aligned(at, self.align, gaps) + self.size


class _Counted:
    """A count, then so many elements: a text, or a sequence of fields of constant size."""

    def __init__(self, size: int) -> None:
        self._size = size

    def walk(self, cdr: bytes, at: int, gaps: _Gaps) -> int:
        """See :meth:`_Stride.walk`."""
        at = _aligned(at, _COUNT.size, gaps)
        (count,) = _COUNT.unpack_from(cdr, at)
        at += _COUNT.size
        if not count:
            return at
        return _aligned(at, self._size, gaps) + count * self._size


class _Repeated:
    """A sequence, or an array, of what has no constant size."""

    def __init__(self, steps: Sequence[Any], count: int | None) -> None:
        self._steps, self._count = tuple(steps), count

    def walk(self, cdr: bytes, at: int, gaps: _Gaps) -> int:
        """See :meth:`_Stride.walk`."""
        count = self._count
        if count is None:
            at = _aligned(at, _COUNT.size, gaps)
            (count,) = _COUNT.unpack_from(cdr, at)
            at += _COUNT.size
        for _ in range(count):
            before = at
            for step in self._steps:
                at = step.walk(cdr, at, gaps)
            if at > len(cdr) or at == before:
                raise ValueError(f'{count} elements do not fit')
        return at


class Walk:
    """The way through the messages of one type."""

    def __init__(self, steps: Iterable[Any]) -> None:
        """Run together what can be; ``steps`` come from :func:`walk_of`."""
        self._steps = tuple(_joined(steps))

    def without_gaps(self, cdr: bytes) -> bytes:
        """The message with zeros in its gaps, cut after its last field.

        Raises:
            ValueError, struct.error: the bytes are no message of the type.
        """
        at = _BODY
        gaps: _Gaps = []
        for step in self._steps:
            at = step.walk(cdr, at, gaps)
        if not at <= len(cdr) <= at + _MAX_TAIL:
            raise ValueError(f'fields end at byte {at}')
        # Most messages are as they should be, and big ones are not copied for nothing.
        wrong = [(start, end) for start, end in gaps if any(cdr[start:end])]
        if not wrong and len(cdr) == at:
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
    return [step for _, kind in store.fielddefs[type_name][1] for step in _field(store, kind)]


def _field(store: Any, kind: Any) -> list[Any]:
    node, what = kind
    if node is Nodetype.BASE:
        name = what[0]
        return [_Counted(_TEXT) if name == 'string' else _Stride(_SIZES[name], _SIZES[name])]
    if node is Nodetype.NAME:
        return _steps(store, what)
    element, count = what
    inner = _joined(_field(store, element))
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


def _aligned(at: int, align: int, gaps: _Gaps) -> int:
    short = (_BODY - at) % align
    if short:
        gaps.append((at, at + short))
    return at + short
