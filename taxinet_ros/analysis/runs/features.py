"""Scene features that may explain a failure, and the display of their values."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from taxinet_ros.core import scenario_fields as fields
from taxinet_ros.core.place.catalogue import SHIPPED_TRACKS
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    FORM,
    HUMAN_KEYS,
    Kind,
    ScenarioField,
    clock_words,
    is_point,
    split_point,
)

Mask = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]


class Form(Enum):
    """Display format of a feature's values."""

    CLOCK = 'clock'
    NUMBER = 'number'
    KIND = 'kind'


@dataclass(frozen=True, kw_only=True, slots=True)
class Feature:
    """A feature of a scene.

    Attributes:
        name: column of the table of runs; of an offset without its sign, ``abs_`` and the column.
        title: display name without unit.
        unit: unit of its values, '' for words and for the time of day.
        form: display format of its values.
        step: rounding step of interval limits, for display.
        words: templates of an interval with both, only the upper, or only the lower end.
        source: column from which it is computed.
        kinds: for words, all values in order.
        widths: candidate bin widths, from narrow to wide.
    """

    name: str
    title: str
    unit: str = ''
    form: Form = Form.NUMBER
    step: float = 1.0
    words: tuple[str, str, str] = ('', '', '')
    source: str = ''
    kinds: tuple[str, ...] = ()
    widths: tuple[float, ...] = ()

    @property
    def axis(self) -> str:
        """Title with the unit, for an axis or a column."""
        return f'{self.title} [{self.unit}]' if self.unit else self.title

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers."""
        return self.form is not Form.KIND

    def value_words(self, value: float) -> str:
        """Display text of one value, without unit."""
        if self.form is Form.CLOCK:
            return clock_words(value)
        digits = max(0, -math.floor(math.log10(self.step)))
        return f'{value:,.{digits}f}'.replace('-', '−')

    def rounded(self, low: float, high: float) -> tuple[float, float]:
        """The given interval, widened to whole steps."""
        steps_per_unit = round(1 / self.step, 9)
        return (math.floor(low * steps_per_unit + 1e-9) / steps_per_unit,
                math.ceil(high * steps_per_unit - 1e-9) / steps_per_unit)

    def interval_words(self, low: float | None, high: float | None) -> str:
        """Display text of an interval; None for an end beyond which no run lies."""
        both, below, above = self.words
        if self is RAIN and low is None and high == 0:
            return 'no rain'
        if low is None:
            return 'any ' + self.title if high is None else below.format(self.value_words(high))
        if high is None:
            return above.format(self.value_words(low))
        return both.format(self.value_words(low), self.value_words(high))




def _kinds(field: ScenarioField) -> tuple[str, ...]:
    if field.catalogue is not None:
        return field.catalogue.shipped
    if field is fields.TRACK:
        return SHIPPED_TRACKS
    return ('off', 'on') if field.kind is Kind.SWITCH else field.words


def _feature(
    field: ScenarioField, *, form: Form = Form.NUMBER, step: float = 1.0,
    words: tuple[str, str, str] = ('', '', ''), widths: tuple[float, ...] = (),
) -> Feature:
    """The feature of a column of the table."""
    return Feature(
        name=field.key, title=field.title, unit='' if form is Form.CLOCK else field.unit,
        form=form, step=step, words=words, source=field.key, widths=widths,
        kinds=_kinds(field),
    )


def _either_side(one: Feature, title: str, words: tuple[str, str, str]) -> Feature:
    """A feature without its sign."""
    return dataclasses.replace(one, name=f'{_ABS}{one.name}', title=title, words=words)


_ABS = 'abs_'
TIME_OF_DAY = _feature(
    fields.TIME_OF_DAY, form=Form.CLOCK, step=1 / 12, widths=(0.5, 1.0, 2.0, 3.0, 6.0, 12.0),
    words=('between {} and {}', 'before {}', 'after {}'),
)
CLOUDS_KIND = _feature(fields.SKY, form=Form.KIND)
RAIN = _feature(
    fields.RAIN, widths=(5.0, 10.0, 20.0, 50.0, 100.0),
    words=('rain of {} to {} %', 'rain of at most {} %', 'rain of {} % or more'),
)
CROSS_TRACK = _feature(
    fields.CROSS_TRACK, step=0.1, widths=(0.5, 1.0, 2.0, 4.0, 8.0, 16.0),
    words=('start at {} to {} m (left positive)', 'start below {} m (left positive)',
           'start above {} m (left positive)'),
)
DISTANCE = _feature(
    fields.DISTANCE, step=10.0, widths=(50.0, 100.0, 200.0, 500.0, 1000.0, 3000.0),
    words=('start {} to {} m along the track', 'start on the first {} m of the track',
           'start beyond {} m along the track'),
)
HEADING = _feature(
    fields.HEADING, widths=(1.0, 2.0, 5.0, 10.0, 30.0, 90.0),
    words=('start heading {} to {}° (nose left positive)',
           'start heading below {}° (nose left positive)',
           'start heading above {}° (nose left positive)'),
)
ABS_CROSS_TRACK = _either_side(
    CROSS_TRACK, 'start offset, to either side',
    ('start {} to {} m beside the centreline, to either side',
     'start within {} m of the centreline',
     'start {} m or more beside the centreline, to either side'),
)
ABS_HEADING = _either_side(
    HEADING, 'start heading, to either side',
    ('start heading {} to {}° off, to either side', 'start heading within {}°',
     'start heading {}° or more off, to either side'),
)
WIND_SPEED = _feature(
    fields.WIND_SPEED, step=0.1, widths=(0.5, 1.0, 2.0, 5.0, 10.0, 30.0),
    words=('wind of {} to {} m/s', 'wind below {} m/s', 'wind above {} m/s'),
)
WIND_DIRECTION = _feature(
    fields.WIND_DIRECTION, widths=(5.0, 10.0, 30.0, 90.0, 360.0),
    words=('wind from {} to {}°', 'wind from below {}°', 'wind from above {}°'),
)
PUSHING_FEATURES = (
    WIND_SPEED, WIND_DIRECTION,
    _feature(
        fields.GUST, step=0.1, widths=(0.5, 1.0, 2.0, 5.0, 10.0),
        words=('gusts of {} to {} m/s', 'gusts below {} m/s', 'gusts above {} m/s'),
    ),
    _feature(fields.RUNWAY_STATE, form=Form.KIND),
    _feature(
        fields.SLOPE, step=0.1, widths=(0.5, 1.0, 2.0, 5.0, 10.0),
        words=('slope of {} to {} %, uphill positive', 'slope below {} %, uphill positive',
               'slope above {} %, uphill positive'),
    ),
    _feature(
        fields.SPEED, step=0.1, widths=(0.5, 1.0, 2.0, 5.0, 10.0),
        words=('taxi speed of {} to {} m/s', 'taxi speed below {} m/s', 'taxi speed above {} m/s'),
    ),
)
"""Features that affect the motion; the gust seed is not a meaningful feature."""
_SHARES = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_TIMES_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
_ANGLES_DEG = (0.5, 1.0, 2.0, 5.0, 10.0, 30.0)


def _fault(field: ScenarioField, step: float, widths: tuple[float, ...]) -> Feature:
    name, unit = field.title, field.unit
    return _feature(field, step=step, widths=widths, words=(
        f'{name} of {{}} to {{}} {unit}', f'{name} of at most {{}} {unit}',
        f'{name} of {{}} {unit} or more',
    ))


FAULT_FEATURES = (
    _fault(fields.CAMERA_DROPOUT, 1.0, _SHARES),
    _fault(fields.CAMERA_FREEZE, 0.1, _TIMES_S),
    _fault(fields.LENS_DIRT, 1.0, _SHARES),
    _fault(fields.LENS_DROPS, 1.0, _SHARES),
    _fault(fields.GLARE_GHOST, 1.0, _SHARES),
    _fault(fields.EXPOSURE_JUMP, 0.1, (0.5, 1.0, 2.0, 5.0)),
    _fault(fields.LOOP_DELAY, 0.1, _TIMES_S),
    _fault(fields.LOOP_JITTER, 0.1, _TIMES_S),
    _fault(fields.STEERING_BIAS, 0.1, _ANGLES_DEG),
    _fault(fields.STEERING_RATE_LIMIT, 0.1, _ANGLES_DEG),
    _fault(fields.FAULT_ONSET, 0.1, _TIMES_S),
)
"""Faults and their onset; their seed is not a meaningful feature."""
_GNSS_FEATURES = (
    _fault(fields.GNSS_NOISE, 0.1, _TIMES_S),
    _fault(fields.GNSS_BIAS, 0.1, _TIMES_S),
    _fault(fields.GNSS_DROPOUT_START, 0.1, _TIMES_S),
    _fault(fields.GNSS_DROPOUT, 0.1, _TIMES_S),
)
_CONTROL_RATE = _fault(fields.CONTROL_RATE, 1.0, (5.0, 10.0, 20.0, 40.0))
_SWITCHES = tuple(_feature(one, form=Form.KIND) for one in (fields.SHADOWS, fields.CROSSING))
_OTHER_KINDS = tuple(
    _feature(one, form=Form.KIND)
    for one in (
        fields.AIRCRAFT_MODEL, fields.CAMERA, fields.SENSORS, fields.DATE, fields.PLACE,
        fields.TRACK,
    )
)
_CAMERA_OFFSETS = tuple(
    _feature(
        field, step=0.01 if field.unit == 'm' else 0.1,
        widths=tuple(width / (1 if field.unit == '°' else 20) for width in _ANGLES_DEG),
        words=(
            f'{field.title}: {{}} to {{}} {field.unit}', f'{field.title}: below {{}} {field.unit}',
            f'{field.title}: above {{}} {field.unit}',
        ),
    )
    for field in fields.CAMERA_OFFSETS
)
PAPER_FEATURES = (TIME_OF_DAY, CLOUDS_KIND, RAIN, CROSS_TRACK, DISTANCE, HEADING)
"""The paper's six features, as columns of the table."""
ALL_FEATURES = (
    *PAPER_FEATURES, ABS_CROSS_TRACK, ABS_HEADING, *_SWITCHES, *_OTHER_KINDS, *PUSHING_FEATURES,
    *FAULT_FEATURES, *_CAMERA_OFFSETS, *_GNSS_FEATURES, _CONTROL_RATE,
)


