"""Read scenario values from a drawn scene, with errors for missing or invalid ones."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from taxinet_ros.core.scenario_fields import PLANE_KEYS, by_key, other_form

SAMPLER_PARAMETERS = (
    'verifaiSamplerType', 'verifaiSamplerParams', 'externalSampler',
    'externalSamplerRejectionFeedback',
)
"""Global parameters that configure samplers, not the scenario."""

_LEVEL = 1e-6
"""Tolerance for a level aircraft [m, deg]; Scenic's rounding errors are smaller."""

Place = tuple[str, int]
"""A file and a line number from 1."""


class ProgramError(Exception):
    """The program compiles, but does not provide what the test bench needs.

    Attributes:
        filename, lineno: place of the error, as in a SyntaxError; None if unknown.
    """

    def __init__(self, message: str, place: Place | None = None) -> None:
        super().__init__(message)
        self.filename: str | None = None
        self.lineno: int | None = None
        if place is not None:
            self.filename, self.lineno = place


def scenario_parameters(params: dict[str, Any]) -> dict[str, Any]:
    """The global parameters of a program that describe the scenario."""
    return {name: value for name, value in params.items() if name not in SAMPLER_PARAMETERS}


def scene_values(scene: Any) -> dict[str, float | str | bool]:
    """Plain values of a Scenic scene by scenario key, in human units.

    Position and heading are those of the aircraft in the scene, after ``mutate``.

    Raises:
        ProgramError: no plane, one that is not on the runway, a parameter that must be a property
            of the plane, or a value of the wrong type.
    """
    ego = scene.egoObject
    if ego is None or any(plane_property(ego, key) is None for key in PLANE_KEYS):
        raise ProgramError(
            'no plane to start from; write "model runway_world" and "ego = new Plane at (x, y)"'
        )
    check_level(ego)
    values = {
        'cross_track_m': 0 - ego.position.x,  # -x would turn 0 into -0
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
    """An aircraft's property for a key; None if it has none.

    World models older than the keys with units have short forms only.
    """
    return getattr(plane, key, getattr(plane, other_form(key), None))


def check_level(plane: Any, place: Place | None = None) -> None:
    """Check that an aircraft is level on the runway, as at the start of every run.

    Raises:
        ProgramError: it is above or below, or tilted.
    """
    # "on REGION" places an object's underside there, so its centre is above.
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
    """Convert a value drawn by Scenic to a number, a word or a switch.

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
