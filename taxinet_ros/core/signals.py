"""Values of a scenario that change within a run: control points over simulated time.

A key of :data:`VARYING` is the value at 0 s; ``KEY@SECONDS`` is the value at a later time, and
``KEY@form`` how it goes from point to point: ``constant`` (it keeps the value until the next
point), ``linear`` (the default of numbers), or ``cubic``. After the last point the value stays.
Each point is a key of its own for programs, samplers, tables and records.

``cubic`` is monotone between two points, so no value leaves the range of its neighbours: piecewise
cubic Hermite polynomials with the slopes of F. N. Fritsch and J. Butland, SIAM J. Sci. Stat.
Comput. 5, 1984. Only additions, products and quotients of doubles, so all machines get the same.
"""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from types import MappingProxyType
from typing import Any

from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    CONSTANT,
    CUBIC,
    FORM,
    LINEAR,
    SCENARIO_FIELDS,
    WIND_DIRECTION,
    Kind,
    ScenarioField,
    by_key,
    is_point,
    split_point,
)
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import load_json

VARYING = tuple(field for field in SCENARIO_FIELDS if field.varies)
"""Keys whose value may change within a run."""

_PERIODS = {WIND_DIRECTION.key: 2 * math.pi}
"""The wind turns the shorter way."""
_ORDER = {field.key: number for number, field in enumerate(VARYING)}


@dataclass(frozen=True, kw_only=True, slots=True)
class Signal:
    """Control points of one key after the start.

    Attributes:
        times_ns: simulated times [ns], ascending.
        values: values in SI units, or words.
        form: how it goes from point to point.
        period: of values that go round, in SI units; 0 for others.
    """

    times_ns: tuple[int, ...]
    values: tuple[Any, ...]
    form: str
    period: float = 0.0

    def at(self, start: Any, stamp_ns: int) -> Any:
        """The value at a simulated time.

        Args:
            start: value at 0 s.
            stamp_ns: simulated time [ns].
        """
        times, values = (0, *self.times_ns), [start, *self.values]
        # A jump comes with the step at its time, whose stamp may be rounded down.
        here = max(bisect_right(times, stamp_ns + (self.form == CONSTANT)) - 1, 0)
        if self.form == CONSTANT or times[here] == stamp_ns or here == len(self.times_ns):
            return values[here]
        if self.period:
            for number, value in enumerate(values[1:], 1):
                turned = math.remainder(value - values[number - 1], self.period)
                values[number] = values[number - 1] + turned
        share = (stamp_ns - times[here]) / (times[here + 1] - times[here])
        one, other = values[here:here + 2]
        value = one + (other - one) * (
            share if self.form == LINEAR else share * share * (3 - 2 * share)
        )
        if self.form == CUBIC:
            steps_s = [(late - early) / NS_PER_S for early, late in pairwise(times)]
            first, last = (_slope(steps_s, values, number) for number in (here, here + 1))
            rest = 1 - share
            value += steps_s[here] * share * rest * (first * rest - last * share)
        # Rounding must not leave the range of the two points.
        value = min(max(value, min(one, other)), max(one, other))
        return value % self.period if self.period else value


def _slope(steps_s: Sequence[float], values: Sequence[float], number: int) -> float:
    """Slope of the monotone curve at a point, a weighted harmonic mean of those beside it."""
    rises = [
        (late - early) / step_s
        for (early, late), step_s in zip(pairwise(values), steps_s, strict=True)
    ]
    if len(rises) == 1:
        return rises[0]
    if number in (0, len(rises)):
        near, far = (0, 1) if number == 0 else (-1, -2)
        return _end_slope(steps_s[near], steps_s[far], rises[near], rises[far])
    before, after = rises[number - 1:number + 1]
    if not (before > 0 < after or before < 0 > after):
        return 0.0
    step, next_step = steps_s[number - 1:number + 1]
    one, other = 2 * next_step + step, next_step + 2 * step
    return (one + other) / (one / before + other / after)


def _end_slope(near_s: float, far_s: float, near: float, far: float) -> float:
    """Slope at an end, of the parabola through three points as far as the curve is monotone."""
    slope = ((2 * near_s + far_s) * near - near_s * far) / (near_s + far_s)
    if not (slope > 0 < near or slope < 0 > near):
        return 0.0
    return 3 * near if near * far < 0 and abs(slope) > 3 * abs(near) else slope


@lru_cache(maxsize=256)
def points_of(text: str) -> Mapping[str, Any]:
    """Values of control points by key, in human units, of a scenario's ``signals``.

    Raises:
        UsageError: it is not the JSON of such.
    """
    try:
        values = load_json(text) if text else {}
    except ValueError as error:
        raise UsageError(f'scenario: signals is no JSON of control points: {error}') from None
    values = by_key(values) if isinstance(values, dict) else {text: None}
    if unknown := next((name for name in values if not is_point(name)), None):
        raise UsageError(f'scenario: signals: {unknown!r:.80} is no control point')
    return MappingProxyType(values)


@lru_cache(maxsize=256)
def signals_of(text: str) -> Mapping[str, Signal]:
    """The signals of a scenario's ``signals`` by the keys that they belong to."""
    points = points_of(text)
    found = {}
    for key in dict.fromkeys(split_point(name)[0] for name in points):
        own = {split_point(name)[1]: name for name in points if split_point(name)[0] == key}
        form = points.get(own.pop(FORM, ''), _usual_form(key))
        found[key] = Signal(
            times_ns=tuple(round(float(time) * NS_PER_S) for time in own),
            values=tuple(BY_KEY[name].from_human(points[name]) for name in own.values()),
            form=form, period=_PERIODS.get(key, 0.0),
        )
    return found


def checked_signals(values: Mapping[str, Any], duration_s: float) -> str:
    """Canonical text of control points.

    Args:
        values: by key (:func:`.by_key`), in human units.
        duration_s: length of the run [s].

    Raises:
        UsageError: a value is out of range, a point is after the run, or a form has no effect.
    """
    found = {}
    for name in sorted(values, key=_place):
        field, (key, part) = BY_KEY[name], split_point(name)
        value = field.checked(field.from_human(values[name]))
        if part != FORM and float(part) > duration_s:
            raise UsageError(f'scenario: {name} is after the end of the run at {duration_s:g} s')
        if part == FORM and sum(split_point(other)[0] == key for other in values) < 2:
            raise UsageError(f'scenario: {name} has no effect without a control point, as {key}@5')
        if part != FORM or value != _usual_form(key):
            found[name] = field.to_human(value)
    return json.dumps(found, separators=(',', ':')) if found else ''


def kept_signals(text: str, fields: Collection[ScenarioField]) -> str:
    """The part of a scenario's ``signals`` that belongs to some keys."""
    keys = {field.key for field in fields}
    kept = {name: value for name, value in points_of(text).items() if split_point(name)[0] in keys}
    return json.dumps(kept, separators=(',', ':')) if kept else ''


def _usual_form(key: str) -> str:
    return LINEAR if BY_KEY[key].kind is Kind.NUMBER else CONSTANT


def _place(name: str) -> tuple[int, float]:
    key, part = split_point(name)
    return _ORDER[key], -1.0 if part == FORM else float(part)
