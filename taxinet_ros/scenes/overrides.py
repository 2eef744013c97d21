"""Overrides of the values that a program draws: ``--set``, and a program's ``param overrides``.

They are applied after the draw instead of in Scenic, where an overridden parameter escapes the
joint prior and gives rain from a clear sky. Here every scene is validated as a scenario. Both have
the same effect, so a program that is written for the runs of a campaign has the campaign's as its
own.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.core.control_step import is_whole, last_step
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import (
    AIRCRAFT_MODEL,
    BY_KEY,
    CAMERA,
    CAMERA_OFFSETS,
    CATALOGUES,
    CONTROL_RATE,
    CONTROL_RATES_HZ,
    DISTANCE,
    DRAWN_FAULTS,
    DURATION,
    FAULT_ONSET,
    FAULT_SEED,
    FAULTS,
    FORM,
    GNSS_DROPOUT,
    GNSS_DROPOUT_START,
    GUST,
    GUST_SEED,
    HEADING,
    LENS_DIRT,
    PLACE,
    RAIN,
    RAIN_CLOUDS,
    SENSORS,
    SKY,
    TIME_OF_DAY,
    TRACK,
    TRAFFIC,
    WIND_DIRECTION,
    WIND_SPEED,
    by_key,
    full_key,
    is_point,
    split_point,
)
from taxinet_ros.core.sensors import find_sensors
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.values import OVERRIDES

WEATHER = (SKY.key, RAIN.key)
"""The two interdependent weather keys: rain falls from rain clouds only."""

NEEDS = {
    WIND_DIRECTION.key: {WIND_SPEED.key}, GUST_SEED.key: {GUST.key},
    FAULT_ONSET.key: {field.key for field in FAULTS},
    FAULT_SEED.key: {SENSORS.key, *(field.key for field in DRAWN_FAULTS)},
    GNSS_DROPOUT_START.key: {GNSS_DROPOUT.key},
}
"""Values that have an effect only where one of others is not 0."""
_ALLOWING = {
    SKY.key: RAIN_CLOUDS[0], WIND_SPEED.key: 0.01, GUST.key: 0.01, LENS_DIRT.key: 1.0,
    DURATION.key: DURATION.high, DISTANCE.key: 0.0,
}
"""Values that are compatible with every value of the other keys."""
_ALLOWING_GNSS = {SENSORS.key: 'standard', GNSS_DROPOUT.key: 1.0}
"""The same, but for those of ``sensors`` itself."""
_RIG = (AIRCRAFT_MODEL.key, CAMERA.key)
_DOUBTED = (RAIN.key, TIME_OF_DAY.key, HEADING.key)
_RIGHT_ANGLE_RAD = 1.58


class Contradiction(UsageError):  # noqa: N818 (is a usage error)
    """An override, or an offset of the camera, contradicts another value of the program."""


def check_overrides(overrides: Mapping[str, str]) -> None:
    """Check that each override is a known key with a possible value.

    Raises:
        UsageError: unknown key, bad value, one key in both forms, or rain that contradicts the
            clouds.
    """
    overrides = by_key(overrides)
    # Without a place, which a program may set, any track may be one of it.
    place = _place(overrides) if PLACE.key in overrides else {}
    for key, value in overrides.items():
        try:
            if key in _RIG:  # one fits the other, which a program may set
                BY_KEY[key].from_human(value)
            else:
                check_value(key, value, {key: value} if key == PLACE.key else place)
        except UsageError as error:
            raise _headed(error, f'override {key}={value!s:.60}') from error
    if all(key in overrides for key in WEATHER):
        given = ' '.join(f'{key}={overrides[key]}' for key in WEATHER)
        _build(overrides, f'override {given}')


def overrides_statement(overrides: Mapping[str, Any]) -> str:
    """The statement by which a program has overrides of its own; '' for none.

    Args:
        overrides: by key, documents as names, references or in full.

    Raises:
        UsageError: a document is known by its digest only.
    """
    values = {
        key: CATALOGUES[key].typed(str(value)).text if key in CATALOGUES else value
        for key, value in by_key(overrides).items()
    }
    lines = [f'    {key!r}: {value!r},' for key, value in values.items()]
    return '\n'.join([f'param {OVERRIDES} = {{', *lines, '}', '']) if values else ''


def scenes_words(program: str, overrides: Mapping[str, Any]) -> str:
    """Display text of the scenes of a program, with what ``--set`` said of them."""
    said = ', '.join(f'{key}={_short(key, value)}' for key, value in overrides.items())
    return f'{program} with {said}' if said else program


def _short(key: str, value: Any) -> str:
    if isinstance(value, bool):
        return 'on' if value else 'off'
    catalogue = CATALOGUES.get(key)
    if catalogue is None or catalogue.is_reference(str(value)):
        return str(value)
    return str(catalogue.typed(str(value)).reference)


def doubtful_values(overrides: Mapping[str, str]) -> list[str]:
    """Warnings about override values that are possible but look like another unit.

    Args:
        overrides: by key, checked by :func:`check_overrides`.

    Returns:
        One line per value.
    """
    numbers = {key: float(overrides[key]) for key in _DOUBTED if key in overrides}
    found = []
    rain, hours, heading = (numbers.get(key, 0.0) for key in _DOUBTED)
    if 0 < rain < 1:
        found.append(
            f'{RAIN.key}={rain:g} is {rain:g} %, too little to see; for half write {RAIN.key}=50'
        )
    if 0 < hours < 1:
        found.append(
            f'{TIME_OF_DAY.key}={hours:g} is {60 * hours:.0f} minutes past midnight; hours go to 24'
        )
    # Two or more decimals below pi/2: degrees are rarely given that finely.
    if 0.05 < abs(heading) < _RIGHT_ANGLE_RAD and round(heading, 1) != heading:
        found.append(
            f'{HEADING.key}={heading:g} is {heading:g} degrees; {heading:g} rad would be '
            f'{HEADING.key}={math.degrees(heading):.1f}'
        )
    return found


def apply_overrides(drawn: Mapping[str, Any], overrides: Mapping[str, str], where: str) -> Scenario:
    """The scenario of the ``drawn`` human values with ``overrides`` applied.

    Args:
        drawn: the program's values by key, in human units.
        overrides: by key, checked by :func:`check_overrides`.
        where: program and scene, as a prefix of errors.

    Raises:
        Contradiction: rain from a sky without rain clouds, one of them an override.
        UsageError: another impossible scenario, or a duration that is no multiple of the step.
    """
    values = {**drawn, **overrides}
    # If both or neither are overridden, an override does not contradict the program.
    if sum(key in overrides for key in WEATHER) == 1:
        _check_weather(values, RAIN.key in overrides, where)
    scenario = _build(values, where)
    try:
        last_step(scenario)
    except UsageError as error:
        raise _headed(error, where) from error
    return scenario


def _check_weather(values: Mapping[str, Any], rain_is_set: bool, where: str) -> None:
    clouds = values.get(SKY.key, Scenario().clouds)
    try:
        rain = float(values.get(RAIN.key, 0.0))
    except (TypeError, ValueError):
        return  # the value is not known to be rain
    if clouds in RAIN_CLOUDS or not rain > 0:
        return
    if rain_is_set:
        raise Contradiction(
            f'override {RAIN.key}={values[RAIN.key]}: {where} has clouds {clouds}, which cannot '
            f'rain; set clouds={RAIN_CLOUDS[0]} (or {"/".join(RAIN_CLOUDS[1:])}) as well'
        )
    raise Contradiction(
        f'override clouds={clouds}: {where} has {rain:.0f} % rain, '
        f'which needs clouds {"/".join(RAIN_CLOUDS)}; set {RAIN.key}=0 as well'
    )


def check_offsets(values: Mapping[str, Any], where: str) -> None:
    """Check that no offset is given to a camera that has an offset of its own there, even one of 0.

    Args:
        values: of a scene, by key, in human units.
        where: program and scene, as a prefix of errors.

    Raises:
        Contradiction: an offset is given twice.
    """
    given = [field.key for field in CAMERA_OFFSETS if field.key in values]
    if not given or CAMERA.key not in values:
        return
    name = str(values[CAMERA.key])
    try:
        camera = CATALOGUES[CAMERA.key].typed(name)
    except UsageError:
        return  # no such camera, which the scenario tells
    if camera.base is None:
        return
    for field, offset in zip(CAMERA_OFFSETS, camera.offsets, strict=True):
        if offset and field.key in given:
            shown = camera.name if name.startswith('{') else Path(name).name
            raise Contradiction(
                f'{where}: {field.key}: the camera {shown} has an offset of its own; leave one out'
            )


def _place(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values that decide which starts are possible."""
    return {key: values[key] for key in (PLACE.key, TRACK.key) if key in values}


