"""Others on the ground: read strictly, written canonically, and moved along their paths."""

import itertools
import json
import math

import pytest

from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.traffic.traffic import KINDS
from taxinet_ros.core.traffic.traffic_file import (
    find_traffic,
    load_traffic,
    traffic_words,
    typed_traffic,
)
from taxinet_ros.errors import UsageError

NS_PER_S = 1_000_000_000
VAN = {
    'kind': 'vehicle', 'x_m': 500, 'y_m': -20, 'heading_deg': 90, 'wait_s': 2,
    'path': [
        {'x_m': 500, 'y_m': 20, 'speed_mps': 4, 'wait_s': 3},
        {'x_m': 530, 'y_m': 20, 'speed_mps': 10},
    ],
}


def first(*objects):
    return find_traffic(load_traffic(objects)).objects[0]


def poses(one, *times_s):
    return [one.pose_at(round(time_s * NS_PER_S)) for time_s in times_s]


def test_given_a_path_when_time_goes_by_then_it_waits_moves_waits_and_stays():
    van = first(VAN)
    places = [(round(x, 9), round(y, 9)) for x, y, _ in poses(van, 0, 2, 7, 12, 14, 15, 16.5, 99)]
    assert places == [
        (500, -20), (500, -20), (500, 0), (500, 20), (500, 20), (500, 20), (515, 20), (530, 20)
    ]


def test_given_a_path_then_it_starts_as_it_faces_and_turns_as_something_on_wheels_does():
    van = first(VAN)
    begin, straight, corner, end = (
        math.degrees(pose.heading_rad) for pose in poses(van, 0, 7, 14, 18)
    )
    assert (begin, straight, end) == (pytest.approx(90), pytest.approx(90), pytest.approx(0))
    assert 40 < corner < 50
    turns = [pose.heading_rad for pose in poses(van, *(11 + k / 100 for k in range(600)))]
    most = max(abs(b - a) for a, b in itertools.pairwise(turns))
    assert most < math.radians(10), 'it never jumps round'
    across = first({**VAN, 'heading_deg': 0})
    assert poses(across, 0)[0].heading_rad == pytest.approx(0)
    assert poses(across, 7)[0].heading_rad == pytest.approx(math.pi / 2)


def test_given_a_path_that_leads_back_then_there_is_a_pose_at_every_moment():
    back = first({
        'kind': 'person', 'x_m': 0, 'y_m': 0, 'path': [
            {'x_m': 10, 'y_m': 0, 'speed_mps': 1}, {'x_m': 0, 'y_m': 0, 'speed_mps': 1},
        ],
    })
    found = poses(back, *(k / 100 for k in range(2100)))
    assert all(math.isfinite(pose.heading_rad) and 0 <= pose.x_m <= 10 for pose in found)
    assert found[-1].x_m == 0


def test_given_a_wait_where_a_path_leads_back_then_it_faces_as_it_came():
    back = first({
        'kind': 'vehicle', 'x_m': 0, 'y_m': 0, 'heading_deg': 90, 'path': [
            {'x_m': 30, 'y_m': 0, 'speed_mps': 5, 'wait_s': 4},
            {'x_m': 0, 'y_m': 0, 'speed_mps': 5},
        ],
    })
    assert [pose.heading_rad for pose in poses(back, 5.9, 6, 8, 10)] == [0, 0, 0, 0]


@pytest.mark.parametrize('kind', KINDS)
def test_given_a_kind_then_its_size_is_as_usual_unless_the_object_says_another(kind):
    assert first({'kind': kind, 'x_m': 1, 'y_m': 2}).size == KINDS[kind].size
    assert first({'kind': kind, 'x_m': 1, 'y_m': 2, 'width_m': 3}).size.width_m == 3


def test_given_the_same_objects_then_text_and_reference_are_the_same_however_they_are_written():
    text = load_traffic([{'kind': 'cone', 'y_m': 2.0, 'x_m': 430, 'heading_deg': 0}])
    assert text == '{"objects":[{"kind":"cone","x_m":430.0,"y_m":2.0}]}'
    spaced = json.dumps({'objects': [{'x_m': 430, 'y_m': 2, 'kind': 'cone', 'length_m': 0.4}]})
    scene = Scenario(traffic=spaced)
    assert scene.traffic == text
    reference = scene.to_human()['traffic']
    assert reference.startswith('1_objects@')
    assert scenario_from_human({'traffic': reference}) == scene
    assert load_traffic([VAN]) != load_traffic([{**VAN, 'wait_s': 2.5}])
    shy = load_traffic([{**VAN, 'stands_within_m': 9, 'starts_within_m': 40}])
    assert 'within' not in load_traffic([VAN])
    assert find_traffic(shy).objects[0].stands_within_m == 9
    assert find_traffic(shy).text == shy
    assert find_traffic(load_traffic([VAN])).text == load_traffic([VAN])


