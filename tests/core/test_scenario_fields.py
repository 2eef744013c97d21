"""One row per key of a scenario: whatever else has a line for each key says the same."""

import dataclasses
import importlib
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.rig.catalogue import AIRCRAFT
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    CLOUDS,
    HUMAN_KEYS,
    MESSAGE_FIELDS,
    PAPER_FIELDS,
    PARAMETERS,
    PLANE_KEYS,
    RAIN_CLOUDS,
    RUNWAY_STATES,
    SCENARIO_FIELDS,
    SHORT_FORMS,
    TRAFFIC,
    Kind,
    ScenarioField,
    by_key,
    clock_words,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes import values
from taxinet_ros.trials.record.table import table

ROOT = Path(__file__).parents[2]
MESSAGE = ROOT / 'msg_defs/msg/Scenario.msg'
WORLD = ROOT / 'scenarios/runway_world.scenic'
MESSAGE_TYPES = {
    Kind.NUMBER: 'float64', Kind.WORD: 'string', Kind.DATE: 'string', Kind.SWITCH: 'bool',
    Kind.DOCUMENT: 'string',
}
TYPES = {
    Kind.NUMBER: 'float', Kind.WORD: 'str', Kind.DATE: 'str', Kind.SWITCH: 'bool',
    Kind.DOCUMENT: 'str',
}
UNITS = {
    'm': 'm', 'rad': '°', 'rad/s': '°/s', 's': 'h', '0..1': '%', 'm/m': '%', '1': '',
}
"""Units of the message by what people type; a duration is in seconds either way."""

NUMBERS = [field for field in SCENARIO_FIELDS if field.kind is Kind.NUMBER]


def keys(field: ScenarioField) -> str:
    return field.key


def test_given_the_rows_then_no_name_stands_for_two_keys():
    for name in ('key', 'attribute', 'title', 'label'):
        names = [getattr(field, name) for field in SCENARIO_FIELDS]
        assert len(set(names)) == len(names), name
    assert tuple(field.key for field in PAPER_FIELDS) == HUMAN_KEYS[:6]


def test_given_the_rows_then_a_scenario_has_these_attributes_in_this_order_and_no_other():
    attributes = {one.name: str(one.type) for one in dataclasses.fields(Scenario)}
    assert list(attributes) == [*(field.attribute for field in SCENARIO_FIELDS), 'signals']
    for field in SCENARIO_FIELDS:
        assert attributes[field.attribute] == TYPES[field.kind], field.key
        field.checked(getattr(Scenario(), field.attribute))


def test_given_the_rows_then_the_message_has_a_field_of_each_with_its_unit_and_its_words():
    lines = re.findall(r'^(\w+) (\w+) +# (.*)$', MESSAGE.read_text(encoding='utf-8'), re.MULTILINE)
    said = {name: (kind, comment) for kind, name, comment in lines}
    assert [name for name in said if name in {field.attribute for field in SCENARIO_FIELDS}] == [
        field.attribute for field in MESSAGE_FIELDS
    ]
    for field in MESSAGE_FIELDS:
        kind, comment = said[field.attribute]
        assert kind == MESSAGE_TYPES[field.kind], field.key
        assert all(word in comment for word in field.words), field.key
        if field.kind is Kind.NUMBER:
            unit = re.match(r'\[(.+?)\]', comment)[1]
            assert unit == field.unit or UNITS[unit] == field.unit, field.key


def test_given_the_rows_then_a_run_and_its_table_have_a_column_of_each_of_its_type():
    frame = table([])
    start = list(frame.columns).index(SCENARIO_FIELDS[0].key)
    assert list(frame.columns)[start:start + len(SCENARIO_FIELDS)] == [
        field.key for field in SCENARIO_FIELDS
    ]
    for field in SCENARIO_FIELDS:
        assert frame[field.key].dtype == field.column_type, field.key


