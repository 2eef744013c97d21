"""What the shrinking of a failed run may change: its scenario's parameters, step by step.

Nominal is what the bench's own program ``nominal`` calls plain taxiing: on the centreline, straight
ahead, under a clear dry sky at 10 h (a high sun that casts the aircraft's shadow beside it, in the
hours at which both shipped networks were trained), on a stretch without rubber and away from the
crossing. There are two such stretches; the one on the run's own side of the crossing is taken, for
otherwise the way to nominal would lead across it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from taxinet_ros.campaign.samplers.option import split_options
from taxinet_ros.campaign.shrink import Axis, Point
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.runway import CROSSING_X_M
from taxinet_ros.core.scenario import (
    AIRCRAFT,
    CLOUDS,
    RAIN_CLOUDS,
    Scenario,
    scenario_from_human,
)

DISTANCES_M = (1000.0, 1800.0)
"""Nominal starts before and beyond the crossing, each within a stretch of ``nominal.scenic``."""

NOMINAL_HOUR = 10.0

STEPS = {'cross_track': 0.1, 'distance': 10.0, 'heading': 0.5, 'rain': 1.0, 'time_of_day': 0.05}
"""Step of each parameter that is a number: m, m, degrees, percent, h (that is 3 min)."""

_FIELDS = {
    'cross_track': 'cross_track_m', 'heading': 'heading_rad', 'distance': 'distance_m',
    'time_of_day': 'time_of_day_s', 'clouds': 'clouds', 'rain': 'rain', 'shadows': 'shadows',
    'crossing': 'crossing', 'date': 'date', 'aircraft': 'aircraft',
}
KEYS = tuple(_FIELDS)
"""What may be taken to nominal; the last four are as in the run unless a person says otherwise."""

_ORDERED: Mapping[str, tuple[str, ...]] = {'clouds': CLOUDS, 'aircraft': AIRCRAFT}


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """One parameter, in human units.

    Attributes:
        key: one of :data:`KEYS`.
        values: from nominal to the failed run's; just one where the two are equal.
    """

    key: str
    values: tuple[Any, ...]

    @property
    def axis(self) -> Axis:
        """The parameter as the search sees it."""
        return Axis(steps=len(self.values) - 1, scan=self.key not in STEPS)


@dataclass(frozen=True, kw_only=True, slots=True)
class ShrinkSpace:
    """The scenarios between nominal and a failed run's.

    Attributes:
        original, nominal: its two ends.
        parameters: all that were looked at, those that are nominal already included.
    """

    original: Scenario
    nominal: Scenario
    parameters: tuple[Parameter, ...]

    @property
    def moving(self) -> tuple[Parameter, ...]:
        """The parameters that are not nominal: one for each axis of a point."""
        return tuple(one for one in self.parameters if len(one.values) > 1)

    def steps(self, point: Point) -> dict[str, int]:
        """Steps away from nominal by key, 0 for what is nominal already."""
        moved = dict(zip((one.key for one in self.moving), point, strict=True))
        return {one.key: moved.get(one.key, 0) for one in self.parameters}

    def scenario(self, point: Point) -> Scenario:
        """The scenario at a point. What is not moved is the original's to the last bit."""
        steps = self.steps(point)
        changed = {
            one.key: one.values[steps[one.key]]
            for one in self.moving if steps[one.key] < one.axis.steps
        }
        built = scenario_from_human({**self.original.to_human(), **changed})
        fields = {_FIELDS[key]: getattr(built, _FIELDS[key]) for key in changed}
        return dataclasses.replace(self.original, **fields)

    def possible(self, point: Point, axis: int) -> Point:
        """``point``, or where its sky has no rain for it, clouds or rain taken to nominal.

        Args:
            point: steps away from nominal.
            axis: number of the parameter that was moved; the other one of the two gives way.
        """
        keys = [one.key for one in self.moving]
        values = {
            key: next(one for one in self.parameters if one.key == key).values[steps]
            for key, steps in self.steps(point).items() if key in ('clouds', 'rain')
        }
        if values['clouds'] in RAIN_CLOUDS or values['rain'] == 0:
            return point
        other = keys.index('clouds' if keys[axis] == 'rain' else 'rain')
        return (*point[:other], 0, *point[other + 1:])


def make_space(original: Scenario, settings: Iterable[str] = ()) -> ShrinkSpace:
    """The space of a failed run.

    Args:
        original: its scenario.
        settings: ``key=value`` of the nominal scenario, in human units.

    Raises:
        UsageError: a setting is wrong, or the run's scenario is nominal already.
    """
    chosen = _chosen(settings)
    drawn = original.to_human()
    beyond = original.distance_m > CROSSING_X_M
    usual = {
        'cross_track': 0.0, 'heading': 0.0, 'clouds': 'clear', 'rain': 0.0,
        'time_of_day': NOMINAL_HOUR, 'distance': DISTANCES_M[beyond],
    }
    try:
        nominal = scenario_from_human({**drawn, **usual, **chosen})
    except UsageError as error:
        raise UsageError(f'--nominal: {str(error).removeprefix("scenario: ")}') from None
    wanted = nominal.to_human()
    parameters = tuple(
        Parameter(key=key, values=_values(key, wanted[key], drawn[key]))
        for key in KEYS if key in usual or key in chosen
    )
    space = ShrinkSpace(original=original, nominal=nominal, parameters=parameters)
    if not space.moving:
        raise UsageError('the run is nominal already: there is nothing to shrink; see --nominal')
    return space


def _chosen(settings: Iterable[str]) -> dict[str, str]:
    try:
        chosen = split_options(settings)
    except UsageError as error:
        text = str(error).removeprefix('sampler option ')
        raise UsageError(f'--nominal {text}') from None
    for key in chosen:
        if key not in KEYS:
            raise UsageError(f'--nominal {key}: unknown; known: {", ".join(KEYS)}')
    return chosen


def _values(key: str, nominal: Any, original: Any) -> tuple[Any, ...]:
    if nominal == original:
        return (nominal,)
    if key in _ORDERED:
        return _words(_ORDERED[key], nominal, original)
    if key not in STEPS:
        return nominal, original
    step = math.copysign(STEPS[key], original - nominal)
    # A whole number of steps must not come out one more for a rounding error.
    whole = math.ceil(round(abs(original - nominal) / abs(step), 6))
    return (*(round(nominal + k * step, 9) for k in range(max(whole, 1))), original)


def _words(order: tuple[str, ...], nominal: str, original: str) -> tuple[str, ...]:
    first, last = order.index(nominal), order.index(original)
    step = 1 if last > first else -1
    return tuple(order[place] for place in range(first, last + step, step))
