"""The scenarios that a failed run may be shrunk to.

The run's parameters are moved in steps towards nominal, as defined by the shipped program
``nominal``: on the centreline, straight ahead, under a clear dry sky at 10 h (a high sun that casts
the aircraft's shadow beside it, in the hours at which both shipped networks were trained), on a
stretch without rubber and away from the crossing. There are two such stretches; the one on the
run's side of the crossing is used, because otherwise the path to nominal would lead across it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from taxinet_ros.core.mtl import Spec
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    CAMERA_OFFSETS,
    DRAWN_FAULTS,
    FAULT_ONSET,
    FAULT_SEED,
    FAULTS,
    FORM,
    GNSS_BIAS,
    GNSS_DROPOUT,
    GNSS_DROPOUT_START,
    GNSS_NOISE,
    GUST,
    GUST_SEED,
    PUSHING_FIELDS,
    RAIN_CLOUDS,
    SENSORS,
    TRAFFIC,
    WIND_DIRECTION,
    WIND_SPEED,
    by_key,
    is_point,
    split_point,
)
from taxinet_ros.core.traffic.traffic import NOBODY, GroundObject, traffic_of
from taxinet_ros.core.traffic.traffic_file import typed_traffic
from taxinet_ros.core.verdict.judge import check_others, read_objects
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.sampler import split_options
from taxinet_ros.scenes.overrides import WEATHER
from taxinet_ros.trials.shrink.algorithm import Axis, Point

DISTANCES_M = (1000.0, 1800.0)
"""Nominal starts before and beyond the crossing, each within the range of ``nominal.scenic``."""
NOMINAL_HOUR = 10.0
STEPS = {
    'cross_track_m': 0.1, 'distance_m': 10.0, 'heading_deg': 0.5, 'rain_percent': 1.0,
    'time_of_day_h': 0.05, 'wind_speed_mps': 0.5, 'gust_mps': 0.5, 'slope_percent': 0.1,
    'speed_mps': 0.5, 'camera_dropout_percent': 1.0, 'camera_freeze_s': 0.1,
    'lens_dirt_percent': 1.0, 'lens_drops_percent': 1.0, 'glare_ghost_percent': 5.0,
    'exposure_jump_ev': 0.1, 'loop_delay_s': 0.1, 'loop_jitter_s': 0.1, 'steering_bias_deg': 0.1,
    **{field.key: 0.01 if field.unit == 'm' else 0.1 for field in CAMERA_OFFSETS},
    'gnss_noise_m': 0.1, 'gnss_bias_m': 0.1, 'gnss_dropout_s': 0.5,
}
"""Step of each numeric parameter; 0.05 h are 3 min. A limit of the steering rate has none, as the
least severe one is as far from no limit as any."""
_GNSS = (GNSS_NOISE, GNSS_BIAS, GNSS_DROPOUT)
KEYS = (
    'cross_track_m', 'heading_deg', 'distance_m', 'time_of_day_h', 'clouds', 'rain_percent',
    'wind_speed_mps', 'gust_mps', 'runway_state', 'slope_percent', 'speed_mps',
    *(field.key for field in (*FAULTS, *CAMERA_OFFSETS, *_GNSS)), 'traffic', 'shadows', 'crossing',
    'date', 'aircraft',
)
"""Parameters to move to nominal, with their control points; the last four keep the run's values
unless given."""
_FOLLOWERS = {
    WIND_DIRECTION: (WIND_SPEED,), GUST_SEED: (GUST,), FAULT_ONSET: FAULTS,
    FAULT_SEED: DRAWN_FAULTS, GNSS_DROPOUT_START: (GNSS_DROPOUT,),
}
"""Parameters without effect when all of the others are 0; they are set to 0 with them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """One parameter, in human units.

    Attributes:
        key: one of :data:`KEYS`, or a control point of one.
        values: from nominal to the failed run's; a single one if the two are equal.
    """

    key: str
    values: tuple[Any, ...]

    @property
    def axis(self) -> Axis:
        """The parameter as a search axis."""
        return Axis(steps=len(self.values) - 1, scan=split_point(self.key)[0] not in STEPS)


