"""What the test bench reads out of a drawn scene, and what it says where that is not there."""

from __future__ import annotations

from typing import Any

import numpy as np

EGO_VALUES = {'cross_track': 'cross_track', 'distance': 'distance', 'heading': 'heading_deg'}
"""Key of a scenario, and the property of the plane that holds it."""

_OWN_PARAMETERS = ('verifai', 'externalSampler')
"""Beginnings of the names of parameters that speak to Scenic's samplers, not of the scenario."""


class ProgramError(Exception):
    """The program compiles, but does not say what the test bench needs."""


def of_scenario(params: dict[str, Any]) -> dict[str, Any]:
    """Those of a program's global parameters that describe the scenario."""
    return {
        name: value for name, value in params.items() if not name.startswith(_OWN_PARAMETERS)
    }


def scene_values(scene: Any) -> dict[str, float | str | bool]:
    """Plain values of a Scenic scene, by scenario key, in the units people type.

    Raises:
        ProgramError: no plane, a parameter that is the plane's to say, or a value of another kind.
    """
    ego = scene.egoObject
    if ego is None or not all(hasattr(ego, name) for name in EGO_VALUES.values()):
        raise ProgramError(
            'no plane to start from; write "model runway_world" and "ego = new Plane at (x, y)"'
        )
    values = {key: getattr(ego, name) for key, name in EGO_VALUES.items()}
    for name, value in of_scenario(scene.params).items():
        if name in values:
            raise ProgramError(f'parameter {name!r} belongs to the plane: place the ego there')
        values[name] = value
    return {name: _plain(name, value) for name, value in values.items()}


def _plain(name: str, value: Any) -> float | str | bool:
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, str):
        return str(value)
    if isinstance(value, (int, float, np.integer, np.floating)):
        return float(value)
    raise ProgramError(f'{name} is a {type(value).__name__}; it has to be a number or a word')
