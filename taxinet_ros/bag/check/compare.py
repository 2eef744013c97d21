"""Two bags compared topic by topic, down to the first field that differs; and golden bags.

The messages of a topic are compared in their order. Run names are ignored, since a scene may be run
under several names. Golden bags are runs in the repository that every change has to reproduce or to
justify. On the stack that recorded them (processor features, C library, numeric libraries) a run is
bit-identical. On other stacks sines and sums may round differently, and a closed loop amplifies
this; values are then compared with a tolerance.
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

from taxinet_ros.bag.cdr.decode import ABSENT, SCENARIO_TYPE, decode
from taxinet_ros.bag.layout import METADATA_FILE
from taxinet_ros.bag.reader import StoredMessage, read_info, stored_messages
from taxinet_ros.bag.run.topics import is_of_frames
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.provenance import differences, known, provenance
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
        field: dotted path within the message.
        values: in either bag, for people.
    """

    number: int
    seq: int
    field: str
    values: tuple[str, str]

    def __str__(self) -> str:
        """Short display text."""
        return f'step {self.seq}, {self.field}: {self.values[0]} | {self.values[1]}'


@dataclass(kw_only=True)
class TopicComparison:
    """How two bags compare on one topic.

    Attributes:
        topic: its name.
        counts: messages in either bag.
        differing: of the messages that both have, those that differ beyond the tolerance.
        greatest: maximum difference of two numbers in them, tolerated or not.
        first: the first difference beyond the tolerance, or None.
    """

    topic: str
    counts: tuple[int, int]
    differing: int = 0
    greatest: float = 0.0
    first: FieldDifference | None = None

    @property
    def equal(self) -> bool:
        """Whether both hold the same, within the tolerance."""
        return not self.differing and self.counts[0] == self.counts[1]


def compare_bags(
    one: Path, other: Path, *, tolerance: float = 0.0, skip: Collection[str] = ()
) -> list[TopicComparison]:
    """Compare all messages of two bags.

    Args:
        one: a run folder or an ``.mcap`` file.
        other: the same.
        tolerance: tolerance of floating-point values; 0: bit-identical.
        skip: topics to leave out.

    Returns:
        A comparison for every topic of either bag that has messages, in the order of the bags;
        of transforms, only where both bags have them.

    Raises:
        BagError, UsageError: a bag cannot be read.
    """
    counts = [read_info(path).counts for path in (one, other)]
    names = [
        name for name in dict.fromkeys([*counts[0], *counts[1]])
        # Older bags have no transforms, which follow from odometry anyway.
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
    for a, b in _pairs(one, other, both):
        topic = found[a.topic.name]
        _compare(topic, numbers[topic.topic], a, b, tolerance)
        numbers[topic.topic] += 1
    return [topic for topic in found.values() if any(topic.counts)]


def first_step(topics: Collection[TopicComparison]) -> int | None:
    """The first control step with a difference on any topic, or None."""
    return min((topic.first.seq for topic in topics if topic.first is not None), default=None)


def _pairs(
    one: Path, other: Path, topics: Collection[str]
) -> Iterator[tuple[StoredMessage, StoredMessage]]:
    """Messages of equal topic and number; read side by side, so that few wait for their match."""
    wanted = frozenset(topics).__contains__
    waiting: list[dict[str, deque[StoredMessage]]] = [{}, {}]
    for pair in zip_longest(stored_messages(one, wanted), stored_messages(other, wanted)):
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
    topic: TopicComparison, number: int, a: StoredMessage, b: StoredMessage, tolerance: float
) -> None:
    if a.cdr == b.cdr and a.topic.definition == b.topic.definition and a.stamp_ns == b.stamp_ns:
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
        seq = a.stamp_ns // CONTROL_PERIOD_NS
        topic.first = FieldDifference(number=number, seq=seq, field=path, values=values)


