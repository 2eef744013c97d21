"""A scenario is a validated point of the feature space; people's units go in by one door."""

import dataclasses
import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import CLOUDS, HUMAN_KEYS, RAIN_CLOUDS
from taxinet_ros.errors import UsageError

HUMAN = st.fixed_dictionaries({
    'cross_track_m': st.floats(-8, 8),
    'distance_m': st.floats(0, 2000),
    'heading_deg': st.floats(-30, 30),
    'clouds': st.sampled_from(RAIN_CLOUDS),
    'rain_percent': st.floats(0, 100),
    'time_of_day_h': st.floats(6, 18),
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
        {'heading_deg': 30, 'rain_percent': 50, 'clouds': 'overcast', 'time_of_day_h': 6.5}
    )
    assert scene.heading_rad == pytest.approx(math.pi / 6)
    assert scene.rain_fraction == pytest.approx(0.5)
    assert scene.time_of_day_s == 23400.0


def test_given_all_human_keys_then_they_cover_every_field_of_a_scenario():
    # The control points of those that change within a run are one text.
    assert len(HUMAN_KEYS) + 1 == len(dataclasses.fields(Scenario)) == 48


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ({'cross_track_m': 40}, 'cross_track_m is 40, outside -15..15 m left of the centreline'),
        ({'rain_percent': 120}, 'rain_percent is 120, outside 0..100 %'),
        ({'rain': 120}, 'rain_percent is 120, outside 0..100 %'),
        ({'heading_deg': 95}, 'heading_deg is 95, outside -90..90°, nose left positive'),
        ({'time_of_day_h': 25}, 'time_of_day_h is 25, outside 0..24 h after local midnight'),
        ({'duration_s': 0}, 'duration_s is 0, outside 0.1..600 s'),
        ({'rain': 30, 'rain_percent': 40}, 'rain and rain_percent are the same; leave one out'),
        ({'distance_m': 'far'}, "distance_m needs a number, got 'far'"),
        ({'heading_deg': float('nan')}, 'heading_deg is nan'),
        ({'clouds': 'fog'}, "clouds is 'fog', not one of clear"),
        ({'rain_percent': 50}, 'rain needs clouds broken/overcast/stratus'),
        ({'tod': 9}, "unknown key 'tod'; known: cross_track"),
        ({'shadows': 'maybe'}, "shadows needs on or off, got 'maybe'"),
        ({'aircraft': 'b747'}, "aircraft is 'b747'"),
        ({'date': 'tomorrow'}, "date is 'tomorrow', not YYYY-MM-DD"),
        ({'cross_track': True}, 'cross_track_m needs a number, got True'),
        ({'wind_direction': 90}, 'wind_direction_deg has no effect without wind_speed_mps'),
        ({'fault_onset': 1}, 'fault_onset_s has no effect without a fault: camera_dropout_percent'),
        ({'fault_seed': 1}, 'fault_seed has no effect without a fault that is drawn: camera_drop'),
        ({'fault_seed': 1, 'steering_bias': 2, 'camera_freeze': 1}, 'fault_seed has no effect'),
        ({'fault_seed': 1.5, 'lens_dirt': 2}, 'fault_seed is 1.5, not a whole number'),
        ({'fault_onset': 30, 'lens_dirt': 2}, 'fault_onset_s is 30, not before the end of the run'),
        ({'lens_dirt': 101}, 'lens_dirt_percent is 101, outside 0..100 %'),
        ({'steering_bias': 31}, 'steering_bias_deg is 31, outside -30..30°, left positive'),
        ({'gust_seed': 1}, 'gust_seed has no effect without gust_mps'),
        ({'gust': 2, 'gust_seed': 1.5}, 'gust_seed is 1.5, not a whole number'),
        ({'wind_speed': 31}, 'wind_speed_mps is 31, outside 0..30 m/s'),
        ({'speed': 0}, 'speed_mps is 0, outside 1..10 m/s'),
        ({'slope': 6}, 'slope_percent is 6, outside -5..5 %'),
        ({'aircraft': 'c172p', 'wind_speed': 3, 'gust': 1},
         'aircraft c172p: wind_speed_mps + 3 gust_mps is 6, more than 5'),
        ({'runway_state': 'snow'}, "runway_state is 'snow', not one of dry, auto, wet, icy"),
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


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ({'rain_fraction': 1.2}, 'rain_fraction is 1.2, outside 0..1 as a fraction'),
        ({'heading_rad': 2.0}, 'heading_rad is 2, outside -1.5708..1.5708 rad, nose left positive'),
        ({'time_of_day_s': -1.0}, 'time_of_day_s is -1, outside 0..86400 s after local midnight'),
    ],
)
def test_given_a_bad_value_in_si_units_then_it_is_told_in_si_units(values, words):
    with pytest.raises(UsageError) as error:
        Scenario(**values)
    assert words in str(error.value)


def test_given_keys_of_the_command_line_then_they_are_the_same_in_other_units():
    made = Scenario(time_of_day_h=9.5, rain='30 %', clouds='overcast', heading_deg=-10)
    assert made == Scenario(
        time_of_day_s=34200.0, rain_fraction=0.3, clouds='overcast', heading_rad=math.radians(-10))
    assert repr(made) == (
        f"Scenario(heading_rad={math.radians(-10)!r}, clouds='overcast', rain_fraction=0.3, "
        'time_of_day_s=34200.0)'
    )
    assert '<td style="text-align:left">09:30</td>' in made._repr_html_()
    assert 'camera' not in made._repr_html_()


@pytest.mark.parametrize(('values', 'complaint'), [
    ({'time_of_day_h': 9.5, 'time_of_day_s': 3.0}, 'time_of_day_h is given twice, also as'),
    ({'cros_track': 3}, "unknown key 'cros_track'; did you mean cross_track_m?; known: "),
    ({'heading_deg': 'left'}, "heading_deg needs a number, got 'left'"),
])
def test_given_keys_that_are_none_or_said_twice_then_one_line_says_so(values, complaint):
    with pytest.raises(UsageError, match=re.escape(complaint)):
        Scenario(**values)
