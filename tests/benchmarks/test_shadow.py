"""The own shadow is as dark in the picture as physics has it on a clear day."""

from __future__ import annotations

import math

import numpy as np
import pytest
from shadow import clear_day, main, shaded_light, shadow_appearances

from taxinet_ros.core.camera.light import LUMINANCE, scenario_light, sun_position
from taxinet_ros.core.scenario import Scenario

# Diffuse over global irradiance by pvlib 0.16.1: pvlib.clearsky.ineichen(90 - elevation,
# get_absolute_airmass(get_relative_airmass(90 - elevation), 97000), turbidity, altitude=360,
# dni_extra=1367).
PVLIB = {
    (5, 2.5): 0.265, (5, 3.5): 0.553, (10, 2.5): 0.177, (10, 3.0): 0.281, (10, 3.5): 0.371,
    (20, 2.5): 0.122, (20, 3.0): 0.181, (30, 3.0): 0.145, (30, 3.5): 0.185, (40, 2.5): 0.093,
    (40, 3.5): 0.158, (60, 2.0): 0.071, (60, 3.0): 0.109, (60, 3.5): 0.134,
}


@pytest.mark.parametrize(('elevation_deg', 'turbidity'), PVLIB)
def test_s_shadow_given_a_clear_day_then_its_light_is_that_of_the_published_model(
    elevation_deg: float, turbidity: float
) -> None:
    direct, diffuse = clear_day(math.radians(elevation_deg), turbidity)
    expected = PVLIB[elevation_deg, turbidity]
    assert diffuse / (direct + diffuse) == pytest.approx(expected, abs=0.002)


def test_s_shadow_given_a_clear_day_of_the_year_then_shade_is_as_dark_as_physics_has_it() -> None:
    """From 5 degrees of elevation up, within an eighth of the ratio."""
    found = []
    for date in ('2020-03-20', '2020-06-21', '2020-12-21'):
        for hour in np.arange(5.0, 19.5, 0.5):
            _, elevation = sun_position(date, hour * 3600)
            if elevation < math.radians(5):
                continue
            light = scenario_light(Scenario(time_of_day_s=hour * 3600, date=date))
            ours = float(LUMINANCE @ light.diffuse / (LUMINANCE @ light.total))
            found.append(ours / shaded_light(elevation))
    assert len(found) > 50
    assert max(found) < 1.125
    assert min(found) > 1 / 1.125


def test_s_shadow_given_an_afternoon_then_the_picture_has_the_shadow_of_that_light() -> None:
    looks = {look.hour: look for look in shadow_appearances({}, [10.0, 13.0, 15.0, 17.0])}
    assert looks[10.0].share < 0.01  # beside the wheel
    for hour in (13.0, 15.0, 17.0):
        assert looks[hour].share > 0.1
        assert looks[hour].rendered == pytest.approx(looks[hour].light, abs=0.01)
        assert looks[hour].rendered == pytest.approx(looks[hour].physics, rel=0.1)
    assert looks[15.0].from_nose_deg == pytest.approx(180, abs=5)


def test_s_shadow_given_a_clearer_day_then_shade_is_darker() -> None:
    for elevation_deg in (5, 15, 30, 60):
        shades = [shaded_light(math.radians(elevation_deg), one) for one in (2.5, 3.3, 4.5)]
        assert shades == sorted(shades)
        assert shades[0] < 0.75 * shades[1]


def test_s_shadow_given_clouds_then_it_is_fainter_than_under_a_clear_sky() -> None:
    (clear,), (thin,) = (shadow_appearances({'clouds': one}, [15.0]) for one in ('clear', 'cirrus'))
    assert clear.rendered + 0.05 < thin.rendered < 1


def test_s_shadow_given_hours_then_a_line_each_tells_how_dark_it_is(
    capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['--hours', '10', '15', '--set', 'distance=900']) == 0
    _, _, morning, afternoon = capsys.readouterr().out.splitlines()
    assert (morning.split()[0], morning.split()[3]) == ('10:00', '0.4%')
    assert afternoon.split()[0] == '15:00'
    assert [float(word) for word in afternoon.split()[4:7]] == pytest.approx([0.24] * 3, abs=0.01)
