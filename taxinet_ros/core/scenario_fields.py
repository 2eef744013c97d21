"""Table of scenario keys: names, units, ranges, allowed words and titles.

A key is the user-facing name and includes its unit. It is used in Scenic programs, after ``--set``,
in experiments, tables, records, labels and JSON. The attribute of
:class:`~taxinet_ros.core.scenario.Scenario`, and the field of its message, is in SI units.

Input also accepts a key without its unit (short form: ``rain`` for ``rain_percent``);
:func:`by_key` expands it. Older files contain only short forms and are read in the same way.

Everything else with an entry per key (scenario message, rows and tables of runs, features of an
analysis, world model of the programs, pages of the documentation) is generated from this table, or
compared with it by ``tests/core/test_scenario_fields.py``.

``KEY@SECONDS`` is the value of a key later in the run, see :mod:`taxinet_ros.core.signals`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeVar

from taxinet_ros.arguments import is_number, told
from taxinet_ros.core.datarefs import DATAREF_SETS
from taxinet_ros.core.documents import Catalogue
from taxinet_ros.core.place.catalogue import PLACES
from taxinet_ros.core.place.place_file import MOST_LENGTH_M, MOST_WIDTH_M
from taxinet_ros.core.place.track import RUNWAY_TRACK
from taxinet_ros.core.rig.camera_model import MOST_OFFSET_DEG, MOST_OFFSET_M
from taxinet_ros.core.rig.catalogue import AIRCRAFT, CAMERAS
from taxinet_ros.core.sensors import LONGEST_S, MOST_BIAS_M, MOST_NOISE_M, SENSOR_SETS
from taxinet_ros.core.traffic.traffic_file import OTHERS, traffic_words
from taxinet_ros.core.units import typed_number
from taxinet_ros.errors import UsageError, near_miss

CLOUDS = ('clear', 'cirrus', 'scattered', 'broken', 'overcast', 'stratus')
"""The six cloud kinds, from clear sky to dark stratus, in X-Plane 11's order."""

RAIN_CLOUDS = ('broken', 'overcast', 'stratus')
"""Cloud kinds that allow rain."""

RUNWAY_STATES = ('dry', 'auto', 'wet', 'icy')
"""Runway conditions, which set the friction; ``auto``: wet if it rains, else dry."""

CONTROL_RATES_HZ = (5, 6, 8, 10, 12, 15, 20, 24, 30, 40, 60)
"""Rates whose period is a whole number of physics steps, 1/120 s."""

CONSTANT, LINEAR, CUBIC = FORMS = ('constant', 'linear', 'cubic')
"""How a value goes from one control point to the next."""
FORM = 'form'
_AT = '@'

_SWITCH_WORDS = {
    'true': True, 'on': True, '1': True, 'false': False, 'off': False, '0': False,
}
_PLAIN_NUMBER = re.compile(r'\s*[+-]?[0-9a-zA-Z.+-]{1,40}\s*')
"""Python also reads ``1_0`` and digits of other scripts; a typing error must not become a value."""
_CLOCK = re.compile(r'\s*([0-9]{1,2}):([0-5][0-9])(?::([0-5][0-9]))?\s*')
_SEEDS = 1e9
"""A greater limit is that of a seed, whose numbers have no meaning."""
_DECIMALS = 9
"""Rounding to a nano-unit makes degrees -> radians -> degrees give back what was typed."""


class Kind(Enum):
    """Type of a key's values."""

    NUMBER = 'number'
    WORD = 'word'
    DATE = 'date'
    SWITCH = 'switch'
    DOCUMENT = 'document'


_VALUES: dict[Kind, tuple[type, str]] = {
    Kind.NUMBER: (float, 'a number'), Kind.WORD: (str, 'a word'),
    Kind.DATE: (str, 'a date, YYYY-MM-DD'), Kind.SWITCH: (bool, 'True or False'),
    Kind.DOCUMENT: (str, 'a name or JSON'),
}


_COLUMN_TYPES = {
    Kind.NUMBER: 'float64', Kind.WORD: 'string', Kind.DATE: 'string', Kind.SWITCH: 'boolean',
    Kind.DOCUMENT: 'string',
}