def _differences(
    a: StoredMessage, b: StoredMessage
) -> Iterator[tuple[str, tuple[str, str], float]]:
    """Path, values and size of every difference; the size of one that is no number is NaN."""
    if a.stamp_ns != b.stamp_ns:
        yield 'log time', (f'{a.stamp_ns} ns', f'{b.stamp_ns} ns'), math.nan
    one = dict(_leaves('', decode(a.topic, a.cdr)))
    other = dict(_leaves('', decode(b.topic, b.cdr)))
    # What a recording of before could not say yet was so.
    unsaid = ABSENT if a.topic.type == b.topic.type == SCENARIO_TYPE else {}
    for path in dict.fromkeys([*one, *other]):
        x, y = (leaves.get(path, unsaid.get(path, _ABSENT)) for leaves in (one, other))
        if isinstance(x, np.ndarray) and isinstance(y, np.ndarray):
            yield from _array_difference(path, x, y)
        elif isinstance(x, float) and isinstance(y, float):
            if struct.pack('<d', x) != struct.pack('<d', y) and not (x != x and y != y):
                yield path, (repr(x), repr(y)), abs(x - y)
        elif x != y:
            yield path, (_words(x), _words(y)), math.nan


def _array_difference(
    path: str, x: NDArray[Any], y: NDArray[Any]
) -> Iterator[tuple[str, tuple[str, str], float]]:
    if x.shape != y.shape:
        yield path, (f'{x.size} values', f'{y.size} values'), math.nan
        return
    away = ~((x == y) | ((x != x) & (y != y)))
    if away.any():
        place = int(np.flatnonzero(away)[0])
        floating = np.issubdtype(x.dtype, np.floating)
        size = float(np.abs(x[away].astype(np.float64) - y[away].astype(np.float64)).max())
        values = (repr(x[place].item()), repr(y[place].item()))
        # Whole numbers, pixels among them, are the same or they are not.
        yield f'{path}[{place}]', values, size if floating else math.nan


def _leaves(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The numbers, texts and arrays of a message by their paths."""
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
"""How far numbers may be apart on another stack, in their own units.

Measured by switching processor features off (AVX2 and FMA, in the C library, numpy and OpenCV):
without pictures 2e-18; with a network 0.04 at most, for pixels round to the next code here and
there, and estimates follow.
"""
_DECISIVE = frozenset({
    'machine', 'processor_features', 'libc', 'numpy', 'opencv-python-headless', 'onnxruntime',
    'jsbsim', 'astral', 'pymap3d',
})
"""What the last bits of these runs depend on; the commit is what is under test."""


@dataclass(frozen=True, kw_only=True)
class GoldenResult:
    """How a golden run came out this time.

    Attributes:
        bag: the golden bag.
        again: the bag of the new run.
        tolerance: within which it was compared; 0 is to the bit.
        topics: the comparison.
    """

    bag: Path
    again: Path
    tolerance: float
    topics: Sequence[TopicComparison]

    @property
    def equal(self) -> bool:
        """Whether it came out the same."""
        return all(topic.equal for topic in self.topics)


def golden_bags(folder: Path) -> list[Path]:
    """The bags in a folder of golden bags, by name.

    Raises:
        UsageError: there are none.
    """
    bags = sorted(path.parent for path in folder.glob(f'*/{METADATA_FILE}'))
    if not bags:
        raise UsageError(f'{folder}: holds no bags; a bag copied there becomes golden')
    return bags


def compare_golden(bag: Path, again: Path, *, perception: str, to_the_bit: bool) -> GoldenResult:
    """Hold a new run against its golden bag."""
    elsewhere = TRUTH_TOLERANCE if perception == 'truth' else NETWORK_TOLERANCE
    tolerance = 0.0 if to_the_bit else elsewhere
    topics = compare_bags(bag, again, tolerance=tolerance)
    return GoldenResult(bag=bag, again=again, tolerance=tolerance, topics=topics)


def same_stack(folder: Path) -> bool:
    """Whether this machine has all that the golden bags in a folder say they were recorded with."""
    told = read_stack(folder)
    here = provenance()
    return bool(told) and all(here.get(name) == value for name, value in told.items())


def stack_differences(folder: Path) -> str:
    """What is another here than where the golden bags come from; '' where nothing is."""
    told = read_stack(folder)
    return differences(told, provenance()) if told else f'{STACK_FILE} tells nothing'


def read_stack(folder: Path) -> dict[str, str]:
    """The stack that the golden bags in a folder come from; empty where untold."""
    try:
        values = load_json((folder / STACK_FILE).read_text(encoding='utf-8'))
        return known(values)
    except (OSError, ValueError):
        return {}


def write_stack(folder: Path) -> None:
    """Note that the golden bags in a folder come from this stack."""
    facts = {name: value for name, value in provenance().items() if name in _DECISIVE}
    write_atomically(folder / STACK_FILE, json.dumps(facts, indent=2) + '\n')