def test_given_objects_when_said_then_by_number_and_kind():
    kinds = ('patch', 'hold_line', 'patch', 'aircraft', 'aircraft')
    text = load_traffic([{'kind': kind, 'x_m': 430 + k, 'y_m': 2} for k, kind in enumerate(kinds)])
    assert traffic_words(find_traffic(text).reference) == '2 patches, 1 hold line and 2 aircraft'


def test_given_a_file_when_typed_then_its_objects_are_there(tmp_path):
    path = tmp_path / 'busy.yaml'
    path.write_text('objects:\n  - {kind: cone, x_m: 430, y_m: 2}\n')
    assert load_traffic(path) == load_traffic([{'kind': 'cone', 'x_m': 430, 'y_m': 2}])
    assert scenario_from_human({'traffic': str(path)}).others.objects[0].x_m == 430
    assert scenario_from_human({'traffic': 'nobody'}) == Scenario()
    assert not typed_traffic('nobody').objects


@pytest.mark.parametrize(('objects', 'words'), [
    ([], r'objects: expected a list of entries'),
    ([{'kind': 'truck', 'x_m': 1, 'y_m': 1}], r'objects\[0\].kind: expected one of aircraft'),
    ([{'kind': 'cone', 'x_m': 1}], r"objects\[0\]: the key 'y_m' is missing"),
    ([{'kind': 'cone', 'x_m': 1, 'y_m': 1, 'colour': 'pink'}], 'colour: expected one of white'),
    ([{'kind': 'cone', 'x_m': 1, 'y_m': 1, 'speed': 3}], r'objects\[0\].speed: unknown key'),
    ([{'kind': 'cone', 'x_m': 1, 'y_m': 1, 'height_m': 0}], 'height_m: expected a number, 0.1'),
    ([{'kind': 'patch', 'x_m': 1, 'y_m': 1, 'height_m': 1}], 'height_m: patch lies on the ground'),
    ([{'kind': 'cone', 'x_m': 1, 'y_m': 1, 'wait_s': 3}], 'wait_s: has no effect without a path'),
    ([{'kind': 'cone', 'x_m': 1, 'y_m': 1, 'stands_within_m': 9}], 'within_m: has no effect with'),
    ([{'kind': 'cone', 'x_m': 1, 'y_m': 1, 'starts_within_m': 9}], 'within_m: has no effect with'),
    ([{'kind': 'patch', 'x_m': 1, 'y_m': 1, 'stands_within_m': 9}], 'within_m: patch lies on the'),
    ([{'kind': 'patch', 'x_m': 1, 'y_m': 1, 'starts_within_m': 9}], 'within_m: patch lies on the'),
    ([{**VAN, 'stands_within_m': 0}], 'stands_within_m: expected a number, 1 to 1000'),
    ([{**VAN, 'starts_within_m': -5}], 'starts_within_m: expected a number, 1 to 1000'),
    ([{**VAN, 'stands_within_m': '9 m'}], 'stands_within_m: expected a number'),
    ([{**VAN, 'path': [{'x_m': 500, 'y_m': -20, 'speed_mps': 1}]}], 'it is there already'),
    ([{**VAN, 'path': [{'x_m': 5, 'y_m': 5, 'speed_mps': 0}]}], 'speed_mps: expected a number'),
    ([{'kind': 'cone', 'x_m': float('nan'), 'y_m': 1}], 'x_m: expected a number'),
    ([{'kind': 'cone', 'x_m': 1, 'y_m': 1}] * 33, '33 of them, more than 32'),
])
def test_given_objects_that_cannot_be_then_one_line_says_which_and_why(objects, words):
    with pytest.raises(UsageError, match=words):
        load_traffic(objects)


@pytest.mark.parametrize(('text', 'words'), [
    ('trucks', 'not one of nobody, nor a YAML file of others on the ground'),
    ('2_objects@000000000000', 'known by its digest only'),
    ('missing.yaml', 'traffic missing.yaml: cannot be read'),
    ('{"objects"', 'traffic: neither a name nor JSON of others on the ground'),
])
def test_given_a_word_that_is_no_traffic_then_one_line_says_so(text, words):
    with pytest.raises(UsageError, match=words):
        typed_traffic(text)