@dataclass(frozen=True, kw_only=True, slots=True)
class ScenarioField:
    """One key of a scenario.

    Attributes:
        key: user-facing name, including the unit if there is one.
        short: the key without its unit, '' if equal to the key.
        attribute: of :class:`~taxinet_ros.core.scenario.Scenario`, and the field of its message, in
            SI units.
        title: display name, without the unit.
        kind: type of its values.
        unit: user-facing unit, '' for words.
        si: one ``unit`` in SI units.
        si_unit: suffix of a number in SI units.
        low, high: least and greatest number in SI units, both allowed; of what depends on the
            place, at the paper's.
        anywhere: the same at some place at least, where it depends on the place.
        counted: from where and in which direction, as it follows either unit.
        form: format of displayed numbers.
        words: all allowed words, in order.
        catalogue: lookup of the documents of a key whose values are documents.
        plane: whether a Scenic program says it by the place of its aircraft, which has a property
            of this name; else a parameter of the program does.
        absent: its value in recordings older than the key, in SI units; None if the key has always
            existed.
        carrier: attribute whose text carries it in the scenario message; '' if it has a field of
            its own.
        varies: whether it may change within a run.
    """

    key: str
    attribute: str
    title: str
    short: str = ''
    kind: Kind = Kind.NUMBER
    unit: str = ''
    si: float = 1.0
    low: float = -math.inf
    high: float = math.inf
    anywhere: tuple[float, float] | None = None
    si_unit: str = ''
    counted: str = ''
    form: str = '{:g}'
    words: tuple[str, ...] = ()
    catalogue: Catalogue[Any] | None = None
    plane: bool = False
    absent: Any = None
    carrier: str = ''
    varies: bool = False

    @property
    def label(self) -> str:
        """Display name of the key, without its unit: ``time of day``."""
        return (self.short or self.key).replace('_', ' ')

    @property
    def column_type(self) -> str:
        """Its type in tables, as pandas calls it."""
        return _COLUMN_TYPES[self.kind]

    @property
    def unit_mark(self) -> str:
        """The unit as it follows a number: ``' m'``, ``'°'``, ``''``."""
        return self.unit if self.unit in ('', '°') else f' {self.unit}'

    @property
    def allowed(self) -> str:
        """What its values may be, at the paper's place: ``0 to 30 m/s``, ``on, off``."""
        if self.kind is Kind.NUMBER:
            if self.high > _SEEDS:
                return 'a whole number'
            low, high = self.low / self.si, self.high / self.si
            return f'{low:g} to {high:g}{self.unit_mark}{self.counted}'
        if self.kind is Kind.SWITCH:
            return 'on, off'
        if self.catalogue is not None:
            return f'{", ".join(self.catalogue.shipped)}, or a YAML file'
        return ', '.join(self.words) or ('YYYY-MM-DD' if self.kind is Kind.DATE else 'a word')

    def from_human(self, value: Any) -> Any:
        """Convert a user's value to SI units.

        Raises:
            UsageError: it is no number within the range, no switch or no document, where there
                should be one.
        """
        if self.kind is Kind.NUMBER:
            number = self._number(value)
            low, high = self.anywhere or (self.low, self.high)
            if not _within(number * self.si, low, high):
                unit = f'{self.unit_mark}{self.counted}'
                raise _outside(self.key, number, low / self.si, high / self.si, unit)
            return number * self.si
        if self.catalogue is not None:
            return self.catalogue.typed(str(value)).text
        return self._switch(value) if self.kind is Kind.SWITCH else str(value)

    def settled(self, typed: str) -> str:
        """Convert a user's text for storage.

        A document becomes its reference, since files may change; a number with a unit, or a time as
        9:30, the number in the key's own unit.

        Raises:
            UsageError: unknown document, an invalid file, or a unit of something else.
        """
        if self.catalogue is not None:
            return str(self.catalogue.typed(typed).reference)
        number = self._with_unit(typed) if self.kind is Kind.NUMBER else None
        return typed if number is None else repr(number).removesuffix('.0')

    def to_human(self, value: Any) -> Any:
        """The inverse of :meth:`from_human`."""
        if self.catalogue is not None:
            return self.catalogue.find(value).reference
        return round(value / self.si, _DECIMALS) if self.kind is Kind.NUMBER else value

    def as_typed(self, value: Any) -> str:
        """A value in SI units as a person would type it: ``12``, ``on``, ``caravan``."""
        human = self.to_human(value)
        if self.kind is Kind.SWITCH:
            return 'on' if human else 'off'
        return f'{human:g}' if isinstance(human, float) else str(human)

    def checked(self, value: Any, limits: tuple[float, float] | None = None) -> Any:
        """A value in SI units as plain Python, if it is of its kind and possible.

        Args:
            value: to be checked.
            limits: least and greatest number in place of the row's own.

        Raises:
            UsageError: it is of another kind, outside the range, or none of the words.
        """
        expected, what = _VALUES[self.kind]
        # To Python a switch is a number too, and any text is true; numpy has switches of its own.
        switch = type(value).__name__ in ('bool', 'bool_')
        fits = is_number(value) if self.kind is Kind.NUMBER else isinstance(value, expected)
        if switch is not (self.kind is Kind.SWITCH) or not (switch or fits):
            raise UsageError(f'scenario: {self.attribute} is {told(value)}, not {what}')
        # A NumPy number would impose its precision on the arithmetic of the run.
        value = value if type(value) is expected else expected(value)
        low, high = limits or (self.low, self.high)
        if self.kind is Kind.NUMBER and not _within(value, low, high):
            raise _outside(self.attribute, value, low, high, f' {self.si_unit}{self.counted}')
        if self.catalogue is not None:
            return self.catalogue.find(value).text
        if self.words and value not in self.words:
            raise UsageError(
                f'scenario: {self.key} is {value!r}, not one of {", ".join(self.words)}'
                f'{near_miss(value, self.words)}'
            )
        if self.kind is Kind.DATE:
            try:
                return datetime.date.fromisoformat(value).isoformat()
            except ValueError:
                raise UsageError(f'scenario: {self.key} is {value!r}, not YYYY-MM-DD') from None
        return value

    def value_words(self, value: Any) -> str:
        """Display text of a value, with its user-facing unit: ``10:30``, ``+2.5 deg``, ``on``."""
        if value is None:  # a control point that a scene does not have
            return 'none'
        if self is TIME_OF_DAY:
            return clock_words(value)
        if self.kind is Kind.SWITCH:
            return 'on' if value else 'off'
        if self is TRAFFIC:
            return traffic_words(str(value))
        if self.kind is not Kind.NUMBER:
            return str(value)
        number = self.form.format(value)
        unit = 'deg' if self.unit == '°' else self.unit
        return f'{number.removeprefix("+") if value == 0 else number} {unit}'.rstrip()

    def _number(self, value: Any) -> float:
        if isinstance(value, bool):
            raise UsageError(f'scenario: {self.key} needs a number, got {value!r}')
        try:
            if isinstance(value, str):
                number = self._with_unit(value)
                if number is not None:
                    return number
                if not _PLAIN_NUMBER.fullmatch(value):
                    raise ValueError
            return float(value)
        except (TypeError, ValueError, OverflowError):
            wanted = 'hours, or a time as 9:30' if self is TIME_OF_DAY else 'a number'
            raise UsageError(f'scenario: {self.key} needs {wanted}, got {told(value)}') from None

    def _with_unit(self, text: str) -> float | None:
        """The number in the key's unit, of a number with a unit or a time as 9:30; else None."""
        clock = _CLOCK.fullmatch(text) if self is TIME_OF_DAY else None
        if clock is not None:
            hours, minutes, seconds = (int(part or 0) for part in clock.groups())
            return (3600 * hours + 60 * minutes + seconds) / 3600
        try:
            return typed_number(text, self.unit)
        except ValueError as wanted:
            raise UsageError(f'scenario: {self.key} needs {wanted}, got {told(text)}') from None

    def _switch(self, value: Any) -> bool:
        if isinstance(value, bool):
            return value
        if str(value).lower() not in _SWITCH_WORDS:
            raise UsageError(f'scenario: {self.key} needs on or off, got {value!r}')
        return _SWITCH_WORDS[str(value).lower()]


