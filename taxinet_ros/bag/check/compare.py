"""Compare two bags topic by topic, down to the first different field; and golden bags.

The messages of a topic are compared in order. Run names are ignored, because a scene may be run
under several names. Golden bags are reference runs in the repository; a change must reproduce them
or justify the difference. On the stack that recorded them (processor features, C library, numeric
libraries) a run is bit-identical. On other stacks sines and sums may round differently, and a
closed loop amplifies this; values are then compared with a tolerance.
"""

from __future__ import annotations

import json
import math
import struct
from collections import deque
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.layout import METADATA_FILE
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.topics import is_of_frames
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.core.provenance import differences, known, provenance
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import load_json

_NAMES = frozenset({'run_id'})
_ABSENT = object()
_SHOWN_CHARS = 60


@dataclass(frozen=True, kw_only=True)
class FieldDifference:
    """The first field in which two bags differ on a topic.

    Attributes:
        number: number of the message on its topic, from 0.
        seq: control step of its stamp.
        stamp_ns: the stamp [ns].
        field: dotted path in the message.
        values: display text of the value in each bag.
    """

    number: int
    seq: int
    stamp_ns: int
    field: str
    values: tuple[str, str]

    def __str__(self) -> str:
        """Short display text."""
        return f'step {self.seq}, {self.field}: {self.values[0]} | {self.values[1]}'


@dataclass(kw_only=True)
class TopicComparison:
    """Comparison of two bags on one topic.

    Attributes:
        topic: name of the topic.
        counts: number of messages in each bag.
        differing: number of common messages that differ beyond the tolerance.
        greatest: maximum difference of two numbers in them, within the tolerance or not.
        first: the first difference beyond the tolerance, or None.
    """

    topic: str
    counts: tuple[int, int]
    differing: int = 0
    greatest: float = 0.0
    first: FieldDifference | None = None

    @property
    def equal(self) -> bool:
        """Whether both bags are equal on the topic, within the tolerance."""
        return not self.differing and self.counts[0] == self.counts[1]


def compare_bags(
    one: Path | Recording, other: Path | Recording, *, tolerance: float = 0.0,
    skip: Collection[str] = (),
) -> list[TopicComparison]:
    """Compare all messages of two bags.

    Args:
        one: a run folder, an ``.mcap`` file, or a recording.
        other: the same of the other.
        tolerance: tolerance of floating-point values; 0: bit-identical.
        skip: topics to skip.

    Returns:
        A comparison for every topic with messages in either bag, in the order of the bags;
        transforms only if both bags have them.

    Raises:
        UsageError: their control rates differ, so that messages have no partners.
    """
    bags = [bag if isinstance(bag, Recording) else open_recording(bag) for bag in (one, other)]
    if bags[0].period_ns != bags[1].period_ns:
        one_at, other_at = (f'{bag.path} at {NS_PER_S / bag.period_ns:g} Hz' for bag in bags)
        raise UsageError(
            f'{one_at}, {other_at}: messages are compared in order, which needs one control rate; '
            'compare runs with the same control_rate_hz')
    counts = [bag.info.counts for bag in bags]
    names = [
        name for name in dict.fromkeys([*counts[0], *counts[1]])
        # Bags of taxinet bag split have no transforms; these are redundant with odometry.
        if name not in skip and not (
            is_of_frames(name) and not all(count.get(name) for count in counts))
    ]
    found = {
        name: TopicComparison(
            topic=name, counts=(counts[0].get(name, 0), counts[1].get(name, 0))
        )
        for name in names
    }
    both = {name for name in names if all(found[name].counts)}
    numbers = dict.fromkeys(both, 0)
    for a, b in _pairs(bags, both):
        topic = found[a.topic.name]
        _compare(topic, numbers[topic.topic], a, b, tolerance, bags[0].period_ns)
        numbers[topic.topic] += 1
    return [topic for topic in found.values() if any(topic.counts)]


