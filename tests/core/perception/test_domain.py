"""What networks were trained in, and that scenes outside it are named before they are run."""

from __future__ import annotations

import dataclasses
import json
import shutil

import pytest
import yaml
from onnx_samples import described

import taxinet_ros as tx
from taxinet_ros.core.perception.domain import (
    domain_doubts,
    domain_of_scenes,
    domain_words,
    joined_domains,
    read_domain,
)
from taxinet_ros.core.perception.onnx.sidecar import parse_sidecar
from taxinet_ros.core.perception.perception import find_domain, network_doubts
from taxinet_ros.core.perception.weights import SHIPPED, card_path, load_card
from taxinet_ros.core.rig.catalogue import WING
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section
from taxinet_ros.trials.options import make_options


def scenes(*values):
    return [scenario_from_human(one).to_human() for one in values]


TRAINED = domain_of_scenes(scenes(
    {'time_of_day_h': 6.01}, {'time_of_day_h': 17.9, 'clouds': 'stratus', 'rain_percent': 99.2}))


def doubts(*values):
    return domain_doubts('net', TRAINED, scenes(*values))


def test_a_domain_has_words_and_ranges_with_ends_that_draws_do_not_reach():
    assert TRAINED == {
        'camera': ('wing',), 'place': ('kmwh_04',), 'aircraft': ('caravan',), 'track': ('runway',),
        'clouds': ('clear', 'stratus'), 'time_of_day_h': (6.0, 18.0),
        'rain_percent': (0.0, 100.0), 'runway_width_m': (30.48, 30.48),
    }
    assert domain_words(TRAINED) == (
        'camera wing, place kmwh_04 (30.5 m wide), aircraft caravan, track runway, clouds clear, '
        'stratus, time of day 06:00 to 18:00, rain 0 % to 100 %'
    )
    assert domain_words(None) == 'unknown'


@pytest.mark.parametrize(('value', 'words'), [
    ({'camera': 'nose'}, 'camera wing; this scene has camera nose'),
    ({'place': 'bikf_10'},
     'place kmwh_04 (30.5 m wide); this scene has place bikf_10 (60 m wide)'),
    ({'aircraft': 'c172p'}, 'aircraft caravan; this scene has aircraft c172p'),
    ({'track': 'rapid_exit', 'place': 'bikf_10'}, 'track runway; this scene has place bikf_10 (60 '
     'm wide), track rapid_exit'),
    ({'clouds': 'broken'}, 'clouds clear, stratus; this scene has clouds broken'),
    ({'time_of_day_h': 5}, 'time of day 06:00 to 18:00; this scene has time of day 05:00'),
    ({'camera_dyaw_deg': 0.12}, 'this scene has camera yawed left +0.1 deg'),
    ({'camera_dz_m': -0.1}, 'the camera in its place; this scene has camera moved up -0.10 m'),
])
def test_a_scene_outside_is_named_in_one_line_by_what_is_outside_alone(value, words):
    (line,) = doubts(value)
    assert line.startswith('net was trained with ')
    assert line.endswith(words)


ANYWHERE = domain_of_scenes(
    scenes({'place': 'bikf_10'}, {'place': 'random:20039', 'camera': 'nose', 'distance_m': 0}),
    unnamed=('place', 'camera'))


def test_a_network_for_any_place_and_camera_has_their_numbers():
    assert ANYWHERE == {
        'aircraft': ('caravan',), 'track': ('runway',), 'clouds': ('clear',),
        'time_of_day_h': (12.0, 12.0), 'rain_percent': (0.0, 0.0),
        'runway_width_m': (23.0, 60.0), 'camera_aside_m': (0.0, 2.17),
        'camera_turned_deg': (0.0, 4.5), 'camera_down_deg': (8.0, 10.5),
        'camera_field_of_view_deg': (74.5, 80.5), 'sun_elevation_deg': (23.0, 41.0),
    }
    assert domain_words(ANYWHERE).endswith(
        'runway width 23 to 60 m, camera aside 0 to 2.17 m, camera turned aside 0 to 4.5°, '
        'camera turned down 8 to 10.5°, field of view 74.5 to 80.5°')


@pytest.mark.parametrize(('value', 'words'), [
    ({'place': 'nzqn_05', 'distance_m': 0}, None),  # 45 m
    ({'place': 'random:20003', 'distance_m': 0}, 'runway width 23 to 60 m; this scene has runway '),
    ({'camera': 'strut', 'aircraft': 'c172p'}, 'aircraft caravan, camera'),
    ({'place': 'bikf_10', 'date': '2020-12-21'}, 'sun 2 to 60° high; this scene has sun 1.24'),
    ({'place': 'bikf_10', 'date': '2020-06-21'}, None),
])
def test_another_place_is_outside_such_a_domain_only_by_its_numbers(value, words):
    found = domain_doubts('net', {**ANYWHERE, 'sun_elevation_deg': (2.0, 60.0)}, scenes(value))
    assert (not found) if words is None else words in found[0]


def test_a_domain_that_names_its_places_is_joined_to_one_that_does_not_by_numbers():
    joined = joined_domains([TRAINED, ANYWHERE])
    assert joined['runway_width_m'] == (23.0, 60.0)
    assert joined['time_of_day_h'] == (6.0, 18.0)
    assert not {'place', 'camera'} & set(joined)
    assert joined['camera_field_of_view_deg'][0] == 74.5


