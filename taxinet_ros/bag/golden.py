"""Golden bags: runs kept in the repository, that every change has to reproduce or to account for.

On the stack that recorded them (processor features, C library, numeric libraries) a run comes out
the same to the bit. Elsewhere sines and sums may round otherwise, and a closed loop carries that
on; there numbers are compared with a tolerance.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from taxinet_ros.bag.compare import TopicComparison, compare_bags
from taxinet_ros.bag.layout import METADATA_FILE, write_atomically
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.plain_values import load_json
from taxinet_ros.core.provenance import differences, known, provenance

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
