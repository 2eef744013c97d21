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
    at = int(rng.integers(len(data) or 1))
    return data[:at] + bytes([(data[at:] or b'\0')[0] ^ 1 << int(rng.integers(8))]) + data[at + 1:]


def _splice(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes put in, or none, in the place of none, as many, some, or all that follow."""
    at, new = _place(data, rng), rng.bytes(int(rng.integers(33)))
    gone = rng.choice([0, len(new), int(rng.integers(33)), len(data) // 8, len(data)])
    return data[:at] + new * int(rng.integers(2)) + data[at + int(gone):]


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
    """A line moved, said twice, left out, or indented otherwise."""
    lines = data.splitlines(keepends=True) or [b'']
    line = lines.pop(int(rng.integers(len(lines))))
    if rng.random() < 0.3:
        line = b'  ' + line if rng.random() < 0.5 else line.lstrip()
    for _ in range(int(rng.integers(3))):
        lines.insert(int(rng.integers(len(lines) + 1)), line)
    return b''.join(lines)


_BYTE_EDITS: tuple[Edit, ...] = (_flip, _splice, _splice, _number, _repeat)
_TEXT_EDITS: tuple[Edit, ...] = (_special, _special, _special, _swap, _line)