def test_scenes_inside_and_networks_of_unknown_domain_are_not_named():
    assert doubts({}, {'time_of_day_h': 18, 'clouds': 'stratus', 'rain_percent': 100}) == []
    # What no picture of the training can tell: where it starts, and what pushes it.
    assert doubts({'cross_track_m': 9, 'wind_speed_mps': 8, 'runway_state': 'icy'}) == []
    assert domain_doubts('net', None, scenes({'camera': 'nose'})) == []
    assert find_domain('truth') is None
    assert find_domain('some/file.py:look') is None


def test_a_copy_of_wing_in_a_file_is_the_camera_wing(tmp_path):
    (tmp_path / 'copy.yaml').write_text(yaml.safe_dump({
        **json.loads(WING.document), 'name': 'copy'}))
    assert doubts({'camera': str(tmp_path / 'copy.yaml')}) == []
    (tmp_path / 'low.yaml').write_text(yaml.safe_dump({
        **json.loads(WING.document), 'name': 'low', 'offset_m': [0.085, -2.17, 0.4]}))
    (line,) = doubts({'camera': str(tmp_path / 'low.yaml')})
    assert 'camera wing; this scene has camera low@' in line


def test_domains_join_and_one_that_is_unknown_makes_the_whole_unknown():
    other = domain_of_scenes(scenes({
        'camera': 'nose', 'time_of_day_h': 20, 'camera_dz_m': -0.12}))
    both = joined_domains([TRAINED, other])
    assert both is not None
    assert (both['camera'], both['time_of_day_h']) == (('nose', 'wing'), (6.0, 20.0))
    assert both['camera_dz_m'] == (-0.15, 0.0)
    assert joined_domains([TRAINED, TRAINED]) == TRAINED
    assert joined_domains([TRAINED, None]) is None


def test_every_shipped_network_has_the_domain_of_its_programs_and_its_weights_are_the_same():
    hours = {word: find_domain(word)['time_of_day_h'] for word in SHIPPED}
    assert hours == {word: (8.5, 12.0) if word == 'original' else (6.0, 18.0) for word in SHIPPED}
    assert find_domain('original')['rain_percent'] == (0.0, 0.0)
    domains = {word: find_domain(word) for word in SHIPPED}
    assert domains.pop('anywhere')['sun_elevation_deg'] == (-1.0, 90.0)
    assert {domain['camera'] for domain in domains.values()} == {('wing',)}
    assert load_card(card_path(SHIPPED['taxinet'])).weights_sha256.startswith('af34f1f2ef3d80a2')


def test_a_card_without_a_domain_is_read_and_one_with_a_bad_one_is_refused(tmp_path):
    values = json.loads(card_path(SHIPPED['taxinet']).read_text())
    del values['domain']
    path = tmp_path / 'net.json'
    path.write_text(json.dumps(values))
    assert load_card(path).domain is None
    shutil.copy(SHIPPED['taxinet'], tmp_path / 'net.safetensors')
    assert network_doubts(str(tmp_path / 'net.safetensors'), [Scenario(camera='nose')]) == []
    for bad, words in (
        ({'hours': [6, 18]}, 'domain: hours: unknown key'),
        ({'camera': 'wing'}, 'domain.camera: expected a list of words'),
        ({'rain_percent': [0]}, 'domain.rain_percent: expected a list of 2 numbers'),
    ):
        with pytest.raises(UsageError, match=words.replace('domain: hours', r'domain\.hours')):
            read_domain(Section(path, {'domain': bad}))


def test_an_onnx_network_may_tell_its_domain_in_its_description(tmp_path):
    text = yaml.safe_dump({**described(None), 'domain': {'camera': ['nose']}}).encode()
    assert parse_sidecar(tmp_path / 'net.yaml', text).domain == {'camera': ('nose',)}
    assert parse_sidecar(tmp_path / 'net.yaml', yaml.safe_dump(described(None)).encode()) \
        .domain is None


def options(**settings):
    return make_options(
        program='nominal', runs=3, seed=0, perception='original', out=None, processes=False,
        settings=[f'{key}={value}' for key, value in settings.items()], specs=(),
    )


def test_a_campaign_outside_the_domain_says_so_before_its_runs():
    drawn = [Scenario(time_of_day_s=hour * 3600.0) for hour in (9, 10, 16)]
    said = options().check(drawn[0], set, drawn).warnings
    assert said == (
        'original was trained with time of day 08:30 to 12:00; scenes here have time of day 09:00 '
        'to 16:00',
    )
    assert options().check(drawn[0], set, drawn[:2]).warnings == ()
    truth = dataclasses.replace(options(), perception='truth')
    assert truth.check(drawn[2], set, drawn).warnings == ()


def test_a_single_run_outside_the_domain_warns_in_python():
    with pytest.warns(UserWarning, match='^taxinet was trained with camera wing; this scene has'):
        tx.run(Scenario(camera='nose', duration_s=0.2), perception='taxinet')


@pytest.mark.parametrize(('word', 'values', 'named'), [
    ('taxinet', {'place': 'bikf_10'}, True),
    ('original', {'place': 'bikf_10', 'camera': 'nose'}, True),
    ('taxinet', {'place': 'bikf_10', 'time_of_day_h': 6}, False),  # in the dark
    ('original', {'clouds': 'stratus'}, False),  # taxinet was trained for it
    ('taxinet', {}, False),
])
def test_the_network_for_any_place_is_named_where_it_is_what_is_missing(word, values, named):
    found = network_doubts(word, [scenario_from_human(values)])
    assert [line.endswith('; anywhere was trained for such') for line in found] == (
        [named] if word == 'original' or values else [])
