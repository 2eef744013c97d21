"""What ``taxinet bench`` measures without ROS: camera frames with their stages, and whole runs."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from taxinet_ros.bench.measure import Subject
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.types import NS_PER_S, AircraftState

SCENARIO = Scenario(cross_track_m=3.0, time_of_day_s=15 * 3600.0)
"""Scenario of the measured run, here and through the graph."""
SPEC = SHIPPED['phi_eventually']
"""Formula that judges it."""
PERCEPTIONS = {'network': 'taxinet', 'truth': 'truth'}
"""Perception of a run, by its word in a figure's name."""


def loop_subjects() -> list[Subject]:
    """A run of each perception.

    Raises:
        UsageError: the shipped weights cannot be used.
    """
    return [
        Subject(
            name=f'loop/{name}', run=partial(_drive, make_perception(word)), warm_ups=1,
            most=3 if name == 'network' else 10, simulated_s=SCENARIO.duration_s,
        )
        for name, word in PERCEPTIONS.items()
    ]


def _drive(perception: Perception) -> None:
    run_closed_loop(SCENARIO, perception, specs=[SPEC])


@dataclass(frozen=True, kw_only=True, slots=True)
class Scene:
    """A scenario and a state of the aircraft in it."""

    scenario: Scenario
    state: AircraftState


def _scene(
    *,
    x_m: float,
    y_m: float,
    heading_deg: float,
    pitch_deg: float = 0.11,
    roll_deg: float = 0.0,
    **values: object,
) -> Scene:
    state = AircraftState(
        x_m=x_m, y_m=y_m, z_m=1.55, roll_rad=math.radians(roll_deg),
        pitch_rad=math.radians(pitch_deg), yaw_rad=math.radians(heading_deg), speed_mps=5.0,
        yaw_rate_radps=0.0,
    )  # fmt: skip
    return Scene(scenario=scenario_from_human(values), state=state)

SCENES = {
    'noon': _scene(x_m=1000.0, y_m=1.5, heading_deg=4.0, time_of_day_h=12.0),
    'own-shadow': _scene(x_m=700.0, y_m=-2.0, heading_deg=0.0, time_of_day_h=15.5),
    'low-sun': _scene(x_m=300.0, y_m=2.0, heading_deg=12.0, time_of_day_h=7.2),
    'rain': _scene(x_m=450.0, y_m=3.0, heading_deg=-8.0, clouds='stratus', rain_percent=60.0),
    'stratus': _scene(x_m=1100.0, y_m=0.0, heading_deg=10.0, clouds='stratus'),
    'nose-up': _scene(
        x_m=1600.0, y_m=5.0, heading_deg=-15.0, pitch_deg=-5.0, roll_deg=-2.0, clouds='broken',
    ),
    'wide-angle': _scene(x_m=1000.0, y_m=1.5, heading_deg=4.0, time_of_day_h=12.0, camera='nose'),
    'slanted': _scene(
        x_m=1420.0, y_m=-6.0, heading_deg=22.0, pitch_deg=1.2, roll_deg=2.5, clouds='cirrus',
    ),
    'taxiway': _scene(x_m=960.0, y_m=50.0, heading_deg=70.0, track='exit_left'),
    'dirty-lens': _scene(
        x_m=300.0, y_m=2.0, heading_deg=12.0, time_of_day_h=7.2, lens_dirt_percent=20.0,
    ),
    'lens-faults': _scene(
        x_m=300.0, y_m=2.0, heading_deg=12.0, time_of_day_h=7.2, lens_dirt_percent=20.0,
        lens_drops_percent=20.0, glare_ghost_percent=100.0, exposure_jump_ev=1.0,
    ),
    'traffic': _scene(
        x_m=400.0, y_m=0.0, heading_deg=0.0, time_of_day_h=10.0, traffic=load_traffic([
            {'kind': 'aircraft', 'x_m': 440, 'y_m': -20, 'heading_deg': 70},
            {'kind': 'vehicle', 'x_m': 425, 'y_m': -30, 'heading_deg': 90,
             'path': [{'x_m': 425, 'y_m': 30, 'speed_mps': 5}]},
            {'kind': 'cone', 'x_m': 412, 'y_m': -4}, {'kind': 'person', 'x_m': 415, 'y_m': 3},
            {'kind': 'closed_marking', 'x_m': 450, 'y_m': 0},
        ]),
    ),
}  # fmt: skip
"""Scenes by name."""


SUM = 'sum of stages'


def camera_subjects() -> list[Subject]:
    """Whole frames and their stages."""
    return [subject for name, scene in SCENES.items() for subject in _frame(name, scene)]


def _frame(name: str, scene: Scene) -> list[Subject]:
    """Subjects for a whole frame, and for the stages of another one.

    In a run one camera works continuously; here cameras take turns. So each renders an unmeasured
    frame before its turn, which puts its buffers back into the caches.
    """
    camera = Camera(scene.scenario)
    stamp_ns = 0

    def photograph() -> None:
        nonlocal stamp_ns
        stamp_ns += NS_PER_S // 10
        camera.render(scene.state, stamp_ns)

    def stages() -> Mapping[str, int]:
        times: dict[str, int] = {}
        last = time.perf_counter_ns()

        def mark(stage: str) -> None:
            nonlocal last
            now = time.perf_counter_ns()
            times[stage] = now - last
            last = now

        camera.render(scene.state, stamp_ns, mark)
        return {**times, SUM: sum(times.values())}

    whole = f'camera/{name}'
    return [
        Subject(name=whole, run=photograph, before=photograph),
        Subject(name=whole, run=stages, before=photograph),
    ]
