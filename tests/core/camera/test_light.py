from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.camera import sky
from taxinet_ros.core.camera.light import (
    Light,
    air_mass,
    display_code,
    ground_table,
    scenario_light,
    sun_direction,
    sun_position,
)
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS
from taxinet_ros.errors import UsageError

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


def test_given_the_equinox_then_the_sun_rises_in_the_east_and_culminates_in_the_south() -> None:
    azimuth, elevation = map(math.degrees, sun_position('2020-03-20', 6.05 * 3600))
    assert azimuth == pytest.approx(90, abs=1.5)
    assert elevation == pytest.approx(0, abs=1.0)
    # 119.33 W is 0.67 degrees east of the zone's meridian (-2.7 min); equation of time +7.5 min.
    azimuth, _ = sun_position('2020-03-20', 12 * 3600 + 4.8 * 60)
    assert math.degrees(azimuth) == pytest.approx(180.0, abs=0.5)


def test_given_a_day_when_seen_from_the_runway_then_the_sun_is_ahead_and_then_behind() -> None:
    x, y, z = sun_direction(*sun_position('2020-03-20', 7 * 3600))
    assert x > 0.5
    assert y < -0.5
    assert 0 < z < 0.3
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


def light(hour: float = 12.0, clouds: str = 'clear', rain: float = 0.0) -> Light:
    return scenario_light(Scenario(time_of_day_s=hour * 3600, clouds=clouds, rain_fraction=rain))


def test_given_known_elevations_when_computing_the_air_mass_then_it_is_the_papers() -> None:
    assert air_mass(math.pi / 2) == pytest.approx(1.0, abs=1e-3)
    assert air_mass(math.radians(30)) == pytest.approx(1.994, abs=5e-3)
    assert air_mass(0.0) == pytest.approx(37.92, abs=0.1)


def test_given_thicker_clouds_when_outside_single_shadows_then_the_ground_is_darker() -> None:
    for hour in (7, 9, 12, 16):
        totals = [
            float(light(hour, clouds).total.mean())
            for clouds in ('clear', 'cirrus', 'broken', 'overcast', 'stratus')
        ]
        assert totals == sorted(totals, reverse=True)
        assert min(np.abs(np.diff(totals))) > 0.02
        assert light(hour, 'scattered').total.mean() < totals[0]
        assert totals[-1] < 0.6 * totals[0]


def test_given_the_hours_when_the_sun_climbs_then_the_ground_brightens() -> None:
    for clouds in CLOUDS:
        totals = [float(light(hour, clouds).total.mean()) for hour in (5, 6, 6.5, 7, 8, 9, 12)]
        assert totals == sorted(totals)
        assert totals[1] < 0.4 * totals[-1]


def test_given_dawn_when_compared_with_noon_then_the_sunlight_is_redder() -> None:
    def redness(hour: float) -> float:
        direct = light(hour).direct
        return float(direct[0] / direct[2])

    assert redness(7) > 1.5 * redness(12)


@pytest.mark.parametrize('clouds', ['overcast', 'stratus'])
def test_given_a_closed_cover_when_the_sun_shines_then_no_beam_reaches_the_ground(
    clouds: str,
) -> None:
    assert light(15, clouds).direct.max() == 0
    np.testing.assert_array_equal(light(15, clouds).shade_factor(), 1.0)


def test_given_a_clear_sky_when_shaded_then_the_shade_is_bluer_and_much_darker() -> None:
    factor = light(15).shade_factor()
    assert factor[0] < factor[2] < 0.75
    assert light(15).shade_factor(0.0) == pytest.approx(1.0)


@pytest.mark.parametrize('clouds', RAIN_CLOUDS)
def test_given_rain_when_it_grows_then_one_sees_less_far_over_wetter_ground(clouds: str) -> None:
    lights = [light(12, clouds, rain) for rain in (0.0, 0.25, 0.5, 1.0)]
    visibilities = [value.visibility_m for value in lights]
    wetness = [value.wetness for value in lights]

    assert visibilities == sorted(visibilities, reverse=True)
    assert wetness == sorted(set(wetness))
    assert wetness[0] == 0


def test_given_wet_ground_when_looked_up_then_it_is_darker_than_dry_ground() -> None:
    dry = light(12, 'overcast')
    wet = dataclasses.replace(dry, wetness=1.0)
    assert (ground_table(wet)[0, 60:220] < ground_table(dry)[0, 60:220]).all()


@given(st.lists(st.floats(0, 50), min_size=2, max_size=20))
def test_given_exposures_when_made_display_codes_then_order_and_range_are_kept(
    values: list[float],
) -> None:
    codes = display_code(np.sort(np.array(values)))
    assert (np.diff(codes) >= 0).all()
    assert codes.min() >= 0
    assert codes.max() <= 255


def panorama(**values: object) -> np.ndarray:
    return sky.panorama(scenario_light(Scenario(**values))).astype(int)


@pytest.mark.parametrize('clouds', CLOUDS)
def test_given_any_clouds_when_painted_then_the_panorama_closes_on_itself(clouds: str) -> None:
    picture = panorama(clouds=clouds)
    assert picture.shape == (sky.ROWS, sky.COLUMNS, 3)
    seam = np.abs(picture[30:, 0] - picture[30:, -1]).mean()
    inside = np.abs(np.diff(picture[30:], axis=1)).mean(axis=(0, 2)).max()
    assert seam <= inside


def test_given_a_clear_noon_when_painted_then_the_ground_is_below_and_the_sky_above() -> None:
    picture = panorama()
    below, above = picture[2].mean(axis=0), picture[100].mean(axis=0)
    assert below[0] > below[2]
    assert above[2] > above[0]


def test_given_a_low_sun_when_painted_then_the_sky_glows_around_it() -> None:
    scenario = Scenario(time_of_day_s=7.0 * 3600)
    light = scenario_light(scenario)
    picture = sky.panorama(light).astype(int)
    yaw_deg = np.degrees(np.arctan2(light.sun[1], light.sun[0]))
    column = round((yaw_deg + 180) * sky.COLUMNS_PER_DEGREE) % sky.COLUMNS
    across = (column + sky.COLUMNS // 2) % sky.COLUMNS
    row = round((light.sun_elevation_rad - sky.LOWEST_RAD) / sky.STEP_RAD)
    assert picture[row, column, 0] > picture[row, across, 0] + 30