def _within(value: float, low: float, high: float) -> bool:
    return math.isfinite(value) and low <= value <= high


def _outside(name: str, value: float, low: float, high: float, unit: str) -> UsageError:
    # With all digits that tell it from the end of the range.
    return UsageError(f'scenario: {name} is {value:.15g}, outside {low:g}..{high:g}{unit}')


def clock_words(hours: float) -> str:
    """Hours after midnight as ``13:20``."""
    whole, minutes = divmod(round(hours * 60), 60)
    return f'{whole:02d}:{minutes:02d}'


def along_words(track: str) -> str:
    """What a distance is measured along: ``'past the threshold'``, ``'along exit_left'``."""
    return 'past the threshold' if track in ('', RUNWAY_TRACK) else f'along {track}'


def unusual_words(scene: Mapping[str, Any]) -> str:
    """What pushes the aircraft, what fails, and who is there: ``', wind 8.0 m/s, …'``.

    Args:
        scene: in human units, by key; missing ones are left out.
    """
    return ''.join(
        f', {field.title} {field.value_words(scene[field.key]).partition("@")[0]}'.replace('_', ' ')
        for field in (
            *PUSHING_FIELDS, *FAULT_FIELDS, TRAFFIC, *CAMERA_OFFSETS, SENSORS, *GNSS_FIELDS,
            CONTROL_RATE, DATAREFS,
        )
        if scene.get(field.key) not in (None, '', field.to_human(field.absent))
    ) + ''.join(
        f', {BY_KEY[name].title} {BY_KEY[name].value_words(value)}'
        for name, value in scene.items() if value is not None and is_point(name)
    )


