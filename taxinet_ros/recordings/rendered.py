"""The recorded poses in our world: a network on rendered frames, beside the recorded ones."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.camera.light import sun_position
from taxinet_ros.core.motion.aircraft import measured_model
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS, clock_words
from taxinet_ros.core.types import NS_PER_S, AircraftState
from taxinet_ros.errors import UsageError
from taxinet_ros.recordings.frames import dated, estimates_of, local_time, prepared
from taxinet_ros.recordings.score import Picture, Score, row_pictures, sliced, spread

MOST_FRAMES = 300
_PAIRS = 4
_CLOUD = re.compile(r'(FEW|SCT|BKN|OVC|VV)(\d{3}|///)(?:CB|TCU)?')
_RAIN = re.compile(r'([-+]?)(?:VC|SH|TS|FZ|DZ)*(RA|DZ)(?:[A-Z]{2})*')
_UNSHOWN = re.compile(r'[-+]?(?:VC|BL|DR|FZ|MI|BC|PR|SH|TS)*(SN|SG|FG|BR|HZ|DU|SA|FU|GR|GS|PL|IC)+')
_CLEAR = {'CAVOK', 'SKC', 'CLR', 'NSC', 'NCD'}
_RAIN_PERCENT = {'-': 20.0, '': 50.0, '+': 90.0}
_DUSK_RAD, _BRIGHT = math.radians(-6), 60
"""Elevation of the sun below which it is night, and mean grey level that night does not have."""
_HIGH, _LOW = 200, 10
"""Bases of clouds [100 ft] from which they are cirrus, and below which an overcast is stratus."""


def metar_weather(text: str) -> tuple[dict[str, Any], list[str]]:
    """Clouds and rain of a METAR as scenario values, and what of it our world does not show.

    Raises:
        UsageError: it says nothing of clouds.
    """
    clouds, rain, unshown = '', 0.0, []
    for word in text.upper().partition(' RMK')[0].split():
        if word in _CLEAR:
            clouds = clouds or 'clear'
        elif found := _CLOUD.fullmatch(word):
            base = int(found[2]) if found[2].isdecimal() else 0
            kind = {'BKN': 'broken', 'OVC': 'overcast', 'VV': 'stratus'}.get(found[1], 'scattered')
            if kind == 'scattered' and base >= _HIGH:
                kind = 'cirrus'
            elif kind == 'overcast' and base < _LOW:
                kind = 'stratus'
            clouds = max(clouds or 'clear', kind, key=CLOUDS.index)
        elif found := _RAIN.fullmatch(word):
            rain = max(rain, _RAIN_PERCENT[found[1]] * (0.5 if found[2] == 'DZ' else 1.0))
        elif _UNSHOWN.fullmatch(word):
            unshown.append(word)
    if not clouds:
        raise UsageError(f'metar {text!r:.60}: names no clouds; expected such as BKN040 or CLR')
    if rain and clouds not in RAIN_CLOUDS:
        clouds = RAIN_CLOUDS[0]
    return {'clouds': clouds, 'rain_percent': rain}, unshown


def start_scenario(found: Score, settings: Mapping[str, Any]) -> Scenario:
    """The scenario in which the recording began: start, place, rig, date and hour.

    Args:
        found: the score.
        settings: values by key in human units, over those of the recording.

    Raises:
        UsageError: a value is invalid, the camera is unknown, or others react to the aircraft.
    """
    setup, at = found.setup, found.table[found.scored].iloc[0].to_dict()
    if setup.rig is None:
        raise UsageError('simulate: needs to know the camera; describe it in a camera file')
    own = found.scenario
    line, kept = setup.track, {} if own is None else own.to_human()
    limits = (
        ('cross_track_m', 'cte_m', -line.farthest_start_m, line.farthest_start_m),
        ('heading_deg', 'heading_error_deg', -89.0, 89.0),
        ('distance_m', 'distance_m', 0.0, line.last_start_m),
        ('speed_mps', 'speed_mps', *setup.rig.aircraft.taxi_speed_mps),
    )
    values: dict[str, Any] = {
        'place': setup.place.text, 'track': line.name, 'camera': setup.rig.camera.text,
        'aircraft': setup.rig.aircraft.text, **{
            name: float(np.clip(at[column], low, high)) for name, column, low, high in limits},
    }
    if own is None and dated(np.array([at['stamp_ns']])):
        values['date'], time_s = local_time(int(at['stamp_ns']), setup.place.runway)
        values['time_of_day_h'] = time_s / 3600
    offsets = {key: 0.0 for key in kept if key.startswith('camera_d')}
    scenario = scenario_from_human({**kept, **offsets, **values, **settings})
    if reacting := scenario.others.reacting:
        raise UsageError(f'simulate: {reacting}, which only a run shows; set traffic=nobody')
    return scenario


def _night_notes(scenario: Scenario, brightness: float) -> list[str]:
    """A line if it is night in our world, but not in the recorded pictures."""
    _, elevation_rad = sun_position(scenario.date, scenario.time_of_day_s, scenario.runway)
    if elevation_rad > _DUSK_RAD or brightness < _BRIGHT:
        return []
    clock = clock_words(scenario.time_of_day_s / 3600)
    return [
        f'simulate: on {scenario.date} at {clock} the sun is '
        f'{-math.degrees(elevation_rad):.0f} deg below the horizon, but the recorded pictures are '
        f'bright (mean grey {brightness:.0f}): stamps in local time instead of UTC, the '
        'time_zone of the place, or the date; set what it was: time_of_day=HH:MM, '
        'date=YYYY-MM-DD']


def render_beside(found: Score, scenario: Scenario) -> None:
    """Render the poses of up to :data:`MOST_FRAMES` scored frames; show them to the network.

    The score gets the start, the gap and some pairs of pictures, and its table the estimates in
    columns ``rendered_est_…``.

    Args:
        found: the score.
        scenario: of the rendered frames.
    """
    rows, table = spread(found, MOST_FRAMES), found.table
    [perception] = prepared(found.setup.networks[:1], found.setup.rig)
    settled = measured_model(scenario.aircraft_model).settled
    assert settled is not None
    camera, shown, times = Camera(scenario), dict[int, Picture](), table['t_s'].tolist()
    seen = np.full((len(table), 2), np.nan)
    chosen = rows[::max(1, len(rows) // _PAIRS)][:_PAIRS]
    for row in rows:
        pose: Any = table.loc[
            row, ['x_m', 'y_m', 'yaw_rad', 'speed_mps', 'yaw_rate_radps']].to_dict()
        state = AircraftState(**pose, z_m=settled.z_m, roll_rad=settled.roll_rad,
                              pitch_rad=settled.pitch_rad)
        pixels = camera.render(state, round(times[row] * NS_PER_S))
        seen[row] = tuple(estimates_of(pixels, [perception], found.setup.rig))
        if row in chosen:
            shown[row] = pixels
    table['rendered_est_cte_m'] = seen[:, 0]
    table['rendered_est_heading_error_deg'] = np.degrees(seen[:, 1])
    beside = table.iloc[rows].copy()
    for quantity, name in (('cte_error_m', 'cte_m'),
                           ('he_error_deg', 'heading_error_deg')):
        beside[f'{quantity}_2'] = beside[f'rendered_est_{name}'] - beside[name]
    found.start, found.gap = scenario, sliced(beside, 2)[0]
    found.notes += _night_notes(scenario, float(beside['brightness'].median()))
    found.pairs = {row: (pixels, shown[row]) for row, pixels in row_pictures(found, chosen)}
