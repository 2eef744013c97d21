"""The fixed scenes that are measured: what costs most in a picture, one at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.types import AircraftState


@dataclass(frozen=True, kw_only=True, slots=True)
class Scene:
    """A scenario and a moment in it."""

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
    'noon': _scene(x_m=1000.0, y_m=1.5, heading_deg=4.0, time_of_day=12.0),
    'own-shadow': _scene(x_m=700.0, y_m=-2.0, heading_deg=0.0, time_of_day=15.5),
    'low-sun': _scene(x_m=300.0, y_m=2.0, heading_deg=12.0, time_of_day=7.2),
    'rain': _scene(x_m=450.0, y_m=3.0, heading_deg=-8.0, clouds='stratus', rain=60.0),
    'stratus': _scene(x_m=1100.0, y_m=0.0, heading_deg=10.0, clouds='stratus'),
    'nose-up': _scene(
        x_m=1600.0, y_m=5.0, heading_deg=-15.0, pitch_deg=-5.0, roll_deg=-2.0, clouds='broken',
    ),
    'slanted': _scene(
        x_m=1420.0, y_m=-6.0, heading_deg=22.0, pitch_deg=1.2, roll_deg=2.5, clouds='cirrus',
    ),
}  # fmt: skip
"""Scenes by name."""
