"""Mutants of sound files: bytes and words changed, repeated, left out; the same for the same seed.

``TAXINET_FUZZ=50`` in the environment makes fifty times as many, for a campaign of an evening.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence

import numpy as np

ROUNDS = int(os.environ.get('TAXINET_FUZZ', '1'))

_WORD = re.compile(rb'[A-Za-z_]+|[0-9.eE+-]+|\s+|.', re.DOTALL)
_SPECIAL = (
    b'', b'0', b'-1', b'1e400', b'NaN', b'-Infinity', b'9' * 30, b'9' * 5000, b'null', b'true',
    b'[]', b'{}', b'""', b'[' * 3000, b'{"a":' * 3000, b'\x00', b'\xff\xfe', b'\xf0\x9f\x9b\xac',
    b'\n', b'\t', b'\r', b'"', b"'", b'#', b':', b'- ', b'&a *a', b'*a', b'<<: *a', b'!!bool x',
    b'!!int ""', b'!!python/object/apply:os.system [true]', b'../../etc/passwd', b'%s%n', b'\\',
    b'2001-99-99', b'=', b'(', b')', b'1:2:3', b'18446744073709551615', b'-9223372036854775809',
)  # fmt: skip

Edit = Callable[[bytes, np.random.Generator], bytes]


def mutants(
    corpus: Sequence[bytes], count: int, seed: int, *, text: bool = False
) -> Iterator[bytes]:
    """``count`` mutants, times :data:`ROUNDS`, of the texts or binaries of a corpus."""
    rng = np.random.default_rng(seed)
    for _ in range(count * ROUNDS):
        data = corpus[int(rng.integers(len(corpus)))]
        for _ in range(int(rng.integers(1, 4))):
            edits = _TEXT_EDITS if text and rng.random() < 0.8 else _BYTE_EDITS
            data = edits[int(rng.integers(len(edits)))](data, rng)
        yield data


def _place(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data) + 1))


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    if not data:
        return b'\x00'
    at = int(rng.integers(len(data)))
    return data[:at] + bytes([data[at] ^ 1 << int(rng.integers(8))]) + data[at + 1:]


def _overwrite(data: bytes, rng: np.random.Generator) -> bytes:
    at, new = _place(data, rng), rng.bytes(int(rng.integers(1, 9)))
    return data[:at] + new + data[at + len(new):]


def _insert(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + rng.bytes(int(rng.integers(1, 33))) + data[at:]


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at + int(rng.integers(1, max(2, len(data) // 8))):]


def _truncate(data: bytes, rng: np.random.Generator) -> bytes:
    return data[:_place(data, rng)]


def _number(data: bytes, rng: np.random.Generator) -> bytes:
    """A great or odd number in the place of eight, four or two bytes."""
    size = int(rng.choice([2, 4, 8]))
    value = int(rng.choice([0, 1, -1, 2**15, 2**31 - 1, 2**31, 2**62])) % 2 ** (8 * size)
    at = _place(data, rng)
    return data[:at] + value.to_bytes(size, 'little') + data[at + size:]


def _repeat(data: bytes, rng: np.random.Generator) -> bytes:
    start, end = sorted((_place(data, rng), _place(data, rng)))
    part = data[start:min(end, start + 4096)]
    return data[:start] + part * int(rng.integers(1, 8)) + data[start:]


def _special(data: bytes, rng: np.random.Generator) -> bytes:
    """A word of the text in the place of which something special stands."""
    words = _WORD.findall(data)
    if not words:
        return _SPECIAL[int(rng.integers(len(_SPECIAL)))]
    words[int(rng.integers(len(words)))] = _SPECIAL[int(rng.integers(len(_SPECIAL)))]
    return b''.join(words)


def _swap(data: bytes, rng: np.random.Generator) -> bytes:
    words = _WORD.findall(data)
    if words:
        one, other = (int(rng.integers(len(words))) for _ in range(2))
        words[one], words[other] = words[other], words[one]
    return b''.join(words)


def _line(data: bytes, rng: np.random.Generator) -> bytes:
    """A line moved, said twice or left out."""
    lines = data.splitlines(keepends=True)
    if not lines:
        return data
    line = lines.pop(int(rng.integers(len(lines))))
    for _ in range(int(rng.integers(3))):
        lines.insert(int(rng.integers(len(lines) + 1)), line)
    return b''.join(lines)


def _outdent(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.splitlines(keepends=True)
    if lines:
        at = int(rng.integers(len(lines)))
        lines[at] = b'  ' + lines[at] if rng.random() < 0.5 else lines[at].lstrip()
    return b''.join(lines)


_BYTE_EDITS: tuple[Edit, ...] = (_flip, _overwrite, _insert, _cut, _truncate, _number, _repeat)
_TEXT_EDITS: tuple[Edit, ...] = (_special, _special, _special, _swap, _line, _outdent)
