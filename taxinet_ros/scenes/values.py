"""Read scenario values from a drawn scene, with errors for missing or invalid ones.

Of this package it imports little, as the Scenic child does, which a command waits for.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from taxinet_ros.scenes.programs import MODEL

if TYPE_CHECKING:
    from taxinet_ros.core.place.track import Track

OVERRIDES = 'overrides'
"""The parameter of a program that overrides its values; said again, it adds to the earlier."""

PLANE_KEYS = ('cross_track_m', 'distance_m', 'heading_deg')
"""Keys of the scenario that the place of the aircraft says, and properties of its class."""
SHORT_PLANE_KEYS = {'cross_track': 'cross_track_m', 'distance': 'distance_m'}
"""The other names that such properties may have."""
TRAFFIC_KEY = 'traffic'

REJECTION_FEEDBACK = 'externalSamplerRejectionFeedback'
"""Scenic's global parameter: what a sampler is told of a scene that the requirements reject."""
SAMPLER_PARAMETERS = (
    'verifaiSamplerType', 'verifaiSamplerParams', 'externalSampler', REJECTION_FEEDBACK,
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
    """Plain values of a Scenic scene, by the names of its parameters and keys of the scenario.

    Position and heading are those of the aircraft in the scene, after ``mutate``.

    Raises:
        ProgramError: no plane, one that is not on the runway, or a value of the wrong type.
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
    values |= scenario_parameters(scene.params)
    if others := [one for one in scene.objects if is_ground_object(one)]:
        values[TRAFFIC_KEY] = objects_document(others)
    return {name: plain_value(name, value) for name, value in values.items()}


_AHEAD = 'ahead_m'

KIND, COLOUR, UNTIL = 'kind', 'colour', 'until_s'
"""Properties of the world model's ground objects, besides Scenic's own."""

REACTIONS = ('stands_within', 'starts_within')
"""Arguments that say from which distance of the aircraft on an object stands, or starts."""
BEHAVIORS = {
    'FollowPath': ('path', 'speed', 'delay', 'wait', *REACTIONS),
    'GoStraight': ('speed', 'distance', 'delay', *REACTIONS),
    'CrossRunway': ('speed', 'delay', *REACTIONS),
}
"""Arguments of the world model's behaviors, which Scenic has checked."""


def is_ground_object(thing: Any) -> bool:
    """Whether an object is one of the world model's that stand or lie on the ground."""
    return hasattr(thing, KIND) and hasattr(thing, COLOUR)


_ALONG = 'objects_along_track'
"""Key of ground objects as a program places them."""


def objects_document(things: Iterable[Any]) -> str:
    """The ground objects of a scene as JSON; :func:`placed_objects` makes a key ``traffic`` of it.

    Their x_m and y_m are along the track and left of it, and the heading is from its direction,
    as a program means them: which track the scene has, the command line may say later.

    Raises:
        ProgramError: one is not on the ground, or moves in another way than there is.
    """
    return json.dumps({_ALONG: [_ground_object(one) for one in things]})


def placed_objects(traffic: str, line: Track) -> str:
    """The key ``traffic`` of a scene that follows a line, its objects in ``map``.

    Any text but that of :func:`objects_document` is returned as it is.
    """
    if not traffic.startswith(f'{{"{_ALONG}"'):
        return traffic
    return json.dumps({'objects': [_placed(one, line) for one in json.loads(traffic)[_ALONG]]})


def _placed(values: dict[str, Any], line: Track) -> dict[str, Any]:
    from taxinet_ros.core.traffic.traffic import KINDS

    kind = KINDS.get(values['kind'])
    if kind is None or not kind.solid:  # what lies flat has no height
        values = {key: value for key, value in values.items() if key != 'height_m'}
    heading_deg = values['heading_deg']
    x_m, y_m, yaw_rad = line.pose(values['x_m'], values['y_m'], math.radians(heading_deg))
    placed = {**values, 'x_m': x_m, 'y_m': y_m}
    if not line.is_runway:
        placed['heading_deg'] = math.degrees(yaw_rad)
    if 'path' in values:
        placed['path'] = legs = []
        for leg in values['path']:
            if _AHEAD in leg:
                far_m = leg[_AHEAD]
                end = x_m + far_m * math.cos(yaw_rad), y_m + far_m * math.sin(yaw_rad)
            else:
                end = line.pose(leg['x_m'], leg['y_m'])[:2]
            rest = {key: one for key, one in leg.items() if key not in (_AHEAD, 'x_m', 'y_m')}
            legs.append({'x_m': end[0], 'y_m': end[1], **rest})
    return placed


def _ground_object(thing: Any) -> dict[str, Any]:
    check_level(thing)
    kind = plain_value(KIND, getattr(thing, KIND))
    values: dict[str, Any] = {
        'kind': kind, **_map_place(thing.position),
        'heading_deg': math.degrees(thing.heading),
        'length_m': float(thing.length), 'width_m': float(thing.width),
        'height_m': float(thing.height),
    }
    if colour := plain_value(COLOUR, getattr(thing, COLOUR)):
        values['colour'] = colour
    if (until := getattr(thing, UNTIL, None)) is not None:
        values[UNTIL] = plain_value(UNTIL, until)
    if thing.behavior is not None:
        values |= _motion(thing, behavior_arguments(thing.behavior))
    return values


def behavior_arguments(behavior: Any) -> dict[str, Any]:
    """The arguments of one of the world model's behaviors, by name.

    Raises:
        ProgramError: it is another behavior.
    """
    name = type(behavior).__name__
    if name not in BEHAVIORS or type(behavior).__module__ != MODEL:
        raise ProgramError(
            f'behavior {name} has no effect here: objects move by {", ".join(BEHAVIORS)} of '
            f'{MODEL}, the aircraft by its controller'
        )
    given = zip(BEHAVIORS[name], behavior._args, strict=False)
    return {'delay': 0.0, 'wait': 0.0, **dict(given), **behavior._kwargs}


def _motion(thing: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    speed = plain_value('speed', given['speed'])
    wait = plain_value('wait', given['wait'])
    points: list[dict[str, Any]]
    if 'path' in given:
        points = [_map_place(point) for point in _points(given['path'])]
    elif 'distance' in given:
        # Straight ahead also where the track bends.
        points = [{_AHEAD: plain_value('distance', given['distance'])}]
    else:
        points = [_map_place((0 - thing.position.x, thing.position.y))]
    legs = [{**point, 'speed_mps': speed} | ({'wait_s': wait} if wait else {}) for point in points]
    return {'wait_s': plain_value('delay', given['delay']), 'path': legs} | {
        f'{name}_m': plain_value(name, given[name])
        for name in REACTIONS if given.get(name) is not None
    }


def _points(path: Any) -> list[Any]:
    if not isinstance(path, (list, tuple)) or not path:
        raise ProgramError('path: expected a list of points, such as [(10, 500), (-10, 500)]')
    return [getattr(point, 'position', point) for point in path]


def _map_place(point: Any) -> dict[str, float]:
    """A Scenic point (x to the right, y ahead) along the track and left of it."""
    try:
        right, ahead = (float(point[axis]) for axis in (0, 1))
    except (TypeError, ValueError, IndexError, KeyError):
        raise ProgramError(f'path: {point!r:.60} is no point (x, y)') from None
    return {'x_m': ahead, 'y_m': 0 - right}


def plane_property(plane: Any, key: str) -> Any:
    """An aircraft's property for a key, or that of its short form; None if it has neither."""
    short = next((short for short, long in SHORT_PLANE_KEYS.items() if long == key), key)
    return getattr(plane, key, getattr(plane, short, None))


def check_level(plane: Any, place: Place | None = None) -> None:
    """Check that an aircraft, or another object, is level on the ground, as in every run.

    Raises:
        ProgramError: it is above or below, or tilted.
    """
    stands = 'it stands on the ground' if is_ground_object(plane) else (
        'the aircraft stands on its wheels'
    )
    # "on REGION" places an object's underside there, so its centre is above.
    at_rest = (0.0, plane.contactTolerance / 2 - plane.baseOffset.z)
    if min(abs(plane.position.z - height) for height in at_rest) > _LEVEL:
        raise ProgramError(
            f'an altitude of {plane.position.z:g} m has no effect here: {stands}; leave it out',
            place,
        )
    for name in ('pitch', 'roll'):
        degrees = math.degrees(getattr(plane.orientation, name))
        if abs(degrees) > _LEVEL:
            raise ProgramError(
                f'a {name} of {degrees:g} deg has no effect here: {stands}; leave it out', place,
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
