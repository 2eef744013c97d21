"""The flight-dynamics model: one control step, and an aircraft set on the runway."""

from __future__ import annotations

from taxinet_ros.bench.measure import Subject
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS, Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NS_PER_S, TaxiCommand

_STEPS = 20


def subjects() -> list[Subject]:
    """Twelve physics steps make one control step."""
    aircraft = Aircraft(Scenario())
    command = TaxiCommand(steering_rad=0.0, speed_mps=5.0)

    def advance() -> None:
        for _ in range(_STEPS):
            aircraft.advance(command)

    def make() -> None:
        Aircraft(Scenario())

    return [
        Subject(
            name='physics/control step', run=advance, calls=_STEPS,
            simulated_s=CONTROL_PERIOD_NS / NS_PER_S,
        ),
        Subject(name='physics/new', run=make, most=20),
    ]  # fmt: skip