def first_difference(topics: Collection[TopicComparison]) -> FieldDifference | None:
    """The difference at the first control step with one on any topic, or None."""
    found = (topic.first for topic in topics if topic.first is not None)
    return min(found, key=lambda one: one.stamp_ns, default=None)


def _pairs(
    bags: Sequence[Recording], topics: Collection[str]
) -> Iterator[tuple[StoredMessage, StoredMessage]]:
    """Pairs of messages with equal topic and number; both bags are read in parallel."""
    wanted = frozenset(topics).__contains__
    waiting: list[dict[str, deque[StoredMessage]]] = [{}, {}]
    for pair in zip_longest(*(bag.whole_messages(wanted) for bag in bags)):
        for side, message in enumerate(pair):
            if message is None:
                continue
            name = message.topic.name
            match = waiting[1 - side].get(name)
            if match:
                partner = match.popleft()
                yield (message, partner) if side == 0 else (partner, message)
            else:
                waiting[side].setdefault(name, deque()).append(message)


def _compare(
    topic: TopicComparison, number: int, a: StoredMessage, b: StoredMessage, tolerance: float,
    period_ns: int,
) -> None:
    if _meaning(a) == _meaning(b):
        return
    differences = list(_differences(a, b))
    sizes = [size for _, _, size in differences if not math.isnan(size)]
    topic.greatest = max([topic.greatest, *sizes])
    beyond = [found for found in differences if tolerance == 0 or not found[2] <= tolerance]
    if not beyond:
        return
    topic.differing += 1
    if topic.first is None:
        path, values, _ = beyond[0]
        topic.first = FieldDifference(
            number=number, seq=a.stamp_ns // period_ns, stamp_ns=a.stamp_ns, field=path,
            values=values,
        )


def _meaning(message: StoredMessage) -> tuple[object, ...]:
    """All that two messages may differ in."""
    topic = message.topic
    return message.stamp_ns, topic.type, topic.definition, message.cdr


def _differences(
    a: StoredMessage, b: StoredMessage
) -> Iterator[tuple[str, tuple[str, str], float]]:
    """Path, values and size of every difference; the size is NaN for non-numeric values."""
    if a.stamp_ns != b.stamp_ns:
        yield 'log time', (f'{a.stamp_ns} ns', f'{b.stamp_ns} ns'), math.nan
    if a.topic.type != b.topic.type:
        yield 'type', (a.topic.type, b.topic.type), math.nan
    if 'cdr' not in (a.topic.encoding, b.topic.encoding):
        if a.cdr != b.cdr:
            yield 'bytes', (f'{len(a.cdr)} bytes', f'{len(b.cdr)} bytes'), math.nan
        return
    one = dict(_leaves('', decode(a.topic, a.cdr)))
    other = dict(_leaves('', decode(b.topic, b.cdr)))
    for path in dict.fromkeys([*one, *other]):
        x, y = (leaves.get(path, _ABSENT) for leaves in (one, other))
        if isinstance(x, np.ndarray) and isinstance(y, np.ndarray):
            yield from _array_difference(path, x, y)
        elif isinstance(x, float) and isinstance(y, float):
            if struct.pack('<d', x) != struct.pack('<d', y) and not (x != x and y != y):
                yield path, (repr(x), repr(y)), abs(x - y)
        elif isinstance(x, np.ndarray) or isinstance(y, np.ndarray) or x != y:
            yield path, (_words(x), _words(y)), math.nan


def _array_difference(
    path: str, x: NDArray[Any], y: NDArray[Any]
) -> Iterator[tuple[str, tuple[str, str], float]]:
    if x.shape != y.shape:
        yield path, (f'{x.size} values', f'{y.size} values'), math.nan
        return
    floating = np.issubdtype(x.dtype, np.floating)
    away = ~((x == y) | ((x != x) & (y != y)))
    if floating and np.issubdtype(y.dtype, np.floating):
        away |= (x == 0) & (np.signbit(x) != np.signbit(y))
    if away.any():
        place = int(np.flatnonzero(away)[0])
        size = float(np.abs(x[away].astype(np.float64) - y[away].astype(np.float64)).max())
        values = (repr(x[place].item()), repr(y[place].item()))
        # For integers, such as pixels, there is no tolerance.
        yield f'{path}[{place}]', values, size if floating else math.nan