def test_given_the_rows_then_the_world_of_the_programs_has_these_words_and_properties():
    text = WORLD.read_text(encoding='utf-8')
    assert f'\nCLOUDS = {CLOUDS!r}\n' in text
    assert all(word in text for word in RUNWAY_STATES)
    assert f'\nRAIN_CLOUDS = {RAIN_CLOUDS!r}\n' in text
    properties = re.findall(r'^    (\w+)\[dynamic, final\]:', text, re.MULTILINE)
    short = [key for key in SHORT_FORMS if SHORT_FORMS[key] in PLANE_KEYS]
    assert properties == [*PLANE_KEYS, *(name for name in short if name != 'heading')]
    said = re.search(r'may set these parameters: (.*?)\.\n', text, re.DOTALL)[1]
    assert sorted(set(re.findall(r'\w+', said)) & set(BY_KEY)) == sorted(PARAMETERS)
    for field in NUMBERS:
        unit = rf'\[{field.unit}[],]' if field.unit else r'\('
        assert field.plane or re.search(rf'\b{field.key} {unit}', said), field.key


def test_given_the_rows_then_the_pages_list_them_all(monkeypatch):
    scenic = (ROOT / 'docs/scenic.md').read_text(encoding='utf-8')
    said = re.search(r'^\| `with (.*?) \| refused: they follow', scenic, re.MULTILINE)[1]
    assert re.findall(r'\w+', said) == list(PLANE_KEYS)
    monkeypatch.syspath_prepend(ROOT / 'docs' / '_site')
    table = importlib.import_module('generated').scenario_keys()
    assert re.findall(r'^\| `(\w+)`', table, re.MULTILINE) == list(HUMAN_KEYS)
    for field in SCENARIO_FIELDS:
        assert all(word in table for word in field.words), field.key
    assert table in (ROOT / 'docs/reference/scenario.md').read_text(encoding='utf-8')


@pytest.mark.parametrize('field', SCENARIO_FIELDS, ids=keys)
def test_given_a_key_when_its_value_goes_out_and_in_again_then_it_is_the_same(field):
    value = getattr(Scenario(), field.attribute)
    typed = field.to_human(value)
    assert field.from_human(str(typed) if not isinstance(typed, bool) else typed) == value
    assert getattr(scenario_from_human({field.key: typed}), field.attribute) == value


def test_given_a_short_form_then_it_is_the_key_without_its_unit_and_means_the_same():
    for short, key in SHORT_FORMS.items():
        assert re.fullmatch(rf'{short}_[a-z]+', key)
        assert by_key({short: 1, 'clouds': 2, 'fog': 3}) == {key: 1, 'clouds': 2, 'fog': 3}
        with pytest.raises(UsageError, match=f'{short} and {key} are the same; leave one out'):
            by_key({key: 1, short: 1})


def test_the_scenic_child_has_the_names_of_the_keys_that_it_knows_without_this_table():
    assert values.PLANE_KEYS == PLANE_KEYS
    assert values.SHORT_PLANE_KEYS.items() <= SHORT_FORMS.items()
    assert TRAFFIC.key == values.TRAFFIC_KEY


@pytest.mark.parametrize('field', NUMBERS, ids=keys)
def test_given_a_number_then_both_ends_of_its_range_are_allowed_and_nothing_beyond(field):
    field.checked(field.low)
    field.checked(field.high)
    for value in (field.low - 0.01, field.high + 0.01, float('nan')):
        with pytest.raises(UsageError, match=f'scenario: {field.attribute} is'):
            field.checked(value)


