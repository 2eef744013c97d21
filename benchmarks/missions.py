"""What others on the ground, hold lines and sensors cost in a step of the loop with the network.

Runs of 15 s in turns; processor time, so that other load matters little.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from statistics import median
from typing import Any

from common import Progress, leave, make_table, options, run_study

from rich.console import Console

from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.sensors import load_sensors
from taxinet_ros.core.traffic.traffic_file import load_traffic

SPEC = parse_spec('eventually[0:10](always(abs(cte) <= 1.5))')
LOOKED_AT = 'second camera at 5 Hz, looked at'


def _vans(*reacting: dict[str, float]) -> str:
    return load_traffic([
        {'kind': 'vehicle', 'x_m': x_m, 'y_m': -30, 'heading_deg': 90,
         'path': [{'x_m': x_m, 'y_m': 30, 'speed_mps': 3}], **keys}
        for x_m, keys in zip((430, 460, 500), reacting, strict=True)
    ])


def scenes() -> dict[str, Scenario]:
    """The scenes by what they have; the first has nothing."""
    camera = load_sensors({'camera': {'mount': 'nose', 'rate_hz': 5}})
    stands = {'stands_within_m': 30.0}
    changes: dict[str, dict[str, Any]] = {
        'nothing': {},
        'three vans': {'traffic': _vans({}, {}, {})},
        'three vans that react': {'traffic': _vans(stands, stands, {'starts_within_m': 60.0})},
        'a hold line': {'traffic': load_traffic([
            {'kind': 'hold_line', 'x_m': 480, 'y_m': 0, 'until_s': 9}])},
        'gnss 5 Hz, imu 100 Hz, wheel 20 Hz': {'sensors': 'standard'},
        'second camera at 5 Hz, not looked at': {'sensors': camera},
        LOOKED_AT: {'sensors': camera},
        'control rate 30 Hz': {'control_rate_hz': 30},
    }
    return {
        name: scenario_from_human({'duration_s': 15, 'cross_track_m': 2, **values})
        for name, values in changes.items()
    }


def step_ms(scene: Scenario, network: Perception, look: bool) -> float:
    """Processor time of a step [ms], the start of the run included."""
    steps = 0

    def seen(step: Step) -> None:
        nonlocal steps
        steps += 1
        if look and step.observation.measured is not None:
            for picture in step.observation.measured.camera:
                picture.image  # noqa: B018 (it is rendered when it is looked at)

    began_s = time.process_time()
    run_closed_loop(scene, network, specs=[SPEC], on_step=seen)
    return 1e3 * (time.process_time() - began_s) / steps


def measure(repeats: int, progress: Progress) -> dict[str, Any]:
    """Least and median time of a step of each scene [ms], and how much more than with nothing."""
    network, found = make_perception('taxinet'), scenes()
    times: dict[str, list[float]] = {name: [] for name in found}
    for number in range(repeats + 1):
        for name, scene in found.items():
            taken_ms = step_ms(scene, network, name == LOOKED_AT)
            if number:  # the first of each is cold
                times[name].append(taken_ms)
        progress(number + 1, repeats + 1)
    usual = min(times['nothing'])
    return {
        name: {'least_ms': min(values), 'median_ms': median(values), 'more_ms': min(values) - usual}
        for name, values in times.items()
    }


def show(figures: dict[str, Any], console: Console) -> None:
    """Print the figures."""
    table = make_table(['scene'], ['least [ms]', 'median [ms]', 'more [ms]'])
    for name, values in figures.items():
        table.add_row(name, *(f'{value:.2f}' for value in values.values()))
    console.print(table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    asked = options(__doc__, repeats=7).parse_args(arguments)
    return run_study(partial(measure, asked.repeats), show, as_json=asked.json)


if __name__ == '__main__':
    leave(main)
