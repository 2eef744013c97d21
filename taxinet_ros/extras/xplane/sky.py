"""Time and weather of a scenario as datarefs, by version of X-Plane.

X-Plane 11 (``sim/weather/``) has the six kinds of clouds that scenarios have, in their order.
X-Plane 12 (``sim/weather/region/``) has layers of a type, a coverage, a base and a top, and a
runway state instead of rain's consequences; its old datarefs no longer act. Coverage follows the
oktas of the kind: scattered 3 to 4, broken 5 to 7, overcast 8 (WMO code table 2700).

Sources: DataRefs.txt of X-Plane 11 and 12; "Weather Datarefs in X-Plane 12", developer.x-plane.com.
Bases and tops are ours. Which of it a real X-Plane obeys is not checked (docs/xplane.md).
"""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass

from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CLOUDS
from taxinet_ros.errors import InfraKind
from taxinet_ros.extras.xplane.wire import failed

_KNOT_MPS = 1852 / 3600
_LAYERS, _WINDS = 3, 13
_LEVEL_11_M = 2000.0
_FRICTION_12 = {'dry': 0.0, 'wet': 2.0, 'icy': 11.0}
"""Runway friction: 0 dry, 1 to 3 wet, 10 to 12 icy."""
_STATIC = 3.0
"""Weather that changes neither for better nor for worse."""

REGENERATE = 'sim/operation/regen_weather'
"""Command after which X-Plane 12 draws its clouds anew; other changes act at once."""


_CLOUDS_12 = {
    'clear': (0.0, 0.0, 8000.0, 8500.0),
    'cirrus': (0.0, 0.5, 8000.0, 8500.0),
    'scattered': (2.0, 0.44, 1500.0, 2700.0),
    'broken': (2.0, 0.75, 1500.0, 2700.0),
    'overcast': (2.0, 1.0, 1200.0, 2700.0),
    'stratus': (1.0, 1.0, 600.0, 2000.0),
}
"""Of X-Plane 12: type 0 cirrus, 1 stratus, 2 cumulus; coverage 0..1; base and top [m above ground].
"""


@dataclass(frozen=True, slots=True)
class Setting:
    """A value to be set and read back.

    Attributes:
        name: of the dataref.
        value: its value.
        within: greatest difference of what is read back.
    """

    name: str
    value: float | tuple[float, ...]
    within: float = 1e-3


def major(version: str) -> int:
    """Major version: 11 of ``11.55`` and of ``115501``."""
    head = version.partition('.')[0]
    if not (head.isascii() and head.isdigit() and len(head) > 1):
        raise failed(InfraKind.PROTOCOL, f'X-Plane {version!r:.20} is of no known version')
    return int(head[:2])


def zulu(scenario: Scenario) -> tuple[float, float]:
    """Time of the scenario: days since the first of January, seconds after midnight GMT.

    X-Plane has no years: its sun follows the day.
    """
    date = datetime.date.fromisoformat(scenario.date)
    midnight = datetime.datetime.combine(date, datetime.time(), scenario.runway.zone)
    local = midnight + datetime.timedelta(seconds=scenario.time_of_day_s)
    utc = local.astimezone(datetime.UTC)
    seconds = utc.hour * 3600 + utc.minute * 60 + utc.second + utc.microsecond * 1e-6
    return float(date.timetuple().tm_yday - 1), seconds


def time_settings(scenario: Scenario, settle_s: float) -> list[Setting]:
    """Time of day and date; seconds pass while the weather settles."""
    days, seconds = zulu(scenario)
    return [
        Setting('sim/time/use_system_time', 0.0), Setting('sim/time/local_date_days', days),
        # Time of day is a 32-bit float on the wire.
        Setting('sim/time/zulu_time_sec', seconds, within=settle_s + 5.0),
    ]


def weather_settings(scenario: Scenario, version: str, *, moves: bool) -> list[Setting]:
    """Clouds and rain; wind and friction too where X-Plane moves the aircraft."""
    settings, wind = (_weather_11 if major(version) < 12 else _weather_12)(scenario)
    return [*settings, *wind] if moves else settings


def _weather_11(scenario: Scenario) -> tuple[list[Setting], list[Setting]]:
    weather = 'sim/weather/'
    direction_deg = math.degrees(scenario.wind_direction_rad)
    return [
        Setting(weather + 'use_real_weather_bool', 0.0),
        Setting(weather + 'cloud_type[0]', float(CLOUDS.index(scenario.clouds))),
        *(Setting(f'{weather}cloud_type[{layer}]', 0.0) for layer in (1, 2)),
        Setting(weather + 'rain_percent', scenario.rain_fraction),
    ], [
        Setting(weather + 'wind_altitude_msl_m[0]', _LEVEL_11_M, within=1.0),
        Setting(weather + 'wind_speed_kt[0]', scenario.wind_speed_mps / _KNOT_MPS, within=0.1),
        Setting(weather + 'wind_direction_degt[0]', direction_deg, within=0.1),
    ]


def _weather_12(scenario: Scenario) -> tuple[list[Setting], list[Setting]]:
    region, (kind, coverage, *heights_m) = 'sim/weather/region/', _CLOUDS_12[scenario.clouds]
    base_m, top_m = (scenario.runway.elevation_m + one for one in heights_m)
    none = (0.0,) * (_LAYERS - 1)
    above = tuple(top_m + 1000.0 * (1 + at) for at in range(_LAYERS - 1))
    direction_deg = math.degrees(scenario.wind_direction_rad)
    return [
        Setting(region + 'change_mode', _STATIC), Setting(region + 'variability_pct', 0.0),
        Setting(region + 'cloud_type', (kind, *none)),
        Setting(region + 'cloud_coverage_percent', (coverage, *none)),
        Setting(region + 'cloud_base_msl_m', (base_m, *above), within=1.0),
        Setting(
            region + 'cloud_tops_msl_m', (top_m, *(one_m + 500.0 for one_m in above)), within=1.0
        ),
        Setting(region + 'rain_percent', scenario.rain_fraction),
        Setting(region + 'runway_friction', _FRICTION_12[scenario.surface]),
        Setting(region + 'update_immediately', 1.0),
    ], [
        Setting(region + 'wind_speed_msc', (scenario.wind_speed_mps,) * _WINDS, within=0.05),
        Setting(region + 'wind_direction_degt', (direction_deg,) * _WINDS, within=0.1),
    ]