class _Features(dict[str, Feature]):
    """Features by name, with those of control points."""

    def __missing__(self, name: str) -> Feature:
        if not is_point(name):
            raise KeyError(name)
        key, part = split_point(name)
        if part == FORM:
            return _feature(BY_KEY[name], form=Form.KIND)
        either, below, above = (f'{words} at {part} s' * bool(words) for words in self[key].words)
        return dataclasses.replace(
            self[key], name=name, source=name, title=BY_KEY[name].title,
            words=(either, below, above),
        )


BY_NAME = _Features({feature.name: feature for feature in ALL_FEATURES})
SCENE_COLUMNS = (*HUMAN_KEYS, 'signals')
"""Columns of :func:`scene_columns`: two runs have the same scene if these are equal."""

_BEFORE = {
    field.key: field.to_human(field.absent)
    for field in fields.SCENARIO_FIELDS if field.absent is not None
}


def feature_columns(table: pd.DataFrame) -> pd.DataFrame:
    """A column for each feature of a campaign's table, with control points that all runs have."""
    complete = [name for name in table.columns if not table[name].isna().any()]
    columns = {feature.name: _values(feature, table) for feature in features_of(complete)}
    return pd.DataFrame(columns, dtype=None)


def features_of(columns: Iterable[object]) -> tuple[Feature, ...]:
    """All features, with those of control points among the columns."""
    return (*ALL_FEATURES, *(BY_NAME[str(name)] for name in columns if is_point(str(name))))


