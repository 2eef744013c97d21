"""Where the sun stands over the runway (library astral, NOAA's equations, with refraction)."""

from __future__ import annotations

import datetime
import math

import numpy as np
from astral import Observer
from astral.sun import azimuth, elevation
from numpy.typing import NDArray

from taxinet_ros.core import runway
from taxinet_ros.core.errors import UsageError

LOCAL_TIME = datetime.timezone(datetime.timedelta(hours=-8))
"""Pacific standard time; the scenarios know no daylight saving."""

_OBSERVER = Observer(runway.THRESHOLD_LAT_DEG, runway.THRESHOLD_LON_DEG, 0.0)


def sun_position(date: str, time_of_day_s: float) -> tuple[float, float]:
    """Azimuth (clockwise from true north, 0..2 pi) and elevation of the sun [rad].

    Args:
        date: ISO date.
        time_of_day_s: local standard time (UTC-8) after midnight [s].

    Raises:
        UsageError: the date or the time cannot be read.
    """
    if not math.isfinite(time_of_day_s):
        raise UsageError(f'sun: time of day is {time_of_day_s}, not a number of seconds')
    try:
        day = datetime.datetime.fromisoformat(date).replace(tzinfo=LOCAL_TIME)
    except ValueError as error:
        raise UsageError(f'sun: date is {date!r}, not YYYY-MM-DD') from error
    moment = day + datetime.timedelta(seconds=time_of_day_s)
    return (
        math.radians(azimuth(_OBSERVER, moment)),
        math.radians(elevation(_OBSERVER, moment)),
    )


def sun_direction(azimuth_rad: float, elevation_rad: float) -> NDArray[np.float64]:
    """Unit vector towards the sun in ``map`` (x along the runway, y left, z up), shape (3,)."""
    yaw = runway.BEARING_RAD - azimuth_rad
    flat = math.cos(elevation_rad)
    return np.array([flat * math.cos(yaw), flat * math.sin(yaw), math.sin(elevation_rad)])