CROSS_TRACK = ScenarioField(
    key='cross_track_m', short='cross_track', attribute='cross_track_m',
    title='start offset, left of the centreline', unit='m', form='{:+.1f}', low=-15.0, high=15.0,
    si_unit='m', counted=' left of the centreline (on the runway)', plane=True,
    anywhere=(-MOST_WIDTH_M / 2, MOST_WIDTH_M / 2),
)
DISTANCE = ScenarioField(
    key='distance_m', short='distance', attribute='distance_m',
    title='start distance along the track', unit='m', form='{:.0f}', low=0.0, high=2600.0,
    si_unit='m', counted=' past the threshold', plane=True, anywhere=(0.0, MOST_LENGTH_M),
)
HEADING = ScenarioField(
    key='heading_deg', short='heading', attribute='heading_rad',
    title='start heading, nose left', unit='°', si=math.pi / 180, form='{:+.1f}',
    low=-math.pi / 2, high=math.pi / 2, si_unit='rad', counted=', nose left positive',
    plane=True,
)
SKY = ScenarioField(
    key='clouds', attribute='clouds', title='clouds', kind=Kind.WORD, words=CLOUDS,
)
RAIN = ScenarioField(
    key='rain_percent', short='rain', attribute='rain_fraction', title='rain', unit='%', si=0.01,
    form='{:.0f}', low=0.0, high=1.0, si_unit='as a fraction',
)
TIME_OF_DAY = ScenarioField(
    key='time_of_day_h', short='time_of_day', attribute='time_of_day_s',
    title='time of day', unit='h', si=3600.0, low=0.0, high=86400.0,
    si_unit='s', counted=' after local midnight',
)
DATE = ScenarioField(
    key='date', attribute='date', title='date', kind=Kind.DATE,
)
SHADOWS = ScenarioField(
    key='shadows', attribute='shadows', title='shadow of the aircraft', kind=Kind.SWITCH,
)
CROSSING = ScenarioField(
    key='crossing', attribute='crossing', title='crossing runway', kind=Kind.SWITCH, absent=True,
)
AIRCRAFT_MODEL = ScenarioField(
    key='aircraft', attribute='aircraft', title='aircraft', kind=Kind.DOCUMENT, catalogue=AIRCRAFT,
)
WIND_SPEED = ScenarioField(
    key='wind_speed_mps', short='wind_speed', attribute='wind_speed_mps', title='wind', unit='m/s',
    form='{:.1f}', low=0.0, high=30.0, si_unit='m/s', absent=0.0, varies=True,
)
WIND_DIRECTION = ScenarioField(
    key='wind_direction_deg', short='wind_direction', attribute='wind_direction_rad',
    title='wind from', unit='°', si=math.pi / 180, form='{:.0f}',
    low=0.0, high=2 * math.pi, si_unit='rad', counted=' from true north, clockwise',
    absent=0.0, varies=True,
)
GUST = ScenarioField(
    key='gust_mps', short='gust', attribute='gust_mps', title='gusts (standard deviation)',
    unit='m/s', form='{:.1f}', low=0.0, high=10.0, si_unit='m/s', absent=0.0, varies=True,
)
GUST_SEED = ScenarioField(
    key='gust_seed', attribute='gust_seed', title='seed of the gusts',
    form='{:.0f}', low=0.0, high=2.0**32 - 1, si_unit='as a whole number', absent=0.0,
)
RUNWAY_STATE = ScenarioField(
    key='runway_state', attribute='runway_state', title='surface friction', kind=Kind.WORD,
    words=RUNWAY_STATES, absent='dry', varies=True,
)
SLOPE = ScenarioField(
    key='slope_percent', short='slope', attribute='slope_fraction', title='slope, uphill', unit='%',
    si=0.01, form='{:+.1f}', low=-0.05, high=0.05, si_unit='as a fraction', absent=0.0,
)
SPEED = ScenarioField(
    key='speed_mps', short='speed', attribute='speed_mps', title='taxi speed', unit='m/s',
    form='{:.1f}', low=1.0, high=10.0, si_unit='m/s', absent=5.0,
)
TRACK = ScenarioField(
    key='track', attribute='track', title='track', kind=Kind.WORD, absent=RUNWAY_TRACK,
)
CAMERA_DROPOUT = ScenarioField(
    key='camera_dropout_percent', short='camera_dropout', attribute='camera_dropout_fraction',
    title='lost camera frames', unit='%', si=0.01, form='{:.0f}', low=0.0, high=1.0,
    si_unit='as a fraction', absent=0.0,
)
CAMERA_FREEZE = ScenarioField(
    key='camera_freeze_s', short='camera_freeze', attribute='camera_freeze_s',
    title='frozen camera picture', unit='s', form='{:.1f}', low=0.0, high=600.0, si_unit='s',
    absent=0.0,
)
LENS_DIRT = ScenarioField(
    key='lens_dirt_percent', short='lens_dirt', attribute='lens_dirt_fraction',
    title='dirt on the lens', unit='%', si=0.01, form='{:.0f}', low=0.0, high=1.0,
    si_unit='as a fraction', absent=0.0,
)
LENS_DROPS = ScenarioField(
    key='lens_drops_percent', short='lens_drops', attribute='lens_drops_fraction',
    title='drops on the lens', unit='%', si=0.01, form='{:.0f}', low=0.0, high=1.0,
    si_unit='as a fraction', absent=0.0,
)
GLARE_GHOST = ScenarioField(
    key='glare_ghost_percent', short='glare_ghost', attribute='glare_ghost_fraction',
    title='ghosts of the sun in the lens', unit='%', si=0.01, form='{:.0f}', low=0.0, high=1.0,
    si_unit='as a fraction', absent=0.0,
)
EXPOSURE_JUMP = ScenarioField(
    key='exposure_jump_ev', short='exposure_jump', attribute='exposure_jump_ev',
    title='jump of the exposure', unit='EV', form='{:+.1f}', low=-6.0, high=6.0, si_unit='EV',
    absent=0.0, varies=True,
)
LOOP_DELAY = ScenarioField(
    key='loop_delay_s', short='loop_delay', attribute='loop_delay_s',
    title='delay from frame to command', unit='s', form='{:.2f}', low=0.0, high=30.0, si_unit='s',
    absent=0.0, varies=True,
)
LOOP_JITTER = ScenarioField(
    key='loop_jitter_s', short='loop_jitter', attribute='loop_jitter_s',
    title='jitter from frame to command', unit='s', form='{:.2f}', low=0.0, high=30.0,
    si_unit='s', absent=0.0,
)
STEERING_BIAS = ScenarioField(
    key='steering_bias_deg', short='steering_bias', attribute='steering_bias_rad',
    title='steering bias', unit='°', si=math.pi / 180, form='{:+.1f}',
    low=-math.pi / 6, high=math.pi / 6, si_unit='rad', counted=', left positive', absent=0.0,
    varies=True,
)
STEERING_RATE_LIMIT = ScenarioField(
    key='steering_rate_limit_degps', short='steering_rate_limit',
    attribute='steering_rate_limit_radps', title='limit of the steering rate', unit='°/s',
    si=math.pi / 180, form='{:.1f}', low=0.0, high=math.pi, si_unit='rad/s',
    counted=', 0 for none', absent=0.0,
)
FAULT_ONSET = ScenarioField(
    key='fault_onset_s', short='fault_onset', attribute='fault_onset_s',
    title='onset of the faults', unit='s', form='{:.1f}', low=0.0, high=600.0, si_unit='s',
    absent=0.0,
)
FAULT_SEED = ScenarioField(
    key='fault_seed', attribute='fault_seed', title='seed of the faults',
    form='{:.0f}', low=0.0, high=2.0**32 - 1, si_unit='as a whole number', absent=0.0,
)
TRAFFIC = ScenarioField(
    key='traffic', attribute='traffic', title='others on the ground', kind=Kind.DOCUMENT,
    catalogue=OTHERS, absent=OTHERS.default,
)
CAMERA = ScenarioField(
    key='camera', attribute='camera', title='camera', kind=Kind.DOCUMENT, catalogue=CAMERAS,
    absent=CAMERAS.default,
)


