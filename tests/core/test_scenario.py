"""A scenario is a validated point of the feature space; people's units go in by one door."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import CLOUDS, HUMAN_KEYS, RAIN_CLOUDS
from taxinet_ros.errors import UsageError

HUMAN = st.fixed_dictionaries({
    'cross_track': st.floats(-8, 8),
    'distance': st.floats(0, 2000),
    'heading': st.floats(-30, 30),
    'clouds': st.sampled_from(RAIN_CLOUDS),
    'rain': st.floats(0, 100),
    'time_of_day': st.floats(6, 18),
    'shadows': st.booleans(),
})


@given(HUMAN)
def test_given_a_scene_in_human_units_when_read_back_then_nothing_has_changed(values):
    back = scenario_from_human(values).to_human()
    for key, value in values.items():
        same = isinstance(value, str | bool)
        assert back[key] == (value if same else pytest.approx(value, abs=1e-8))


def test_given_degrees_percent_and_hours_then_the_inside_is_radians_fraction_and_seconds():
    scene = scenario_from_human(
        {'heading': 30, 'rain': 50, 'clouds': 'overcast', 'time_of_day': 6.5}
    )
    assert scene.heading_rad == pytest.approx(math.pi / 6)
    assert scene.rain_fraction == pytest.approx(0.5)
    assert scene.time_of_day_s == 23400.0


def test_given_all_human_keys_then_they_cover_every_field_of_a_scenario():
    assert len(HUMAN_KEYS) == len(dataclasses.fields(Scenario)) == 12


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ({'cross_track': 40}, 'cross_track_m is 40, outside -15..15'),
        ({'distance': 'far'}, "distance needs a number, got 'far'"),
        ({'heading': float('nan')}, 'heading_rad is nan'),
        ({'clouds': 'fog'}, "clouds is 'fog', not one of clear"),
        ({'rain': 50}, 'rain needs clouds broken/overcast/stratus'),
        ({'tod': 9}, "unknown key 'tod'; known: cross_track"),
        ({'shadows': 'maybe'}, "shadows needs on or off, got 'maybe'"),
        ({'aircraft': 'b747'}, "aircraft is 'b747'"),
        ({'date': 'tomorrow'}, "date is 'tomorrow', not YYYY-MM-DD"),
        ({'cross_track': True}, 'cross_track needs a number, got True'),
    ],
)
def test_given_a_bad_value_then_one_line_says_which_and_what_is_allowed(values, words):
    with pytest.raises(UsageError) as error:
        scenario_from_human(values)
    assert words in str(error.value)
    assert '\n' not in str(error.value)


@pytest.mark.parametrize('clouds', [c for c in CLOUDS if c not in RAIN_CLOUDS])
def test_given_a_cloud_kind_without_rain_when_it_rains_then_it_is_refused(clouds):
    with pytest.raises(UsageError, match='rain needs clouds'):
        Scenario(clouds=clouds, rain_fraction=0.3)
