from __future__ import annotations

import math

import numpy as np
import pytest

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.sun import sun_direction, sun_position

LATITUDE_DEG = 47.2
HOURS = np.arange(10, 14, 0.05)


def elevations_deg(date: str) -> list[float]:
    return [math.degrees(sun_position(date, float(hour) * 3600)[1]) for hour in HOURS]


@pytest.mark.parametrize(
    ('date', 'noon_deg'),
    [
        ('2020-03-20', 90 - LATITUDE_DEG),
        ('2020-06-20', 90 - LATITUDE_DEG + 23.44),
        ('2020-12-21', 90 - LATITUDE_DEG - 23.44),
    ],
)
def test_given_a_day_when_culminating_then_the_elevation_is_the_almanacs(
    date: str, noon_deg: float
) -> None:
    assert max(elevations_deg(date)) == pytest.approx(noon_deg, abs=0.3)


def test_given_the_equinox_when_culminating_then_it_is_six_minutes_past_noon_and_south() -> None:
    # 119.33 W is 0.67 degrees east of the zone's meridian (-2.7 min); equation of time +7.5 min.
    azimuth, _ = sun_position('2020-03-20', 12 * 3600 + 4.8 * 60)
    assert math.degrees(azimuth) == pytest.approx(180.0, abs=0.5)


def test_given_the_equinox_when_rising_then_the_sun_stands_in_the_east_at_six() -> None:
    azimuth, elevation = sun_position('2020-03-20', 6.05 * 3600)
    assert math.degrees(azimuth) == pytest.approx(90, abs=1.5)
    assert math.degrees(elevation) == pytest.approx(0, abs=1.0)


def test_given_a_morning_sun_when_seen_from_the_runway_then_it_is_ahead_and_right() -> None:
    x, y, z = sun_direction(*sun_position('2020-03-20', 7 * 3600))
    assert x > 0.5
    assert y < -0.5
    assert 0 < z < 0.3


def test_given_an_afternoon_sun_when_seen_from_the_runway_then_it_is_behind() -> None:
    x, y, _ = sun_direction(*sun_position('2020-03-20', 15 * 3600))
    assert x < -0.8
    assert abs(y) < 0.1


def test_given_any_angles_when_made_a_direction_then_its_length_is_one() -> None:
    assert np.linalg.norm(sun_direction(1.2, 0.4)) == pytest.approx(1.0)


@pytest.mark.parametrize(('date', 'time_s'), [('yesterday', 0.0), ('2020-03-20', math.nan)])
def test_given_nonsense_when_asked_for_the_sun_then_one_line_says_so(
    date: str, time_s: float
) -> None:
    with pytest.raises(UsageError) as caught:
        sun_position(date, time_s)
    assert '\n' not in str(caught.value)