def _camera_offset(axis: str, title: str) -> ScenarioField:
    length = len(axis) == 1
    unit, suffix, si_unit, si = ('m', 'm', 'm', 1.0) if length else (
        '°', 'deg', 'rad', math.pi / 180)
    most = MOST_OFFSET_M if length else MOST_OFFSET_DEG * si
    return ScenarioField(
        key=f'camera_d{axis}_{suffix}', short=f'camera_d{axis}',
        attribute=f'camera_d{axis}_{si_unit}', title=title, unit=unit, si=si,
        form='{:+.2f}' if length else '{:+.1f}', low=-most, high=most, si_unit=si_unit,
        absent=0.0, carrier=CAMERA.attribute,
    )


CAMERA_OFFSETS = (
    _camera_offset('x', 'camera moved forward'),
    _camera_offset('y', 'camera moved left'),
    _camera_offset('z', 'camera moved up'),
    _camera_offset('roll', 'camera rolled right side down'),
    _camera_offset('pitch', 'camera pitched nose down'),
    _camera_offset('yaw', 'camera yawed left'),
)
"""Offsets of the camera from its place and attitude on the aircraft; as in a camera file."""
SENSORS = ScenarioField(
    key='sensors', attribute='sensors', title='sensors beside the camera', kind=Kind.DOCUMENT,
    catalogue=SENSOR_SETS, absent=SENSOR_SETS.default, carrier=CAMERA.attribute,
)
GNSS_NOISE = ScenarioField(
    key='gnss_noise_m', short='gnss_noise', attribute='gnss_noise_m',
    title='GNSS noise', unit='m', form='{:.2f}', low=0.0, high=MOST_NOISE_M, si_unit='m',
    counted=', 0 for its own', absent=0.0, carrier=CAMERA.attribute,
)
GNSS_BIAS = ScenarioField(
    key='gnss_bias_m', short='gnss_bias', attribute='gnss_bias_m',
    title='GNSS offset to the left', unit='m', form='{:+.2f}', low=-MOST_BIAS_M, high=MOST_BIAS_M,
    si_unit='m', counted=', 0 for its own', absent=0.0, carrier=CAMERA.attribute,
)
GNSS_DROPOUT_START = ScenarioField(
    key='gnss_dropout_start_s', short='gnss_dropout_start', attribute='gnss_dropout_start_s',
    title='start of the GNSS drop-out', unit='s', form='{:.1f}', low=0.0, high=LONGEST_S,
    si_unit='s', absent=0.0, carrier=CAMERA.attribute,
)
GNSS_DROPOUT = ScenarioField(
    key='gnss_dropout_s', short='gnss_dropout', attribute='gnss_dropout_s',
    title='GNSS drop-out', unit='s', form='{:.1f}', low=0.0, high=LONGEST_S,
    si_unit='s', absent=0.0, carrier=CAMERA.attribute,
)
GNSS_FIELDS = (GNSS_NOISE, GNSS_BIAS, GNSS_DROPOUT_START, GNSS_DROPOUT)
"""What a search can vary of the GNSS of ``sensors``."""
CONTROL_RATE = ScenarioField(
    key='control_rate_hz', short='control_rate', attribute='control_rate_hz',
    title='control rate', unit='Hz', low=CONTROL_RATES_HZ[0], high=CONTROL_RATES_HZ[-1],
    counted=f': {", ".join(map(str, CONTROL_RATES_HZ))}', si_unit='Hz', absent=10.0,
    carrier=CAMERA.attribute,
)
DATAREFS = ScenarioField(
    key='datarefs', attribute='datarefs', title='datarefs of X-Plane', kind=Kind.DOCUMENT,
    catalogue=DATAREF_SETS, absent=DATAREF_SETS.default,
)
DURATION = ScenarioField(
    key='duration_s', short='duration', attribute='duration_s',
    title='duration', unit='s', low=0.1, high=600.0, si_unit='s',
)
PLACE = ScenarioField(
    key='place', attribute='place', title='place', kind=Kind.DOCUMENT, catalogue=PLACES,
    absent=PLACES.default,
)

