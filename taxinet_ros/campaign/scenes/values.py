"""What the test bench reads out of a drawn scene, and what it says where that is not there."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from taxinet_ros.core.scenario_fields import PLANE_KEYS, by_key, other_form

SAMPLER_PARAMETERS = (
    'verifaiSamplerType', 'verifaiSamplerParams', 'externalSampler',
    'externalSamplerRejectionFeedback',
)
"""Global parameters that speak to samplers, and not of the scenario."""

_LEVEL = 1e-6
"""What counts as level [m, deg]: Scenic's own arithmetic is off by less."""

Place = tuple[str, int]
"""A file and a line of it, from 1."""


class ProgramError(Exception):
    """The program compiles, but does not say what the test bench needs.

    Attributes:
        filename, lineno: where it says so, as a syntax error has them; None where that is unknown.
    """

    def __init__(self, message: str, place: Place | None = None) -> None:
        super().__init__(message)
        self.filename: str | None = None
        self.lineno: int | None = None
        if place is not None:
            self.filename, self.lineno = place


def scenario_parameters(params: dict[str, Any]) -> dict[str, Any]:
    """Those of a program's global parameters that describe the scenario."""
    return {name: value for name, value in params.items() if name not in SAMPLER_PARAMETERS}


def scene_values(scene: Any) -> dict[str, float | str | bool]:
    """Plain values of a Scenic scene, by scenario key, in the units people type.

    Place and heading are those of the aircraft as it stands in the scene, after ``mutate``.

    Raises:
        ProgramError: no plane, one that does not stand on the runway, a parameter that is the
            plane's to say, or a value of another kind.
    """
    ego = scene.egoObject
    if ego is None or any(plane_property(ego, key) is None for key in PLANE_KEYS):
        raise ProgramError(
            'no plane to start from; write "model runway_world" and "ego = new Plane at (x, y)"'
        )
    check_level(ego)
    values = {
        'cross_track_m': 0 - ego.position.x,  # -x would turn a zero into a minus zero
        'distance_m': ego.position.y,
        'heading_deg': math.degrees(ego.heading),
    }
    for key in PLANE_KEYS:
        said = plane_property(ego, key)
        if not math.isclose(said, values[key], abs_tol=1e-6):
            raise ProgramError(
                f'{key} is {said:g}, but where the aircraft stands it is '
                f'{values[key]:g}; only its place can say'
            )
    for name, value in by_key(scenario_parameters(scene.params)).items():
        if name in values:
            raise ProgramError(f'parameter {name!r} belongs to the plane: place the ego there')
        values[name] = value
    return {name: plain_value(name, value) for name, value in values.items()}


def plane_property(plane: Any, key: str) -> Any:
    """What an aircraft says of a key; None where it has no such property.

    World models of before the keys had units know short forms only.
    """
    return getattr(plane, key, getattr(plane, other_form(key), None))


def check_level(plane: Any, place: Place | None = None) -> None:
    """See that an aircraft stands on the runway, as every run begins.

    Raises:
        ProgramError: it is above or below, or leans.
    """
    # "on REGION" puts the lower side of an object there, so its middle is above.
    at_rest = (0.0, plane.contactTolerance / 2 - plane.baseOffset.z)
    if min(abs(plane.position.z - height) for height in at_rest) > _LEVEL:
        raise ProgramError(
            f'an altitude of {plane.position.z:g} m has no effect here: the aircraft stands on its '
            'wheels; leave it out', place,
        )
    for name in ('pitch', 'roll'):
        degrees = math.degrees(getattr(plane.orientation, name))
        if abs(degrees) > _LEVEL:
            raise ProgramError(
                f'a {name} of {degrees:g} deg has no effect here: the aircraft stands on its '
                'wheels; leave it out', place,
            )


def plain_value(name: str, value: Any, place: Place | None = None) -> float | str | bool:
    """A value that Scenic drew as a number, a word or a switch.

    Raises:
        ProgramError: it is none of these.
    """
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, str):
        return str(value)
    if isinstance(value, (int, float, np.integer, np.floating)):
        return float(value)
    hint = ''
    if isinstance(value, (tuple, list)) and len(value) == 2:
        hint = f'; for a number between two write Range({value[0]}, {value[1]})'
    raise ProgramError(
        f'{name} is a {type(value).__name__}; it has to be a number or a word{hint}', place
    )