@dataclass(frozen=True, kw_only=True, slots=True)
class ShrinkSpace:
    """The scenarios between nominal and a failed run's.

    Attributes:
        original, nominal: the two ends.
        parameters: all parameters considered, including those already nominal.
    """

    original: Scenario
    nominal: Scenario
    parameters: tuple[Parameter, ...]

    @property
    def moving(self) -> tuple[Parameter, ...]:
        """The parameters that are not nominal: one for each axis of a point."""
        return tuple(one for one in self.parameters if len(one.values) > 1)

    def steps(self, point: Point) -> dict[str, int]:
        """Steps from nominal by key, 0 for parameters that are already nominal."""
        moved = dict(zip((one.key for one in self.moving), point, strict=True))
        return {one.key: moved.get(one.key, 0) for one in self.parameters}

    def scenario(self, point: Point) -> Scenario:
        """The scenario at a point; unmoved parameters are bit-exact."""
        steps = self.steps(point)
        changed = {
            one.key: one.values[steps[one.key]]
            for one in self.moving if steps[one.key] < one.axis.steps
        }
        drawn = self.original.to_human()
        changed |= _followers({**drawn, **changed})
        built = scenario_from_human(_without_level_signals({**drawn, **changed}))
        names = [BY_KEY[key].attribute for key in changed if not is_point(key)]
        return dataclasses.replace(self.original, **{
            name: getattr(built, name) for name in (*names, 'signals')
        })

    def possible(self, point: Point, axis: int) -> Point:
        """``point`` with clouds or rain set to nominal if the sky does not allow the rain.

        Args:
            point: steps away from nominal.
            axis: number of the moved parameter; the other one of the two is set to nominal.
        """
        keys = [one.key for one in self.moving]
        values = {
            key: next(one for one in self.parameters if one.key == key).values[steps]
            for key, steps in self.steps(point).items() if key in WEATHER
        }
        if values['clouds'] in RAIN_CLOUDS or values['rain_percent'] == 0:
            return point
        other = keys.index('clouds' if keys[axis] == 'rain_percent' else 'rain_percent')
        return (*point[:other], 0, *point[other + 1:])


def make_shrink_space(
    original: Scenario, settings: Iterable[str] = (), specs: Sequence[Spec] = ()
) -> ShrinkSpace:
    """The space of a failed run.

    Args:
        original: its scenario.
        settings: ``key=value`` of the nominal scenario, in human units.
        specs: its formulas; objects on the ground that they are about stay.

    Raises:
        UsageError: a setting is invalid, a formula is about objects that the nominal scenario
            lacks, or the run's scenario is already nominal.
    """
    chosen = _chosen(settings)
    drawn = original.to_human()
    usual = {
        'cross_track_m': 0.0, 'heading_deg': 0.0, 'clouds': 'clear', 'rain_percent': 0.0,
        'time_of_day_h': NOMINAL_HOUR,
        'distance_m': _usual_distance_m(original),
    }
    moved = (*PUSHING_FIELDS, *FAULTS, *CAMERA_OFFSETS, *_GNSS)
    pushed = {field.key: field.to_human(field.absent) for field in moved}
    kept = read_objects(specs, original.others)
    pushed[TRAFFIC.key] = _reference(kept)
    pushed |= {name: pushed[key] for key in KEYS for name in _points(key, drawn)}
    keys = [name for key in KEYS for name in (key, *_points(key, drawn))]
    usual |= {key: value for key, value in pushed.items() if key in keys and drawn[key] != value}
    try:
        asked = {**drawn, **usual, **chosen}
        nominal = scenario_from_human(_without_level_signals({**asked, **_followers(asked)}))
        if 'aircraft' in chosen:  # in the run's own wind, as it may be moved first
            scenario_from_human({**drawn, 'aircraft': chosen['aircraft']})
        check_others(specs, nominal)
    except UsageError as error:
        raise UsageError(f'nominal: {str(error).removeprefix("scenario: ")}') from None
    wanted = nominal.to_human()
    wanted = {**{name: wanted[split_point(name)[0]] for name in original.points}, **wanted}
    parameters = tuple(
        Parameter(key=key, values=_values(key, wanted[key], drawn[key], kept))
        for key in keys if key in usual or key in chosen
    )
    space = ShrinkSpace(original=original, nominal=nominal, parameters=parameters)
    if not space.moving:
        raise UsageError('the run is nominal already: there is nothing to shrink; give another')
    return space


