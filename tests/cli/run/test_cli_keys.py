"""``taxinet keys``: what ``--set`` takes."""

from __future__ import annotations

import json

import pytest

from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import HUMAN_KEYS, SCENARIO_FIELDS


def test_given_no_word_then_every_key_is_listed_with_range_and_default(taxinet):
    code, said, _ = taxinet('keys')
    assert code == 0
    lines = said.splitlines()
    first = [line.split()[0] for line in lines[2:-1] if line[1:2].strip()]
    assert first == list(HUMAN_KEYS)
    wind = next(line for line in lines if 'wind_speed_mps' in line)
    assert wind.split() == ['wind_speed_mps', '0', 'to', '30', 'm/s', '0', 'wind', '~']
    assert '--set KEY@SECONDS=VALUE' in lines[-1]


def test_given_a_word_then_only_lines_with_it_are_listed(taxinet):
    code, said, _ = taxinet('keys', 'Camera', '--json')
    assert code == 0
    found = json.loads(said)
    cameras = {key for key in HUMAN_KEYS if key.startswith('camera')}
    assert {one['key'] for one in found} == {*cameras, 'sensors'}, 'which are beside the camera'
    assert next(one for one in found if one['key'] == 'camera_dyaw_deg') == {
        'key': 'camera_dyaw_deg', 'may_be': '-20 to 20°', 'default': '0',
        'what': 'camera yawed left', 'varies': False,
    }


@pytest.mark.parametrize(('word', 'key'), [
    ('surface', 'runway_state'), ('Friction', 'runway_state'), ('icy', 'runway_state'),
    ('drop-out', 'gnss_dropout_s'),
])
def test_given_a_word_of_a_value_or_description_then_its_key_is_found(taxinet, word, key):
    code, said, _ = taxinet('keys', word)
    assert (code, key in said) == (0, True)


@pytest.mark.parametrize(('word', 'hint'), [
    ('fog', ''), ('windd', '; did you mean wind?'), ('Exposur_jump', '; did you mean exposure'),
    ('wind_sped', '; did you mean wind_speed_mps?'), ('elevatin', '; did you mean deviation?'),
])
def test_given_a_word_of_no_line_then_it_is_refused_with_the_nearest(taxinet, word, hint):
    code, said, err = taxinet('keys', word)
    assert (code, said) == (2, '')
    assert f"none has '{word}' in its line{hint}" in err
    assert hint or 'did you mean' not in err


@pytest.mark.parametrize('field', SCENARIO_FIELDS, ids=lambda field: field.key)
def test_given_the_default_as_it_is_listed_when_set_then_it_is_the_default(field):
    listed = field.as_typed(getattr(Scenario(), field.attribute))
    assert scenario_from_human({field.key: field.settled(listed)}) == Scenario()
