"""Digests of a fixed set of runs, to be compared between machines: equal bits, or which run not.

Each scene runs with each network in one process without ROS, in half of the scenes with other
weather, aircraft, cameras, lens faults or traffic. A digest covers every camera frame and every
message of the run's bag: truth, estimates, commands, robustness, verdict.
"""

from __future__ import annotations

import hashlib
import random
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.api.run import run
from taxinet_ros.arguments import is_number
from taxinet_ros.bag.reader import stored_messages
from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.bench.report import read_report
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.types import TrackingError
from taxinet_ros.errors import UsageError

NETWORKS = ('taxinet', 'original')
SCENES, DURATION_S = 40, 3.0
_SEED = 25
_KEYS = {'scene', 'network', 'frames', 'bag', 'outcome', 'rho'}
_UNUSUAL: tuple[dict[str, Any], ...] = (
    {'wind_speed': 12.0, 'wind_direction': 110.0, 'gust': 3.0, 'gust_seed': 7},
    {'lens_drops': 40.0},
    {'aircraft': 'c172p', 'camera': 'strut'},
    {'camera': 'tail'},
    {'lens_dirt': 40.0, 'runway_state': 'wet', 'glare_ghost': 50.0},
    {'slope': 1.0, 'steering_bias': 2.0, 'place': 'bikf_10'},
    {'traffic': True, 'loop_jitter': 0.2, 'camera_dropout': 20.0},
)


def fixed_scenes(count: int) -> Iterator[dict[str, Any]]:
    """The first scenes of an endless sequence, in human units."""
    draws = random.Random(_SEED)
    for number in range(count):
        usual: dict[str, Any] = {
            'cross_track': round(draws.uniform(-8, 8), 2),
            'heading': round(draws.uniform(-30, 30), 1),
            'distance': round(draws.uniform(100, 2000), 1),
            'time_of_day': round(draws.uniform(6, 18), 2),
            'clouds': draws.choice(CLOUDS),
            'rain': round(draws.uniform(1, 100)),
        }
        if usual['clouds'] not in RAIN_CLOUDS:
            usual['rain'] = 0
        unusual = dict(_UNUSUAL[number // 2 % len(_UNUSUAL)]) if number % 2 else {}
        if unusual.pop('traffic', False):
            usual['traffic'] = _others(usual['distance'])
        yield usual | unusual


def _others(distance_m: float) -> str:
    """A van that crosses, a cone and a parked aircraft ahead of the start."""
    return load_traffic([
        {'kind': 'vehicle', 'x_m': distance_m + 40, 'y_m': -12, 'heading_deg': 90,
         'path': [{'x_m': distance_m + 40, 'y_m': 12, 'speed_mps': 3}]},
        {'kind': 'cone', 'x_m': distance_m + 20, 'y_m': 5},
        {'kind': 'aircraft', 'x_m': distance_m + 80, 'y_m': 25, 'heading_deg': 200},
    ])


class _Seen(Perception):
    """A perception that also digests the frames."""

    def __init__(self, inner: Perception) -> None:
        self.word, self.fingerprint = inner.word, inner.fingerprint
        self.needs_image = inner.needs_image
        self.digest = hashlib.sha256()
        self._inner = inner

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        if image is not None:
            self.digest.update(image.tobytes())
        return self._inner.estimate(image, truth)


def run_digests(scenario: Scenario, perception: Perception) -> dict[str, str]:
    """Digests of one run, and its verdict.

    Returns:
        ``frames`` and ``bag`` (SHA-256, 16 digits), ``outcome``, and ``rho``: hexadecimal, exact.
    """
    eyes = _Seen(perception)
    judged = run(scenario, perception=eyes, specs=['phi_always'])
    messages = hashlib.sha256()
    with tempfile.TemporaryDirectory() as folder:
        for topic, stamp_ns, cdr, _ in stored_messages(
            judged.save_bag(Path(folder, 'run'), images=False)
        ):
            facts = (topic.name, topic.type, topic.definition, stamp_ns, len(cdr))
            messages.update(repr(facts).encode())
            messages.update(cdr)
    return {
        'frames': eyes.digest.hexdigest()[:16], 'bag': messages.hexdigest()[:16],
        'outcome': str(judged.outcome), 'rho': next(iter(judged.rho.values())).lower.hex(),
    }


def measure_processors(
    scenes: int, duration_s: float, on_done: Callable[[int, int], None] = lambda done, total: None
) -> dict[str, Any]:
    """Run the scenes with both networks.

    Args:
        scenes: number of scenes.
        duration_s: length of each run [s].
        on_done: called with the numbers of runs done and in total.

    Returns:
        ``runs``: scene, network and the values of :func:`run_digests`; ``digest``: of them all;
        ``scenes``, ``duration_s``: what was asked for; ``machine``: where they were made.

    Raises:
        UsageError: a number that is not possible.
    """
    if scenes < 1:
        raise UsageError(f'bench: {scenes} scenes; at least 1 is needed')
    networks = [make_perception(word) for word in NETWORKS]
    runs: list[dict[str, Any]] = []
    for number, values in enumerate(fixed_scenes(scenes)):
        scenario = scenario_from_human({**values, 'duration': duration_s})
        for network in networks:
            runs.append({'scene': number, 'network': network.word,
                         **run_digests(scenario, network)})
            on_done(len(runs), scenes * len(networks))
    whole = hashlib.sha256(repr(runs).encode()).hexdigest()
    return {
        'digest': whole[:16], 'scenes': scenes, 'duration_s': duration_s,
        'machine': machine_facts(), 'runs': runs,
    }


def load_digests(path: Path) -> dict[str, Any]:
    """Read an earlier report.

    Raises:
        UsageError: there is no such file, or it is no such report.
    """
    return read_report(path, _is_report, 'taxinet bench processors')


def _is_report(report: Any) -> bool:
    if not isinstance(report, dict):
        return False
    scenes, runs = report.get('scenes'), report.get('runs')
    if not isinstance(runs, list) or not isinstance(scenes, int):
        return False
    whole = len(runs) == scenes * len(NETWORKS) > 0
    return whole and is_number(report.get('duration_s')) and all(
        isinstance(one, dict) and one.keys() == _KEYS for one in runs
    )


def differing_runs(one: Sequence[dict[str, Any]], other: Sequence[dict[str, Any]]) -> list[str]:
    """Runs of two reports that differ, and in what: ``scene 3, taxinet: bag, rho``."""
    found = []
    for a, b in zip(one, other, strict=True):
        parts = [name for name in a if a[name] != b.get(name)]
        if parts:
            found.append(f'scene {a["scene"]}, {a["network"]}: {", ".join(parts)}')
    return found
