"""Digests of a fixed set of runs, to be compared between machines: equal bits, or which run not.

Each scene runs with each network in one process without ROS, in half of the scenes with other
weather, aircraft, cameras, lens faults or traffic. A digest covers every camera frame and every
message of the run's bag: truth, estimates, commands, robustness, verdict.
"""

from __future__ import annotations

import hashlib
import json
import random
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from common import count, leave, options, positive

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from taxinet_ros.api.run import run
from taxinet_ros.arguments import is_number
from taxinet_ros.bag.reader import stored_messages
from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.provenance import known, words
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.types import TrackingError
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.plain_values import load_json
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_file
from taxinet_ros.instructions import lacking

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
        UsageError: a length that no run may have.
    """
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
    try:
        report = load_json(read_file(path, MAX_TEXT_BYTES))
    except OSError as error:
        raise UsageError(f'cannot read {path}: {error.strerror}') from error
    except ValueError:
        report = None
    if not _is_report(report):
        raise UsageError(f'{path} is no report; --json > {path} makes one')
    return dict(report)


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


def compare(path: Path | None, scenes: int | None, duration_s: float | None) -> tuple[
    dict[str, Any] | None, int, float,
]:
    """Read the report to compare with, and choose the runs: the same ones, if there is one.

    Raises:
        UsageError: it is no report, or of other runs than asked for.
    """
    if path is None:
        return None, scenes or SCENES, duration_s or DURATION_S
    before = load_digests(path)
    theirs = before['scenes'], before['duration_s']
    if (scenes or theirs[0], duration_s or theirs[1]) != theirs:
        raise UsageError(
            f'{path} has {theirs[0]} scenes of {theirs[1]:g} s; leave out --scenes and --duration '
            'to repeat these'
        )
    return before, *theirs


def show(
    report: dict[str, Any], before: dict[str, Any] | None, differing: Sequence[str]
) -> None:
    """Print the digest, and what differs from another report."""
    runs = len(report['runs'])
    print(words(known(report['machine'])))
    if lacking():
        print(f'this processor lacks {lacking()}: its libraries may round differently')
    print(f'{runs} runs of {report["duration_s"]:g} s, frames and bags: digest {report["digest"]}')
    if before is None:
        return
    for line in differing:
        print(f'differs: {line}')
    print(f'{runs - len(differing)} of {runs} runs equal those of the other machine to the bit')


def main(argv: Sequence[str] | None = None) -> int:
    """Run the scenes, print their digests, and compare them with an earlier report.

    Returns:
        Exit code: 1 if runs differ from the earlier report, else 0.
    """
    parser = options(__doc__)
    parser.add_argument('--scenes', type=count, help=f'number of scenes (default {SCENES})')
    parser.add_argument('--duration', type=positive, metavar='S',
                        help=f'simulated length of each run (default {DURATION_S:g}) [s]')
    parser.add_argument('--compare', type=Path, metavar='OLD.json',
                        help='JSON report of another machine: repeat its runs; exit 1 if any bit '
                        'differs')
    given = parser.parse_args(argv)
    before, scenes, duration_s = compare(given.compare, given.scenes, given.duration)
    with stage_bars(Console(stderr=given.json)) as bars:
        report = measure_processors(
            scenes, duration_s, lambda done, total: bars('running', done, total)
        )
    differing = [] if before is None else differing_runs(report['runs'], before['runs'])
    if given.json:
        compared = {} if before is None else {'differing': differing}
        print(json.dumps({**report, **compared}, indent=2))
    else:
        show(report, before, differing)
    return ExitCode.VIOLATED if differing else ExitCode.OK


if __name__ == '__main__':
    leave(main)