PAPER_FIELDS = (CROSS_TRACK, DISTANCE, HEADING, SKY, RAIN, TIME_OF_DAY)
"""The six dimensions of the paper's feature space."""
PUSHING_FIELDS = (WIND_SPEED, WIND_DIRECTION, GUST, GUST_SEED, RUNWAY_STATE, SLOPE, SPEED)
"""Fields that affect the aircraft's motion but not the image."""
PICTURE_FAULTS = (
    CAMERA_DROPOUT, CAMERA_FREEZE, LENS_DIRT, LENS_DROPS, GLARE_GHOST, EXPOSURE_JUMP,
)
"""Faults that change camera frames."""
FAULTS = (*PICTURE_FAULTS, LOOP_DELAY, LOOP_JITTER, STEERING_BIAS, STEERING_RATE_LIMIT)
"""Faults of sensors, computers and actuators; 0: none."""
DRAWN_FAULTS = (CAMERA_DROPOUT, LENS_DIRT, LENS_DROPS, LOOP_JITTER)
"""Faults that the seed of the faults determines."""
FAULT_FIELDS = (*FAULTS, FAULT_ONSET, FAULT_SEED)
SCENARIO_FIELDS = (
    *PAPER_FIELDS, DATE, SHADOWS, CROSSING, AIRCRAFT_MODEL, *PUSHING_FIELDS, TRACK, *FAULT_FIELDS,
    TRAFFIC, CAMERA, *CAMERA_OFFSETS, SENSORS, *GNSS_FIELDS, CONTROL_RATE,
    DATAREFS, DURATION, PLACE,
)
MESSAGE_FIELDS = tuple(field for field in SCENARIO_FIELDS if not field.carrier)
"""Fields of the scenario message."""
class _Fields(dict[str, ScenarioField]):
    """Fields by key; it also has the control points of those that may change within a run."""

    def __missing__(self, name: str) -> ScenarioField:
        key, part = split_point(name)
        field = self.get(key) if part else None
        if field is None or not field.varies:
            raise KeyError(name)
        assert isinstance(field, ScenarioField)
        if part == FORM:
            return ScenarioField(
                key=name, attribute=name, title=f'form of {field.title}', kind=Kind.WORD,
                words=FORMS if field.kind is Kind.NUMBER else (CONSTANT,),
            )
        return dataclasses.replace(
            field, key=name, attribute=name, short=f'{field.label} at {part} s',
            title=f'{field.title} at {part} s', varies=False,
        )

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self.get(name) is not None

    def get(self, name: str, default: Any = None) -> Any:
        """As in a dictionary."""
        try:
            return self[name]
        except KeyError:
            return default