def without_idle(
    drawn: Mapping[str, Any], overrides: Mapping[str, str], changing: Collection[str]
) -> dict[str, Any]:
    """The drawn values but those without effect where a key in ``changing`` happens to be 0."""
    present = {
        split_point(name)[0] for name, value in {**drawn, **overrides}.items()
        if not _is_zero(value) and split_point(name)[1] != FORM
    }
    moving = {split_point(name)[0] for name in (*changing, *overrides)}
    return {
        key: value for key, value in drawn.items()
        if key in overrides or not (needs := NEEDS.get(split_point(key)[0], set())) & moving
        or needs & present
    }


def _is_zero(value: Any) -> bool:
    try:
        return float(value) == 0  # also the texts 0.0 and -0
    except (TypeError, ValueError):
        return False


def check_value(key: str, value: Any, place: Mapping[str, Any] | None = None) -> None:
    """Check that a value is possible for some values of the other keys.

    Args:
        key: scenario key.
        value: its fixed value.
        place: keys and values of place and track; without them, any place is accepted.

    Raises:
        UsageError: it is impossible.
    """
    field = BY_KEY.get(full_key(key))
    if not place and field is TRACK:
        field.checked(value)
        return
    if field is not None and (field is TRAFFIC or is_point(field.key)):
        field.checked(field.from_human(value))  # hold lines fit a track, which a program may set
        return
    if not place and field is not None and field.anywhere is not None:
        field.checked(field.from_human(value), field.anywhere)
        return
    # Check each with values that allow it: rain with a rainy sky, crossing keys with a crossing.
    allowing = {**_ALLOWING, **(_allowing_camera(value) if key == SENSORS.key else _ALLOWING_GNSS)}
    scenario = scenario_from_human({**(place or {}), **allowing, key: value})
    if not any(
        is_whole(scenario.duration_s, NS_PER_S // rate_hz) for rate_hz in CONTROL_RATES_HZ
    ):
        last_step(scenario)


def _allowing_camera(sensors: Any) -> dict[str, Any]:
    """A control rate of which the rate of the second camera is a divisor, if there is one."""
    second = find_sensors(SENSORS.from_human(sensors)).camera
    if second is None:
        return {}
    rates_hz = [rate_hz for rate_hz in CONTROL_RATES_HZ if rate_hz % second.rate_hz == 0]
    return {CONTROL_RATE.key: rates_hz[0]} if rates_hz else {}


def _build(values: Mapping[str, Any], where: str) -> Scenario:
    try:
        return scenario_from_human(values)
    except UsageError as error:
        raise _headed(error, where) from error


def _headed(error: UsageError, where: str) -> UsageError:
    return UsageError(f'{where}: {str(error).removeprefix("scenario: ")}')