def _leaves(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numbers, strings and arrays of a message, with their paths."""
    if is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            if field.name not in _NAMES and not field.name.startswith('__'):
                inner = f'{path}.{field.name}' if path else field.name
                yield from _leaves(inner, getattr(value, field.name))
    elif isinstance(value, list):
        yield f'{path}.length', len(value)
        for number, item in enumerate(value):
            yield from _leaves(f'{path}[{number}]', item)
    else:
        yield path, value


def _words(value: Any) -> str:
    text = 'nothing' if value is _ABSENT else repr(value)
    return text if len(text) <= _SHOWN_CHARS else text[: _SHOWN_CHARS - 1] + '…'


STACK_FILE = 'stack.json'
TRUTH_TOLERANCE, NETWORK_TOLERANCE = 1e-6, 0.15
"""Tolerances on another stack, in the units of the values.

Measured with processor features disabled (AVX2 and FMA, in the C library, numpy and OpenCV):
without images 2e-18; with a network at most 0.04, because some pixels round to the next code, which
changes the estimates.
"""
_DECISIVE = frozenset({
    'machine', 'numpy_features', 'blas', 'libc', 'numpy', 'opencv-python-headless', 'jsbsim',
    'astral', 'pymap3d',
})
"""Facts that the last bits of these runs depend on.

The processor is not one: on every x86-64-v3 the features that numpy and its BLAS use are the same.
Nor is the commit, as it is under test.
"""


@dataclass(frozen=True, kw_only=True)
class GoldenResult:
    """Result of repeating a golden run.

    Attributes:
        bag: the golden bag.
        again: the bag of the new run.
        tolerance: tolerance of the comparison; 0: bit-identical.
        topics: the comparison.
    """

    bag: Path
    again: Path
    tolerance: float
    topics: Sequence[TopicComparison]

    @property
    def equal(self) -> bool:
        """Whether both runs are equal."""
        return all(topic.equal for topic in self.topics)


def golden_bags(folder: Path) -> list[Path]:
    """Bags in a folder of golden bags, ordered by name.

    Raises:
        UsageError: the folder contains no bags.
    """
    bags = sorted(path.parent for path in folder.glob(f'*/{METADATA_FILE}'))
    if not bags:
        raise UsageError(f'{folder}: holds no bags; a bag copied there becomes golden')
    return bags


def compare_golden(bag: Path, again: Path, *, perception: str, to_the_bit: bool) -> GoldenResult:
    """Compare a new run with its golden bag."""
    elsewhere = TRUTH_TOLERANCE if perception == 'truth' else NETWORK_TOLERANCE
    tolerance = 0.0 if to_the_bit else elsewhere
    topics = compare_bags(bag, again, tolerance=tolerance)
    return GoldenResult(bag=bag, again=again, tolerance=tolerance, topics=topics)


def same_stack(folder: Path) -> bool:
    """Whether this machine has the stack on which the golden bags in a folder were recorded."""
    told = read_stack(folder)
    here = provenance()
    return bool(told) and all(here.get(name) == value for name, value in told.items())


def stack_differences(folder: Path) -> str:
    """Differences between this stack and that of the golden bags; '' if there are none."""
    told = read_stack(folder)
    return differences(told, provenance()) if told else f'{STACK_FILE} tells nothing'


def read_stack(folder: Path) -> dict[str, str]:
    """Stack on which the golden bags in a folder were recorded; empty if unknown."""
    try:
        values = load_json((folder / STACK_FILE).read_text(encoding='utf-8'))
        return known(values)
    except (OSError, ValueError):
        return {}


def write_stack(folder: Path) -> None:
    """Record this stack as that of the golden bags in a folder."""
    facts = {name: value for name, value in provenance().items() if name in _DECISIVE}
    write_atomically(folder / STACK_FILE, json.dumps(facts, indent=2) + '\n')