BY_KEY = _Fields({field.key: field for field in SCENARIO_FIELDS})
HUMAN_KEYS = tuple(BY_KEY)
"""User-facing scenario keys."""
SHORT_FORMS = {field.short: field.key for field in SCENARIO_FIELDS if field.short}
"""Key by its short form, which input accepts and older files use."""

CATALOGUES = {
    field.key: field.catalogue for field in SCENARIO_FIELDS if field.catalogue is not None
}
"""Lookup of documents by scenario key; each such attribute has the name of its key."""

PLANE_KEYS = tuple(field.key for field in SCENARIO_FIELDS if field.plane)
"""Keys that a Scenic program says by the place of its aircraft, which has these properties."""
PARAMETERS = tuple(field.key for field in SCENARIO_FIELDS if not field.plane)
"""Keys that a Scenic program says as global parameters."""

_Value = TypeVar('_Value')


def by_key(values: Mapping[str, _Value]) -> dict[str, _Value]:
    """The same values with short forms spelled out; names that are no keys stay as they are.

    Raises:
        UsageError: a key is there with its short form too, or a control point that cannot be.
    """
    found: dict[str, _Value] = {}
    names: dict[str, str] = {}
    for name, value in values.items():
        key = full_key(name)
        if key in names:
            one, other = sorted((name, names[key]), key=len)
            raise UsageError(f'scenario: {one} and {other} are the same; leave one out')
        found[key], names[key] = value, name
    return found


