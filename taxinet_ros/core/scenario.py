"""One test case: a point in the paper's six-dimensional feature space, with its settings.

Internally a scenario is in SI units; user interfaces (Scenic programs, command line, tables) use
metres, degrees, percent and hours. :func:`scenario_from_human` converts them; ranges, units and
words of the values are in :mod:`taxinet_ros.core.scenario_fields`.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taxinet_ros.arguments import told
from taxinet_ros.core.datarefs import NO_DATAREFS, Number, find_datarefs
from taxinet_ros.core.place.catalogue import DEFAULT_PLACE, find_place, find_track
from taxinet_ros.core.place.place import AirportGround
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import RUNWAY_TRACK, Track
from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.rig.camera_model import (
    LEAST_HEIGHT_M,
    CameraModel,
    moved_camera,
    rotation,
)
from taxinet_ros.core.rig.catalogue import (
    DEFAULT_AIRCRAFT,
    DEFAULT_CAMERA,
    find_aircraft,
    find_camera,
)
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    CAMERA,
    CAMERA_OFFSETS,
    CONTROL_RATE,
    CONTROL_RATES_HZ,
    CROSS_TRACK,
    CROSSING,
    DATAREFS,
    DISTANCE,
    DRAWN_FAULTS,
    FAULT_ONSET,
    FAULT_SEED,
    FAULTS,
    GNSS_DROPOUT_START,
    GNSS_FIELDS,
    GUST,
    HUMAN_KEYS,
    MESSAGE_FIELDS,
    PLACE,
    RAIN_CLOUDS,
    RUNWAY_STATE,
    SCENARIO_FIELDS,
    SENSORS,
    TRACK,
    WIND_DIRECTION,
    WIND_SPEED,
    ScenarioField,
    along_words,
    by_key,
    is_point,
)
from taxinet_ros.core.sensors import NO_SENSORS, Sensors, find_sensors
from taxinet_ros.core.signals import (
    VARYING,
    checked_signals,
    kept_signals,
    points_of,
    signals_of,
)
from taxinet_ros.core.traffic.traffic import HOLD_LINE, NOBODY, Traffic
from taxinet_ros.core.traffic.traffic_file import find_traffic
from taxinet_ros.core.types import NS_PER_S, run_length_ns
from taxinet_ros.errors import UsageError, near_miss
from taxinet_ros.files.pages import html_table
from taxinet_ros.files.plain_values import load_json

_WITH_SENSORS = '{"camera":'
"""How the camera's text begins in recordings of scenes with more than a camera, which it
carries."""
_ACROSS_RAD = math.radians(45)
"""Farthest turned from the track's direction a hold line may be."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """Initial condition and environment of one run, validated on construction.

    >>> import taxinet_ros as tx
    >>> tx.Scenario(cross_track_m=3.0, time_of_day_h=9.5, heading_deg=-10).clouds
    'clear'
    >>> tx.Scenario(rain_fraction=2.0)
    Traceback (most recent call last):
    ...
    taxinet_ros.errors.UsageError: scenario: rain_fraction is 2, outside 0..1 as a fraction

    Attributes:
        cross_track_m: start cross-track error [m], left positive.
        distance_m: start distance along the track [m]: past the threshold, on the runway's
            centreline.
        heading_rad: start heading error [rad], nose left positive.
        clouds: one of ``scenario_fields.CLOUDS``.
        rain_fraction: intensity, 0..1; more than 0 only under
            ``scenario_fields.RAIN_CLOUDS``.
        time_of_day_s: local time since midnight [s].
        date: ISO date of the sun's position; near an equinox 6-18 h is daylight.
        shadows: whether the aircraft casts a shadow (the paper's confirmation experiment).
        crossing: whether the crossing runway exists (KMWH: near 1,450 m); without it pavement and
            paint are continuous. Always False at a place without a crossing.
        aircraft: a shipped name, or the whole aircraft as JSON, see
            :mod:`taxinet_ros.core.rig.aircraft_model`.
        wind_speed_mps: mean wind [m/s].
        wind_direction_rad: direction the wind blows from [rad], clockwise from true north.
        gust_mps: standard deviation of the turbulence in each horizontal direction [m/s], see
            :mod:`taxinet_ros.core.motion.gusts`.
        gust_seed: random seed of the gusts; a whole number.
        runway_state: friction, one of ``scenario_fields.RUNWAY_STATES``.
        slope_fraction: rise of the runway divided by its length, uphill ahead positive.
        speed_mps: initial speed [m/s]; the steering law holds it unless its gain ``speed_mps``
            differs from the default.
        track: the line to follow: ``runway``, its centreline, or the name of another one of the
            place; also taxi routes of these names, ``A+B``. Empty is ``runway``.
        camera_dropout_fraction: share of the camera frames that are lost, 0..1; black.
        camera_freeze_s: time for which the picture at the onset repeats [s].
        lens_dirt_fraction, lens_drops_fraction: share of the picture covered, 0..1.
        glare_ghost_fraction: strength of the reflections within the lens of a sun ahead, 0..1.
        exposure_jump_ev: change of the exposure [EV], brighter positive.
        loop_delay_s: additional time from a frame to the effect of its command [s].
        loop_jitter_s: greatest random part of that time, uniform from 0 [s].
        steering_bias_rad: offset of the nose wheel from the command [rad], left positive.
        steering_rate_limit_radps: greatest rate of the nose wheel [rad/s]; 0 for no limit.
        fault_onset_s: simulated time from which the faults of this run hold [s].
        fault_seed: random seed of the faults; a whole number.
        traffic: others on the ground: ``nobody``, or a list as JSON, see
            :mod:`taxinet_ros.core.traffic`.
        camera: a shipped name, or the whole camera as JSON, see
            :mod:`taxinet_ros.core.rig.camera_model`; of a moved one its base, and the offsets in
            the next six.
        camera_dx_m, camera_dy_m, camera_dz_m: the camera's offset forward, to the left and up [m].
        camera_droll_rad, camera_dpitch_rad, camera_dyaw_rad: added to its angles [rad]: right side
            down, nose down, left positive.
        sensors: ``none``, a shipped name, or the sensors beside the camera as JSON, see
            :mod:`taxinet_ros.core.sensors`.
        gnss_noise_m, gnss_bias_m: of the GNSS in place of its own, 0 for its own [m].
        gnss_dropout_start_s, gnss_dropout_s: a drop-out of the GNSS beside its own [s].
        control_rate_hz: rate of frames, estimates, commands and samples [Hz], one of
            ``scenario_fields.CONTROL_RATES_HZ``.
        datarefs: ``none``, or values of X-Plane's datarefs as JSON, see
            :mod:`taxinet_ros.core.datarefs`.
        duration_s: length of the run [s], a multiple of the control period.
        place: a shipped name, or the whole place as JSON, see
            :mod:`taxinet_ros.core.place.catalogue`.
        signals: '', or the later values of what changes within the run as JSON, see
            :mod:`taxinet_ros.core.signals`; also ``Scenario(**{'wind_speed_mps@10': 8})``.

    Raises:
        UsageError: a value is out of range, not finite, or an unknown word.
    """

    cross_track_m: float = 0.0
    distance_m: float = 400.0
    heading_rad: float = 0.0
    clouds: str = 'clear'
    rain_fraction: float = 0.0
    time_of_day_s: float = 12 * 3600.0
    date: str = '2020-03-20'
    shadows: bool = True
    crossing: bool = True
    aircraft: str = DEFAULT_AIRCRAFT
    wind_speed_mps: float = 0.0
    wind_direction_rad: float = 0.0
    gust_mps: float = 0.0
    gust_seed: float = 0.0
    runway_state: str = 'dry'
    slope_fraction: float = 0.0
    speed_mps: float = 5.0
    track: str = RUNWAY_TRACK
    camera_dropout_fraction: float = 0.0
    camera_freeze_s: float = 0.0
    lens_dirt_fraction: float = 0.0
    lens_drops_fraction: float = 0.0
    glare_ghost_fraction: float = 0.0
    exposure_jump_ev: float = 0.0
    loop_delay_s: float = 0.0
    loop_jitter_s: float = 0.0
    steering_bias_rad: float = 0.0
    steering_rate_limit_radps: float = 0.0
    fault_onset_s: float = 0.0
    fault_seed: float = 0.0
    traffic: str = NOBODY
    camera: str = DEFAULT_CAMERA
    camera_dx_m: float = 0.0
    camera_dy_m: float = 0.0
    camera_dz_m: float = 0.0
    camera_droll_rad: float = 0.0
    camera_dpitch_rad: float = 0.0
    camera_dyaw_rad: float = 0.0
    sensors: str = NO_SENSORS
    gnss_noise_m: float = 0.0
    gnss_bias_m: float = 0.0
    gnss_dropout_start_s: float = 0.0
    gnss_dropout_s: float = 0.0
    control_rate_hz: float = 10.0
    datarefs: str = NO_DATAREFS
    duration_s: float = 30.0
    place: str = DEFAULT_PLACE
    signals: str = ''

    def __post_init__(self) -> None:
        PLACE.checked(self.place)
        self._take_sensors_apart()
        self._take_camera_apart()
        self._take_signals_apart()
        object.__setattr__(self, TRACK.attribute, TRACK.checked(self.track) or RUNWAY_TRACK)
        line = self.line
        limits = {
            CROSS_TRACK.key: (-line.farthest_start_m, line.farthest_start_m),
            DISTANCE.key: (0.0, line.last_start_m),
        }
        for field in SCENARIO_FIELDS:
            value = self._checked(field, limits.get(field.key))
            if field.carrier:  # as its document has it, so that reading it back gives the same
                value = field.from_human(field.to_human(value))
            object.__setattr__(self, field.attribute, value)
        if self.control_rate_hz not in CONTROL_RATES_HZ:
            raise UsageError(
                f'scenario: control_rate_hz is {self.control_rate_hz:g}, not one of '
                f'{", ".join(map(str, CONTROL_RATES_HZ))}: a period has to be a whole number of '
                'physics steps, 1/120 s'
            )
        if not self.runway.crossings:
            object.__setattr__(self, 'crossing', False)
        if self.rain_fraction > 0 and self.clouds not in RAIN_CLOUDS:
            kinds = '/'.join(RAIN_CLOUDS)
            raise UsageError(f'scenario: rain needs clouds {kinds}, got {self.clouds!r}')
        object.__setattr__(self, 'signals', checked_signals(self.points, self.duration_s))
        if self.ever(WIND_DIRECTION) and not self.ever(WIND_SPEED):
            raise UsageError('scenario: wind_direction_deg has no effect without wind_speed_mps')
        if self.gust_seed and not self.ever(GUST):
            raise UsageError('scenario: gust_seed has no effect without gust_mps')
        self._check_aircraft()
        if self.gust_seed % 1:
            raise UsageError(f'scenario: gust_seed is {self.gust_seed:g}, not a whole number')
        self._check_faults()
        self._check_sensors()
        self._check_hold_lines()

    def _take_sensors_apart(self) -> None:
        """Replace a recorded camera that carries sensors and the control rate by all of them."""
        if not str(self.camera).startswith(_WITH_SENSORS):
            return
        try:
            carried = load_json(self.camera)
            values = {key: carried[key] for key in (CAMERA.key, SENSORS.key)}
            values |= {
                field.key: carried.get(field.key, field.absent)
                for field in (*GNSS_FIELDS, CONTROL_RATE)
            }
        except (KeyError, TypeError, ValueError):
            raise UsageError(
                f'scenario: camera is {self.camera!r:.60}, not a camera with sensors') from None
        for key, value in values.items():
            object.__setattr__(self, key, value)

    def _check_sensors(self) -> None:
        given = [field.key for field in GNSS_FIELDS if getattr(self, field.attribute)]
        if given and find_sensors(self.sensors).gnss is None:
            raise UsageError(
                f'scenario: {given[0]} has no effect without a gnss among the sensors; set the key '
                'sensors, as in sensors=standard'
            )
        second = find_sensors(self.sensors).camera
        if second is not None and self.control_rate_hz % second.rate_hz:
            raise UsageError(
                f'scenario: sensors: camera.rate_hz is {second.rate_hz}, not a divisor of '
                f'control_rate_hz, which is {self.control_rate_hz:g}'
            )
        if self.gnss_dropout_start_s and not self.gnss_dropout_s:
            raise UsageError(
                f'scenario: {GNSS_DROPOUT_START.key} has no effect without gnss_dropout_s')

    def _check_hold_lines(self) -> None:
        line = self.line
        for one in self.others.hold_lines:
            _, cte_m, he_rad = line.measure(one.x_m, one.y_m, one.pose_at(0).heading_rad)
            he_rad = math.remainder(he_rad, math.tau)
            where = f'scenario: traffic: the {HOLD_LINE} at x_m {one.x_m:g}, y_m {one.y_m:g}'
            if abs(cte_m) > line.half_width_m:
                raise UsageError(
                    f'{where} has no effect: it is {abs(cte_m):.1f} m beside the track '
                    f'{line.name}, which is {line.half_width_m:g} m wide to either side; place it '
                    'there, or leave it out'
                )
            if abs(he_rad) > _ACROSS_RAD:
                raise UsageError(
                    f'{where} holds who comes from another side: it faces '
                    f'{math.degrees(abs(he_rad)):.0f} deg away from where the track {line.name} '
                    f'goes; heading_deg there is {one.heading_deg - math.degrees(he_rad):.0f}'
                )

    def _take_camera_apart(self) -> None:
        """Replace a moved camera by its base and its offsets."""
        camera = find_camera(CAMERA.checked(self.camera))
        if camera.base is None:
            return
        for field, offset in zip(CAMERA_OFFSETS, camera.offsets, strict=True):
            if offset and getattr(self, field.attribute):
                raise UsageError(
                    f'scenario: {field.key} is given twice: the camera has an offset of its own'
                )
            if offset:
                object.__setattr__(self, field.attribute, field.from_human(offset))
        object.__setattr__(self, CAMERA.attribute, camera.base.text)

    def _take_signals_apart(self) -> None:
        """Split datarefs as the message has them from the control points that they carry."""
        if not isinstance(self.signals, str):
            raise UsageError(f'scenario: signals is {told(self.signals)}, not a text')
        if '@' not in str(self.datarefs) or not str(self.datarefs).startswith('{'):
            return
        try:
            values = dict(load_json(self.datarefs))
        except (TypeError, ValueError):
            return  # which is refused as no datarefs
        points = {name: values.pop(name) for name in list(values) if is_point(name)}
        object.__setattr__(self, DATAREFS.attribute, json.dumps(values) if values else NO_DATAREFS)
        object.__setattr__(self, 'signals', json.dumps({**self.points, **points}))

    def _check_faults(self) -> None:
        if self.fault_onset_s and not self.faults:
            raise UsageError(
                'scenario: fault_onset_s has no effect without a fault: '
                + ', '.join(field.key for field in FAULTS)
            )
        if self.fault_onset_s >= self.duration_s:
            raise UsageError(
                f'scenario: fault_onset_s is {self.fault_onset_s:g}, not before the end of the run '
                f'at {self.duration_s:g} s'
            )
        drawn = self.sensors != NO_SENSORS or any(one in DRAWN_FAULTS for one in self.faults)
        if self.fault_seed and not drawn:
            raise UsageError(
                'scenario: fault_seed has no effect without a fault that is drawn: '
                + ', '.join(field.key for field in DRAWN_FAULTS)
            )
        if self.fault_seed % 1:
            raise UsageError(f'scenario: fault_seed is {self.fault_seed:g}, not a whole number')

    def _check_aircraft(self) -> None:
        model, stamps_ns = self.aircraft_model, [0]
        if self.signals and model.most_wind_mps < math.inf:
            stamps_ns += range(0, self.duration_ns + 1, NS_PER_S // 10)
        strongest_mps = max(
            self.at(WIND_SPEED, stamp) + 3 * self.at(GUST, stamp) for stamp in stamps_ns
        )
        if strongest_mps > model.most_wind_mps:
            raise UsageError(
                f'scenario: aircraft {model.name}: wind_speed_mps + 3 gust_mps is '
                f'{strongest_mps:g}, more than {model.most_wind_mps:g}: the wind would lift the '
                'model'
            )
        low_mps, high_mps = model.taxi_speed_mps
        if not low_mps <= self.speed_mps <= high_mps:
            raise UsageError(
                f'scenario: aircraft {model.name}: speed_mps is {self.speed_mps:g}, it taxis at '
                f'{low_mps:g} to {high_mps:g}'
            )
        cameras = self.cameras  # refuses offsets that turn one too far
        if model.settled is not None:  # else when it has been measured
            for camera in cameras:
                check_camera_height(camera, model)

    def _checked(self, field: ScenarioField, limits: tuple[float, float] | None) -> Any:
        if field is DISTANCE and not self.line.is_runway:
            field = replace(field, counted=f' {along_words(self.track)}')
        try:
            return field.checked(getattr(self, field.attribute), limits)
        except UsageError as error:
            usual = self.place == DEFAULT_PLACE and self.line.is_runway
            if limits is None or usual:
                raise
            where = '' if self.line.is_runway else f'track {self.track} of '
            short = field is DISTANCE and not where
            hint = '; the program anywhere has starts for any runway' if short else ''
            raise UsageError(
                f'{error}, at {where}{find_place(self.place).reference}{hint}') from None

    @property
    def runway(self) -> Runway:
        """Runway of the place."""
        return find_place(self.place).runway

    @property
    def airport(self) -> AirportGround | None:
        """Pavements and lines of the place beside the runway, if known."""
        return find_place(self.place).ground

    @property
    def line(self) -> Track:
        """The track that it follows."""
        return find_track(self.place, self.track)

    @property
    def others(self) -> Traffic:
        """Others on the ground."""
        return find_traffic(self.traffic)

    @property
    def hold_lines(self) -> tuple[tuple[float, float], ...]:
        """Of each hold line the distance along the track [m] and when it is cleared [ns]."""
        line = self.line
        return tuple(sorted(
            (line.measure(one.x_m, one.y_m).distance_m, one.until_ns)
            for one in self.others.hold_lines
        ))

    @property
    def aircraft_model(self) -> AircraftModel:
        """Its aircraft."""
        return find_aircraft(self.aircraft)

    @property
    def camera_model(self) -> CameraModel:
        """Its camera, where the offsets move it."""
        camera, offsets = find_camera(self.camera), [
            (field, getattr(self, field.attribute)) for field in CAMERA_OFFSETS
        ]
        if not any(value for _, value in offsets):
            return camera
        return moved_camera(camera, tuple(field.to_human(value) for field, value in offsets))

    @property
    def rig(self) -> Rig:
        """Its camera and aircraft together."""
        return Rig(camera=self.camera_model, aircraft=self.aircraft_model)

    @property
    def cameras(self) -> tuple[CameraModel, ...]:
        """Its camera, and the second one if its sensors have one."""
        second = find_sensors(self.sensors).camera
        return (self.camera_model,) if second is None else (self.camera_model, second.mount)

    @property
    def sensor_set(self) -> Sensors:
        """Its sensors beside the camera, with its noise, bias and drop-out of the GNSS."""
        return find_sensors(self.sensors).with_gnss(
            noise_m=self.gnss_noise_m, bias_m=self.gnss_bias_m,
            start_s=self.gnss_dropout_start_s, length_s=self.gnss_dropout_s,
        )

    @property
    def dataref_values(self) -> Mapping[str, Number]:
        """Its datarefs, by name."""
        return find_datarefs(self.datarefs).values

    @property
    def duration_ns(self) -> int:
        """Length of the run in integer nanoseconds."""
        return run_length_ns(self.duration_s, self.period_ns)

    @property
    def period_ns(self) -> int:
        """Time between two control steps [ns], rounded down; see :func:`.types.step_stamp_ns`."""
        return int(NS_PER_S // self.control_rate_hz)

    @property
    def points(self) -> Mapping[str, Any]:
        """Its control points after the start, in human units."""
        return points_of(self.signals)

    def at(self, field: ScenarioField, stamp_ns: int) -> Any:
        """The value of a key at a simulated time, in SI units."""
        start = getattr(self, field.attribute)
        signal = signals_of(self.signals).get(field.key) if self.signals else None
        return start if signal is None else signal.at(start, stamp_ns)

    def ever(self, field: ScenarioField) -> bool:
        """Whether a key has an effect at any time: it is not 0 at a control point."""
        signal = signals_of(self.signals).get(field.key) if self.signals else None
        return any((getattr(self, field.attribute), *(() if signal is None else signal.values)))

    def without_signals(self, *fields: ScenarioField) -> str:
        """Its ``signals`` without those of some keys."""
        return kept_signals(self.signals, [field for field in VARYING if field not in fields])

    @property
    def windy(self) -> bool:
        """Whether there is any wind at any time."""
        return self.ever(WIND_SPEED) or self.ever(GUST)

    @property
    def pushed(self) -> bool:
        """Whether wind, slope or reduced friction affect the aircraft."""
        return self.windy or bool(self.slope_fraction) or self.surface != 'dry' or bool(
            kept_signals(self.signals, [RUNWAY_STATE])
        )

    @property
    def faults(self) -> tuple[ScenarioField, ...]:
        """The faults that it has."""
        return tuple(field for field in FAULTS if self.ever(field))

    def without_faults(self, *fields: ScenarioField) -> Scenario:
        """The same without some of its faults, and without an onset or a seed of none."""
        changes: dict[str, Any] = {field.attribute: 0.0 for field in fields}
        changes['signals'] = self.without_signals(*fields)
        left = [field for field in self.faults if field not in fields]
        if not left:
            changes[FAULT_ONSET.attribute] = 0.0
        if self.sensors == NO_SENSORS and not any(field in DRAWN_FAULTS for field in left):
            changes[FAULT_SEED.attribute] = 0.0
        return dataclasses.replace(self, **changes)

    def without_sensors(self) -> Scenario:
        """The same without sensors beside the camera."""
        if self.sensors == NO_SENSORS:
            return self
        changes: dict[str, Any] = {one.attribute: one.absent for one in (SENSORS, *GNSS_FIELDS)}
        if not any(one in DRAWN_FAULTS for one in self.faults):
            changes[FAULT_SEED.attribute] = 0.0
        return dataclasses.replace(self, **changes)

    @property
    def surface(self) -> str:
        """Runway condition at the start: ``runway_state`` with ``auto`` resolved."""
        return self.surface_at(0)

    def surface_at(self, stamp_ns: int) -> str:
        """Runway condition at a simulated time."""
        state: str = self.at(RUNWAY_STATE, stamp_ns)
        if state == 'auto':
            return 'wet' if self.rain_fraction > 0 else 'dry'
        return state

    def recorded(self) -> dict[str, Any]:
        """Values by field of its message, where a text also carries what has no field.

        That of the camera carries its offsets, the sensors and the control rate, that of the
        datarefs the control points.
        """
        values = {field.attribute: getattr(self, field.attribute) for field in MESSAGE_FIELDS}
        if self.signals:
            values[DATAREFS.attribute] = json.dumps({**self.dataref_values, **self.points})
        camera = self.camera_model.text
        given = {
            one.key: value for one in (*GNSS_FIELDS, CONTROL_RATE)
            if (value := getattr(self, one.key)) != one.absent
        }
        if self.sensors != NO_SENSORS or given:
            # Not sorted: _WITH_SENSORS is its beginning.
            camera = json.dumps(
                {CAMERA.key: camera, SENSORS.key: self.sensors, **given}, separators=(',', ':'))
        return {**values, CAMERA.attribute: camera}

    def __repr__(self) -> str:
        """What differs from the defaults, in SI units."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)
                  if getattr(self, field.name) != field.default}
        return f'Scenario({", ".join(f"{name}={value!r}" for name, value in values.items())})'

    def _repr_html_(self) -> str:
        """The same as a table, in the units of the command line."""
        usual = Scenario().to_human()
        return html_table('Scenario', {
            BY_KEY[key].title: BY_KEY[key].value_words(value)
            for key, value in self.to_human().items() if value != usual.get(key)
        })

    @property
    def recorded_text(self) -> str:
        """All values as recorded: that of scenes without offsets is as it was before these."""
        values = ', '.join(f'{name}={value!r}' for name, value in self.recorded().items())
        return f'Scenario({values})'

    @property
    def digest(self) -> str:
        """Key of this scenario in records of earlier runs: equal for equal scenarios only."""
        return hashlib.sha256(self.recorded_text.encode()).hexdigest()[:32]

    def to_human(self) -> dict[str, Any]:
        """The scenario in user-facing units; the inverse of :func:`scenario_from_human`."""
        return {
            **{field.key: field.to_human(getattr(self, field.attribute))
               for field in SCENARIO_FIELDS},
            **self.points,
        }