def scene_columns(table: pd.DataFrame) -> pd.DataFrame:
    """A column for every scenario key of a campaign's table, in human units, else text.

    The last one has the control points that a run has, as JSON; '' for none.
    """
    def column(field: ScenarioField) -> pd.Series[Any]:
        number = field.kind is Kind.NUMBER
        before = _BEFORE.get(field.key, math.nan if number else '')
        found = table.get(field.key, pd.Series(before, table.index))
        return found.astype('float64' if number else str)

    points = table[[name for name in table.columns if is_point(str(name))]]
    texts = [''] * len(table) if points.empty else [
        json.dumps({name: value for name, value in row.items() if not pd.isna(value)})
        for row in points.to_dict('records')
    ]
    return pd.DataFrame({
        **{field.key: column(field) for field in fields.SCENARIO_FIELDS},
        'signals': pd.Series(texts, table.index, dtype=object),
    })


def varied(
    frame: pd.DataFrame, features: tuple[Feature, ...] | None = None
) -> tuple[Feature, ...]:
    """The features, of all or of some, that have more than one value here."""
    features = features_of(frame.columns) if features is None else features
    return tuple(feature for feature in features if frame[feature.name].nunique() > 1)


def shown_features(frame: pd.DataFrame) -> tuple[Feature, ...]:
    """Features whose rates are shown: those that vary here; the paper's where none does."""
    signed = tuple(
        one for one in features_of(frame.columns) if one not in (ABS_CROSS_TRACK, ABS_HEADING))
    return varied(frame, signed) or PAPER_FEATURES


def kinds_present(feature: Feature, frame: pd.DataFrame) -> tuple[str, ...]:
    """The words of a feature that occur, in their order; unknown ones last."""
    present = set(frame[feature.name])
    known = tuple(kind for kind in feature.kinds if kind in present)
    return known + tuple(sorted(present - set(known)))


def _values(feature: Feature, table: pd.DataFrame) -> npt.NDArray[Any]:
    if feature.source not in table.columns:
        # A table from before this feature existed.
        before = _BEFORE.get(feature.source, '')
        if before is True:
            before = 'on'
        return np.full(len(table), before, dtype=np.float64 if feature.numeric else object)
    column = table[feature.source]
    if feature in _SWITCHES:
        words = np.where(column.fillna(True).astype(bool), 'on', 'off')
        return words.astype(object)
    if feature.form is Form.KIND:
        return column.astype(str).to_numpy(dtype=object)
    numbers = column.to_numpy(dtype=np.float64)
    return np.abs(numbers) if feature in (ABS_CROSS_TRACK, ABS_HEADING) else numbers
