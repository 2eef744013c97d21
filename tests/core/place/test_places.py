"""Places as data: files, the JSON that scenarios carry, names; and runs that take place there."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import pytest
import yaml
from own_place import OWN

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.camera.light import sun_position
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.place.catalogue import SHIPPED_PLACES, find_place, typed_place
from taxinet_ros.core.place.markings import markings
from taxinet_ros.core.place.place_file import read_place
from taxinet_ros.core.place.runway_frame import GeodeticPose, MapPose, runway_frame
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.errors import UsageError


def written(folder: Path, values: dict, name: str = 'own.yaml') -> Path:
    path = folder / name
    path.write_text(yaml.safe_dump(values))
    return path


def changed(where: str, value: object) -> dict:
    values = json.loads(json.dumps(OWN))
    *keys, last = where.split('.')
    part = values
    for key in keys:
        part = part[int(key)] if key.isdigit() else part[key]
    if value is None:
        del part[last]
    else:
        part[last] = value
    return values


@pytest.mark.parametrize('name', SHIPPED_PLACES)
def test_given_a_shipped_place_then_frame_document_and_paint_are_its_own(name):
    place = find_place(name)
    runway, frame = place.runway, runway_frame(place.runway)
    # KMWH's published length is 0.2 % short.
    assert frame.length_m == pytest.approx(runway.length_m, rel=3e-3)
    ahead = frame.to_geodetic(MapPose(x_m=0, y_m=0, z_m=0, yaw_rad=0)).heading_rad
    assert math.degrees(ahead) == pytest.approx(math.degrees(runway.bearing_rad), abs=0.1)
    again = find_place(place.document)
    assert (again.runway, again.digest) == (runway, place.digest)
    assert again.reference == f'{name}@{place.digest[:12]}' != place.reference
    corners = [corner for marking in markings(runway) for corner in marking.polygon]
    assert len(corners) > 300
    assert min(x for x, _ in corners) >= 0
    assert max(x for x, _ in corners) <= runway.length_m
    assert max(abs(y) for _, y in corners) <= runway.half_width_m


def test_given_the_shipped_places_then_they_differ_in_bearing_width_category_and_hemisphere():
    runways = [find_place(name).runway for name in SHIPPED_PLACES]
    assert len(runways) == 3
    assert len({round(math.degrees(runway.bearing_rad) / 10) for runway in runways}) == 3
    assert len({runway.width_m for runway in runways}) == 3
    assert len({runway.category for runway in runways}) == 2
    assert any(runway.threshold_deg[1] > 0 for runway in runways)


def test_given_keflavik_when_its_crossing_is_measured_then_it_is_where_01_19_is():
    runway = find_place('bikf_10').runway
    (crossing,) = runway.crossings
    frame = runway_frame(runway)
    south, north = (
        frame.to_map(GeodeticPose(
            latitude_rad=math.radians(latitude), longitude_rad=math.radians(longitude),
            altitude_m=0.0, heading_rad=0.0,
        ))
        for latitude, longitude in ((63.964487, -22.605428), (63.99186, -22.605407))
    )
    share = -south.y_m / (north.y_m - south.y_m)
    assert south.x_m + share * (north.x_m - south.x_m) == pytest.approx(crossing.x_m, abs=1.0)


def test_given_a_category_when_painted_then_it_has_the_circulars_kinds_of_marking():
    runway = find_place('bikf_10').runway

    def kinds(category: str) -> set[str]:
        edges = category == 'precision'
        told = dataclasses.replace(runway, category=category, edge_stripes=edges)
        return {marking.kind for marking in markings(told)}

    visual = {'designation', 'centreline'}
    assert kinds('visual') == visual
    assert kinds('nonprecision') == visual | {'threshold', 'aiming'}
    assert kinds('precision') == visual | {'threshold', 'aiming', 'touchdown', 'edge'}


@pytest.mark.parametrize(
    ('width_ft', 'stripes'), [(60, 4), (75, 6), (100, 8), (150, 12), (200, 16)]
)
def test_given_a_width_when_painted_then_the_threshold_has_the_circulars_stripes(width_ft, stripes):
    runway = dataclasses.replace(find_place('kmwh_04').runway, width_m=width_ft * 0.3048)
    at_an_end = [m for m in markings(runway) if m.kind == 'threshold' and m.polygon[0][0] < 100]
    assert len(at_an_end) == stripes


def test_given_a_file_when_read_then_length_and_bearing_are_those_of_its_ends(tmp_path):
    place = read_place(written(tmp_path, OWN))
    frame = runway_frame(place.runway)
    assert place.runway.length_m == pytest.approx(frame.length_m, abs=0.01)
    assert place.reference.startswith('own_16@')
    assert typed_place(str(tmp_path / 'own.yaml')) is typed_place(place.reference)


@pytest.mark.parametrize(('where', 'value', 'words'), [
    ('runway.width_m', 'wide', 'runway.width_m: expected a number, 15 to 80, got'),
    ('runway.width_m', None, "runway: the key 'width_m' is missing"),
    ('runway.lenght_m', 3000, 'runway.lenght_m: unknown key; known: ends'),
    ('runway.length_m', 3000, 'runway.length_m: the ends are 2097 m apart, not 3000'),
    ('runway.bearing_deg', 200, 'runway.bearing_deg: from end to end it is 161.72, not 200'),
    ('runway.category', 'cat3', 'runway.category: expected one of visual, nonprecision, precision'),
    ('runway.ends.0.designation', '37', "runway.ends[0].designation: expected a runway's number"),
    ('runway.ends.0.designation', '04', 'runway.ends: 04 and 34R are no opposite ends'),
    ('runway.ends.1.latitude_deg', 20, 'runway.ends: the ends are'),
    ('time_zone', 'Mars/Base', "time_zone: time zone 'Mars/Base' is unknown"),
    ('name', 'Own Place', 'name: expected a lower-case word'),
    ('runway.crossings', [{'x_m': 700, 'yaw_deg': 5, 'width_m': 30}],
     'runway.crossings[0].yaw_deg: expected an angle of 20 deg or more'),
    ('runway.crossings', [{'x_m': x, 'yaw_deg': 80, 'width_m': 30} for x in (700, 720)],
     'runway.crossings: those at 700 m and 720 m overlap'),
    ('lines', [{'style': 1, 'points_m': [[0, 0]]}],
     'lines[0].points_m: expected 2 or more lists [x, y], got [[0, 0]]'),
])
def test_given_a_bad_value_when_read_then_one_line_names_file_and_key(
    tmp_path, where, value, words
):
    path = written(tmp_path, changed(where, value))
    with pytest.raises(UsageError) as caught:
        read_place(path)
    assert str(caught.value).startswith(f'{path}: {words}')
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('numbers', 'north_deg', 'sign', 'refused'), [
    (('12', '30'), 49.0, 1, None),
    (('30', '12'), 64.9, 1, 'from 30 to 12 it is 118 deg true'),
    (('30', '12'), 65.1, 1, None),  # numbers of polar airports may follow the grid
    (('08', '26'), 49.0, 1, None),  # a variation of 38 degrees
    (('07', '25'), 49.0, 1, 'from 07 to 25 it is 118 deg true'),
    (('12', '30'), 49.0, -1, 'from 12 to 30 it is 242 deg true'),  # west written as east
])
def test_given_numbers_that_the_bearing_cannot_have_then_they_are_refused(
    tmp_path, numbers, north_deg, sign, refused
):
    turn_deg = 0.0094 / math.cos(math.radians(north_deg))
    values = changed('runway.ends', [
        {'designation': numbers[0], 'latitude_deg': north_deg, 'longitude_deg': sign * 20.0},
        {'designation': numbers[1], 'latitude_deg': north_deg - 0.005,
         'longitude_deg': sign * (20.0 + turn_deg)},
    ])
    path = written(tmp_path, values)
    if refused is None:
        assert read_place(path).runway.designations == numbers
    else:
        with pytest.raises(UsageError, match=f'runway.ends: {refused}'):
            read_place(path)


@pytest.mark.parametrize(('text', 'words'), [
    ('mars_04', "place is 'mars_04', not one of kmwh_04, bikf_10, nzqn_05, nor a YAML file"),
    ('own@0123456789ab', 'place own@0123456789ab is known by its digest only'),
    ('no.yaml', 'no.yaml: cannot be read'),
    ('{"name": 3}', 'place: name: expected'),
    ('{nothing', 'place: neither a name nor JSON'),
])
def test_given_no_place_when_typed_then_one_line_says_so(text, words):
    with pytest.raises(UsageError, match='place') as caught:
        typed_place(text)
    assert words in str(caught.value)


def test_given_a_place_of_ones_own_when_a_scene_is_there_then_it_carries_the_whole_of_it(tmp_path):
    path = written(tmp_path, OWN)
    scene = scenario_from_human({'place': str(path), 'distance': 1000})
    path.unlink()
    assert json.loads(scene.place) == OWN
    assert scene.runway.width_m == 45
    human = scene.to_human()
    assert human['place'] == find_place(scene.place).reference
    assert scenario_from_human(human) == scene


def test_given_a_place_when_a_start_is_not_on_its_runway_then_it_is_refused_there_only():
    far, wide = {'distance': 1700}, {'cross_track': 18}
    assert scenario_from_human({'place': 'kmwh_04', **far}).distance_m == 1700
    with pytest.raises(UsageError, match=r'distance_m is 1700, outside 0..1450.3 .*at nzqn_05'):
        scenario_from_human({'place': 'nzqn_05', **far})
    assert scenario_from_human({'place': 'nzqn_05', **wide}).cross_track_m == 18
    with pytest.raises(UsageError, match=r'cross_track_m is 18, outside -15\.\.15'):
        scenario_from_human({'place': 'kmwh_04', **wide})


def test_given_a_place_without_a_crossing_when_one_is_asked_for_then_it_is_refused_by_name():
    assert Scenario(place='nzqn_05').crossing is False
    assert scenario_from_human({'place': 'nzqn_05', 'crossing': False}).crossing is False
    with pytest.raises(UsageError, match='crossing has no effect at nzqn_05'):
        scenario_from_human({'place': 'nzqn_05', 'crossing': True})


def test_given_noon_when_the_sun_is_looked_for_then_it_stands_over_the_equators_side():
    for name, side_deg in (('kmwh_04', 180), ('bikf_10', 180), ('nzqn_05', 0)):
        azimuth, elevation = sun_position('2020-06-21', 12.5 * 3600, find_place(name).runway)
        off_deg = (math.degrees(azimuth) - side_deg + 180) % 360 - 180
        assert abs(off_deg) < 30, name
        assert elevation > 0.3, name


def test_given_summer_time_when_read_off_the_clock_then_the_sun_is_as_high_as_an_hour_earlier():
    runway = find_place('nzqn_05').runway
    winter = dataclasses.replace(runway, time_zone='UTC+12:00')
    summer, standard = (
        sun_position('2020-01-10', hour * 3600, one) for hour, one in ((13, runway), (12, winter))
    )
    assert summer == pytest.approx(standard)


@pytest.mark.parametrize('name', SHIPPED_PLACES)
@pytest.mark.parametrize(('cross_track_m', 'heading_rad'), [(8.0, -0.3), (-8.0, 0.5)])
def test_given_the_truth_when_steered_by_the_shipped_law_then_every_place_is_mastered(
    name, cross_track_m, heading_rad
):
    scene = Scenario(
        place=name, distance_m=300.0, cross_track_m=cross_track_m, heading_rad=heading_rad
    )
    judgement = run_closed_loop(
        scene, make_perception('truth'), specs=[SHIPPED['phi_eventually']]
    )
    assert judgement.complete
    assert judgement.satisfied
    assert not judgement.statistics.left_runway


@pytest.mark.parametrize('name', SHIPPED_PLACES[1:])
def test_given_a_start_far_out_when_judged_then_the_runways_own_edge_counts(name):
    runway = find_place(name).runway
    scene = Scenario(place=name, cross_track_m=runway.farthest_start_m, duration_s=1.0)
    judgement = run_closed_loop(scene, make_perception('truth'), specs=[SHIPPED['phi_always']])
    assert judgement.statistics.max_cross_track_m > 15.24
    assert not judgement.statistics.left_runway


def test_given_another_width_when_judged_by_the_papers_edge_then_the_line_to_write_is_told():
    scene = Scenario(place='nzqn_05', duration_s=1.0)
    fix = r'here it is 45 m; write inside=always\(abs\(cte\) <= 22.5\)'
    with pytest.raises(UsageError, match=fix):
        run_closed_loop(scene, make_perception('truth'), specs=[SHIPPED['on_runway']])


def test_given_places_when_photographed_then_each_looks_like_itself():
    looks = set()
    for name in SHIPPED_PLACES:
        scene = Scenario(place=name, shadows=False)
        looks.add(Camera(scene).render(Aircraft(scene).state, 0).tobytes())
    assert len(looks) == 3


def test_given_a_file_of_a_places_json_then_it_is_that_place_and_other_files_are_refused(tmp_path):
    place = dataclasses.replace(find_place('bikf_10'), shipped=False)
    path = tmp_path / f'place-{place.reference}.json'
    path.write_text(place.document)
    assert typed_place(str(path)).reference == place.reference
    for text, why in (('{"name": 3', 'neither a name nor JSON'), ('no json', 'not one of'),
                      ('\xff', 'not one of')):
        path.write_text(text)
        with pytest.raises(UsageError, match=why):
            typed_place(str(path))
    path.write_bytes(b'\xff')
    for wrong in (path, tmp_path / 'no.json', tmp_path):
        with pytest.raises(UsageError) as error:
            typed_place(f'{wrong}' if wrong.suffix else f'{wrong}/.json')
        assert 'cannot be read' in str(error.value)
        assert '\n' not in str(error.value)