_ATTRIBUTES = frozenset(field.name for field in dataclasses.fields(Scenario))
_init = Scenario.__init__


@functools.wraps(_init)
def _init_in_any_units(self: Scenario, **values: Any) -> None:
    """Take values also by the keys, and in the units, of the command line."""
    given = {name: value for name, value in values.items() if name in _ATTRIBUTES}
    points: dict[str, Any] = {}
    for key, value in by_key({
        name: value for name, value in values.items() if name not in _ATTRIBUTES
    }).items():
        field = BY_KEY.get(key)
        if field is None:
            near = near_miss(key, (*_ATTRIBUTES, *BY_KEY))
            raise UsageError(f'scenario: unknown key {key!r}{near}; known: {", ".join(HUMAN_KEYS)}')
        if is_point(key):
            points[key] = field.to_human(field.from_human(value))
            continue
        if field.attribute in given:
            raise UsageError(f'scenario: {key} is given twice, also as {field.attribute}')
        given[field.attribute] = field.from_human(value)
    if points:
        given['signals'] = json.dumps({**points_of(given.get('signals', '')), **points})
    _init(self, **given)


# On the class itself, so that dataclasses.replace and copies take such values, too.
Scenario.__init__ = _init_in_any_units  # type: ignore[method-assign]


def check_camera_height(camera: CameraModel, model: AircraftModel) -> None:
    """Refuse a camera below the ground on an aircraft whose attitude is known.

    Raises:
        UsageError: it would be there.
    """
    settled = model.settled
    assert settled is not None
    turn = rotation(settled.roll_rad, settled.pitch_rad, 0.0)
    height_m = settled.z_m + float(turn[2] @ np.array(camera.offset_m))
    if height_m < LEAST_HEIGHT_M:
        raise UsageError(
            f'scenario: camera {camera.name} on aircraft {model.name} is {height_m:.2f} m above '
            f'the ground, expected {LEAST_HEIGHT_M:g} or more'
        )


def scenario_from_human(values: Mapping[str, Any]) -> Scenario:
    """Build a scenario from user-facing units (m, degrees, percent, hours).

    Args:
        values: values by key or its short form (:mod:`taxinet_ros.core.scenario_fields`).

    Raises:
        UsageError: an unknown key (the known ones are listed), a key given together with its short
            form, or an invalid value; errors use the user's units.
    """
    values = by_key(values)
    unknown = [key for key in values if key not in BY_KEY]
    if unknown:
        raise UsageError(
            f'scenario: unknown key {unknown[0]!r}{near_miss(unknown[0], BY_KEY)}; '
            f'known: {", ".join(HUMAN_KEYS)}'
        )
    scenario = Scenario(**{
        BY_KEY[key].attribute: value if is_point(key) else BY_KEY[key].from_human(value)
        for key, value in values.items()
    })
    wanted = CROSSING.from_human(values.get(CROSSING.key, False))
    if wanted and not scenario.crossing:
        place = find_place(scenario.place).reference
        raise UsageError(f'scenario: crossing has no effect at {place}: no runway crosses it')
    return scenario
