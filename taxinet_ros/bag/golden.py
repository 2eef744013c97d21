"""Golden bags: runs kept in the repository, that every change has to reproduce or to account for.

On the stack that recorded them (processor features, C library, numeric libraries) a run comes out
the same to the bit. Elsewhere sines and sums may round otherwise, and a closed loop carries that
on; there numbers are compared with a tolerance.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from taxinet_ros.bag.compare import TopicComparison, compare_bags
from taxinet_ros.bag.layout import METADATA_FILE, write_atomically
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.plain_values import load_json

STACK_FILE = 'stack.json'
TRUTH_TOLERANCE, NETWORK_TOLERANCE = 1e-6, 0.15
"""How far numbers may be apart on another stack, in their own units.

Measured by switching processor features off (AVX2 and FMA, in the C library, numpy and OpenCV):
without pictures 2e-18; with a network 0.04 at most, for pixels round to the next code here and
there, and estimates follow.
"""

_FEATURES = ('avx2', 'fma', 'avx512f', 'avx512_vnni', 'asimd')
_LIBRARIES = ('numpy', 'opencv-python-headless', 'onnxruntime', 'jsbsim', 'astral', 'pymap3d')


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


def compare_golden(bag: Path, again: Path, *, perception: str, same_stack: bool) -> GoldenResult:
    """Hold a new run against its golden bag."""
    elsewhere = TRUTH_TOLERANCE if perception == 'truth' else NETWORK_TOLERANCE
    tolerance = 0.0 if same_stack else elsewhere
    topics = compare_bags(bag, again, tolerance=tolerance)
    return GoldenResult(bag=bag, again=again, tolerance=tolerance, topics=topics)


def stack_facts() -> dict[str, str]:
    """What the last bits of a run depend on besides this package."""
    return {
        'machine': platform.machine(),
        'processor_features': ' '.join(_features()),
        'libc': ' '.join(platform.libc_ver()),
        **{name: version(name) for name in _LIBRARIES},
    }


def read_stack(folder: Path) -> dict[str, str]:
    """The stack that the golden bags in a folder come from; empty where untold."""
    try:
        values = load_json((folder / STACK_FILE).read_text(encoding='utf-8'))
        return {str(name): str(value) for name, value in values.items()}
    except (OSError, ValueError, AttributeError):
        return {}


def write_stack(folder: Path) -> None:
    """Note that the golden bags in a folder come from this stack."""
    write_atomically(folder / STACK_FILE, json.dumps(stack_facts(), indent=2) + '\n')


def _features() -> list[str]:
    try:
        lines = Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines()
    except OSError:
        return []
    flags = [line for line in lines if line.startswith(('flags', 'Features'))]
    known = flags[0].partition(':')[2].split() if flags else []
    return [name for name in _FEATURES if name in known]