def _usual_distance_m(original: Scenario) -> float:
    """The nominal start on the run's side of the crossing; its own where the place has none."""
    drawn: float = original.to_human()['distance_m']
    if not original.line.is_runway:
        return drawn
    runway = original.runway
    crossing_m = runway.crossings[0].x_m if runway.crossings else runway.length_m
    beyond = original.distance_m > crossing_m
    usual = DISTANCES_M[beyond]
    return usual if usual <= runway.last_start_m and (usual > crossing_m) is beyond else drawn


def _chosen(settings: Iterable[str]) -> dict[str, str]:
    values = split_options(settings, 'nominal')
    try:
        chosen = by_key(values)
    except UsageError as error:
        raise UsageError(f'nominal {str(error).removeprefix("scenario: ")}') from None
    for key in chosen:
        if split_point(key)[0] not in KEYS:
            raise UsageError(f'nominal {key}: unknown; known: {", ".join(KEYS)}')
    return chosen


def _followers(values: Mapping[str, Any]) -> dict[str, float]:
    """Parameters that follow others of a scene's values to 0."""
    return {
        name: 0.0 for follower, leaders in _FOLLOWERS.items()
        if not any(
            leader.from_human(values[name]) for leader in leaders
            for name in (leader.key, *_points(leader.key, values))
        )
        # It also seeds the noise of sensors, which stay.
        and not (follower is FAULT_SEED and values[SENSORS.key] != SENSORS.absent)
        for name in (follower.key, *_points(follower.key, values))
    }


def _points(key: str, values: Iterable[str]) -> list[str]:
    """Names of a parameter's control points among those of a scene's values."""
    return [name for name in values if split_point(name)[0] == key != name
            and split_point(name)[1] != FORM]


def _without_level_signals(values: Mapping[str, Any]) -> dict[str, Any]:
    """A scene's values without signals that stay as they are at the start, which are none."""
    level = {
        key for key in {split_point(name)[0] for name in values if is_point(name)}
        if all(BY_KEY[name].from_human(values[name]) == BY_KEY[key].from_human(values[key])
               for name in _points(key, values))
    }
    return {
        name: value for name, value in values.items()
        if not (is_point(name) and split_point(name)[0] in level)
    }


def _values(
    key: str, nominal: Any, original: Any, kept: Collection[GroundObject]
) -> tuple[Any, ...]:
    if nominal == original:
        return (nominal,)
    if key == TRAFFIC.key:
        return _fewer(nominal, original, kept)
    if BY_KEY[key].words:
        return _words(BY_KEY[key].words, nominal, original)
    if (step := STEPS.get(split_point(key)[0])) is None:
        return nominal, original
    step = math.copysign(step, original - nominal)
    # A rounding error must not add a step.
    whole = math.ceil(round(abs(original - nominal) / abs(step), 6))
    return (*(round(nominal + k * step, 9) for k in range(max(whole, 1))), original)


def _fewer(nominal: str, original: str, kept: Collection[GroundObject]) -> tuple[str, ...]:
    """References to those kept and the first others of a scene, from the nominal ones to all."""
    objects = typed_traffic(original).objects
    parts = dict.fromkeys(
        _reference([one for place, one in enumerate(objects) if place < k or one in kept])
        for k in range(len(objects) + 1)
    )
    return nominal, *(part for part in parts if part not in (nominal, NOBODY))


def _reference(objects: Sequence[GroundObject]) -> str:
    return typed_traffic(traffic_of(objects).text).reference


def _words(order: tuple[str, ...], nominal: str, original: str) -> tuple[str, ...]:
    first, last = order.index(nominal), order.index(original)
    step = 1 if last > first else -1
    return tuple(order[place] for place in range(first, last + step, step))