def full_key(name: str) -> str:
    """A key with its short form spelled out; a name that is no key stays as it is.

    Raises:
        UsageError: a control point that cannot be.
    """
    return _point_key(name) if _AT in name else SHORT_FORMS.get(name, name)


def split_point(name: str) -> tuple[str, str]:
    """Key, and time or ``form``, of a control point; '' for what is none."""
    key, _, part = name.partition(_AT)
    return key, part


def is_point(name: str) -> bool:
    """Whether a name is the key of a control point, or of the form of a signal."""
    return _AT in name and name in BY_KEY


def _point_key(name: str) -> str:
    """Key of a control point as in tables; what begins with no key of ours stays as it is."""
    key, part = split_point(name)
    key = SHORT_FORMS.get(key, key)
    if key not in BY_KEY:
        return name
    if not BY_KEY[key].varies:
        known = ', '.join(field.key for field in SCENARIO_FIELDS if field.varies)
        raise UsageError(f'scenario: {name}: {key} cannot change within a run; what can: {known}')
    if part == FORM:
        return f'{key}{_AT}{FORM}'
    try:
        time_s = typed_number(part, 's') or float(part)
    except ValueError:
        time_s = math.nan
    if time_s == 0:
        raise UsageError(f'scenario: {name}: the value at 0 s is {key} itself')
    if not 0 < time_s <= DURATION.high:
        raise UsageError(
            f'scenario: {name}: expected {key}@SECONDS up to {DURATION.high:g}, as in {key}@10, or '
            f'{key}@{FORM}'
        )
    return f'{key}{_AT}{round(time_s, _DECIMALS):.12g}'


def by_value(values: Mapping[str, Any]) -> dict[str, Any]:
    """What texts for scenario keys stand for, to compare them: 1 and 1.0 are the same duration.

    Numbers are in SI units; documents and what is no value of its key stay as they are.
    """
    found = by_key(values)
    for name, value in found.items():
        if name in BY_KEY and BY_KEY[name].catalogue is None:
            with contextlib.suppress(UsageError):
                found[name] = BY_KEY[name].from_human(value)
    return found
