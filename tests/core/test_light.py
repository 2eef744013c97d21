from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.light import Light, air_mass, display_code, ground_table, scenario_light
from taxinet_ros.core.scenario import CLOUDS, RAIN_CLOUDS, Scenario


def light(hour: float = 12.0, clouds: str = 'clear', rain: float = 0.0) -> Light:
    return scenario_light(Scenario(time_of_day_s=hour * 3600, clouds=clouds, rain=rain))


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
