"""The whole closed loop in one process, without ROS: 30 s runs, on the truth and on the network."""

from __future__ import annotations

from taxinet_ros.bench.measure import Subject
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.perception import Perception, make_perception
from taxinet_ros.core.scenario import Scenario

SCENARIO = Scenario(cross_track_m=3.0, time_of_day_s=15 * 3600.0)
"""The run that is measured, here and through the graph."""

SPEC = SHIPPED['phi_eventually']
"""What judges it."""


def subjects() -> list[Subject]:
    """A run without pictures, and one in which the network looks at each.

    Raises:
        UsageError: the shipped weights cannot be used.
    """
    return [
        _loop('truth', make_perception('truth'), most=10),
        _loop('network', make_perception('taxinet'), most=3),
    ]


def _loop(name: str, perception: Perception, most: int) -> Subject:
    def drive() -> None:
        run_closed_loop(SCENARIO, perception, specs=[SPEC])

    return Subject(
        name=f'loop/{name}', run=drive, warm_ups=1, most=most, simulated_s=SCENARIO.duration_s
    )