@pytest.mark.parametrize(
    ('key', 'value', 'words'),
    [
        ('cross_track_m', 2.55, '+2.5 m'), ('cross_track_m', 0.0, '0.0 m'),
        ('distance_m', 400, '400 m'), ('heading_deg', -20.0, '-20.0 deg'),
        ('rain_percent', 30.0, '30 %'), ('time_of_day_h', 10.55, '10:33'),
        ('clouds', 'clear', 'clear'), ('shadows', False, 'off'), ('duration_s', 30.0, '30 s'),
        ('wind_direction_deg', 270.0, '270 deg'), ('slope_percent', -1.0, '-1.0 %'),
        ('gust_seed', 7.0, '7'), ('lens_dirt_percent', 20.0, '20 %'),
        ('exposure_jump_ev', -1.5, '-1.5 EV'), ('steering_bias_deg', 2.0, '+2.0 deg'),
        ('steering_rate_limit_degps', 5.0, '5.0 °/s'), ('fault_onset_s', 3.0, '3.0 s'),
        ('traffic', 'nobody', 'nobody'), ('traffic', '1_objects@000000000000', '1 object'),
        ('traffic', '3_objects@000000000000', '3 objects'),
    ],
)
def test_given_a_value_in_human_units_when_said_then_with_its_unit(key, value, words):
    assert BY_KEY[key].value_words(value) == words


def test_given_hours_when_said_as_a_clock_then_rounded_to_the_minute():
    assert [clock_words(hours) for hours in (0, 9.999, 13 + 1 / 3)] == ['00:00', '10:00', '13:20']


def test_given_words_then_they_are_those_that_a_scenario_takes():
    for word in AIRCRAFT.shipped:
        assert Scenario(aircraft=word).aircraft == word
    for word in CLOUDS:
        assert Scenario(clouds=word).clouds == word


@pytest.mark.parametrize(('key', 'typed', 'number'), [
    ('time_of_day', '9:30', 9.5), ('time_of_day', ' 06:00 ', 6.0), ('time_of_day', '9:30:36', 9.51),
    ('time_of_day', '9.5 h', 9.5), ('time_of_day', '570min', 9.5), ('rain', '30 %', 30.0),
    ('heading', '10 deg', 10.0), ('heading', '-10°', -10.0), ('distance', '1.2 km', 1200.0),
    ('distance', '100 ft', 30.48), ('cross_track', '+250 cm', 2.5), ('duration', '0.1 min', 6.0),
    ('speed', '18 km/h', 5.0), ('exposure_jump_ev', '0.5 EV', 0.5),
])
def test_given_a_number_with_a_unit_then_it_is_that_of_the_keys_own_unit(key, typed, number):
    field = BY_KEY[SHORT_FORMS.get(key, key)]
    assert field.from_human(typed) == field.from_human(number)
    assert field.from_human(field.settled(typed)) == field.from_human(typed)
    assert not re.search(r'[^-+.e0-9]', field.settled(typed))


@given(number=st.floats(-0.5, 0.5, allow_subnormal=False))
def test_given_an_angle_in_radians_then_it_is_stored_without_loss(number):
    field = BY_KEY['heading_deg']
    typed = f'{number!r} rad'
    assert field.from_human(typed) == pytest.approx(number, rel=1e-15, abs=1e-300)
    assert field.from_human(field.settled(typed)) == field.from_human(typed)


@pytest.mark.parametrize(('key', 'typed', 'words'), [
    ('time_of_day', '9:75', "needs hours, or a time as 9:30, got '9:75'"),
    ('time_of_day', '25:10', 'is 25.1666666666667, outside 0..24'),
    ('rain', '9:30', "needs a number, got '9:30'"),
    ('rain', '30 m', "rain_percent needs a number in %, got '30 m'"),
    ('heading', '10 degrees', 'heading_deg needs a number in rad, mrad, deg, °, got'),
    ('fault_seed', '3 s', 'fault_seed needs a number without a unit'),
    ('exposure_jump_ev', '1 dB', 'exposure_jump_ev needs a number in EV'),
    ('distance', '1e400 km', 'is inf, outside'), ('distance', '1e999 m', 'is inf, outside'),
    ('distance', '1e-999 km', ''), ('distance', '٣ m', 'needs a number'),
    ('distance', 'm', 'needs a number'),
])
def test_given_another_unit_then_what_is_allowed_is_named(key, typed, words):
    field = BY_KEY[SHORT_FORMS.get(key, key)]
    if not words:
        assert field.from_human(typed) == 0
        return
    with pytest.raises(UsageError) as told:
        field.from_human(typed)
    assert words in str(told.value)
