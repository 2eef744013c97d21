from __future__ import annotations

import numpy as np
import pytest

from taxinet_ros.core import sky
from taxinet_ros.core.light import scenario_light
from taxinet_ros.core.scenario import CLOUDS, Scenario


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
