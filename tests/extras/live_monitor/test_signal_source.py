from array import array
from types import SimpleNamespace

import pytest

from taxinet_ros.core.mtl.parser import parse
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.live_monitor.signal_source import (
    check_field,
    number_at,
    parse_field_path,
    parse_signals,
)

TYPES = {
    'x/Odom': {'header': 'x/Header', 'pose': 'x/PoseCov', 'name': 'string', 'ok': 'boolean'},
    'x/Header': {'frame_id': 'string'},
    'x/PoseCov': {'pose': 'x/Point', 'covariance': 'double[36]'},
    'x/Point': {'x': 'double', 'y': 'double'},
    'x/Scan': {'ranges': 'sequence<float>', 'few': 'sequence<int8, 5>', 'at': 'sequence<x/Point>'},
}


@pytest.mark.parametrize(
    ('text', 'kind'),
    [
        ('pose.pose.y', 'x/Odom'), ('pose.covariance[35]', 'x/Odom'), ('ok', 'x/Odom'),
        ('ranges[700]', 'x/Scan'), ('few[0]', 'x/Scan'), ('at[3].x', 'x/Scan'),
    ],
)
def test_given_a_path_to_a_number_then_it_passes_and_prints_as_written(text, kind):
    path = parse_field_path(text)
    check_field(path, kind, TYPES.__getitem__)
    assert str(path) == text


@pytest.mark.parametrize(
    ('text', 'kind', 'words'),
    [
        ('poze.pose.y', 'x/Odom', "x/Odom has no field 'poze'; did you mean pose?; its fields: "
         'header, pose, name, ok'),
        ('pose.pose.w', 'x/Odom', "pose.pose (x/Point) has no field 'w'; its fields: x, y"),
        ('pose.pose', 'x/Odom', 'pose.pose is a x/Point, no number; it has: x, y'),
        ('name', 'x/Odom', 'name is a string, no number'),
        ('name.size', 'x/Odom', "name is a string, it has no field 'size'"),
        ('pose.covariance', 'x/Odom', 'is an array, double[36]: write pose.covariance[0]'),
        ('pose.covariance[36]', 'x/Odom', 'there are 36 elements, from [0] on'),
        ('pose.pose.x[0]', 'x/Odom', 'pose.pose.x is a double, no array: leave [0] out'),
        ('at.x', 'x/Scan', 'at is an array, sequence<x/Point>: write at[0]'),
    ],
)
def test_given_a_path_to_no_number_then_the_message_names_what_there_is(text, kind, words):
    with pytest.raises(UsageError) as raised:
        check_field(parse_field_path(text), kind, TYPES.__getitem__)
    assert words in str(raised.value)


@pytest.mark.parametrize('text', ['', 'a..b', 'a[-1]', 'a[x]', 'a b', '[0]', 'a.__class__'])
def test_given_no_path_then_the_message_shows_one(text):
    with pytest.raises(UsageError, match=r'write one such as pose\.pose\.position\.y'):
        parse_field_path(text)


def test_given_a_message_then_the_number_is_the_field_s_times_the_factor():
    message = SimpleNamespace(ranges=array('f', [0.5, 2.0]), level=b'\x02', ok=True)
    near, level, ok = parse_signals(['a=/s:ranges[1]*-10', 'b=/s:level', ' c = /s : ok '])
    assert [near.read(message), level.read(message), ok.read(message)] == [
        (-20.0, ''), (2.0, ''), (1.0, ''),
    ]
    with pytest.raises(LookupError, match=r'ranges has 2 elements, no \[2\]'):
        number_at(message, parse_field_path('ranges[2]'))
    (far,) = parse_signals(['far=/s:ranges[2]'])
    value, trouble = far.read(message)
    assert value != value
    assert trouble == 'far: ranges has 2 elements, no [2]'


def test_people2_given_a_signal_with_a_unit_then_formulas_about_it_are_checked():
    texts = ['gap[m]=/scan:ranges[0]', 'tilt [rad] = /imu:roll*0.0174', 'share[1]=/s:x', 'v=/s:y']
    sources = parse_signals(texts)
    assert [source.unit for source in sources] == ['m', 'rad', '1', '']
    assert [str(source) for source in sources][:2] == [
        'gap[m]=/scan:ranges[0]', 'tilt[rad]=/imu:roll*0.0174'
    ]
    signals = {source.name: source.unit for source in sources}
    near = parse('gap >= 50 cm and abs(tilt) <= 90 deg and share < 5 % and v < 3 km/h', signals)
    assert str(near.left.left.left) == 'gap >= 0.5'
    with pytest.raises(UsageError, match=r'column 8: expected a length .* to go with gap'):
        parse('gap >= 5 deg', signals)


@pytest.mark.parametrize(
    ('texts', 'words'),
    [
        (['cte'], 'expected NAME=/topic:field'), (['cte=/odom'], 'expected NAME=/topic:field'),
        (['G=/odom:x'], "name 'G'"), (['a-b=/odom:x'], "name 'a-b'"),
        (['a=/odom:x*two'], "factor 'two'"), (['a=/odom:x*0'], "factor '0'"),
        (['a[deg]=/odom:x'], "unit 'deg': formulas compare in SI: one of m, s, rad, m/s, rad/s"),
        (['a[furlong]=/odom:x'], "unit 'furlong'"), (['a[]=/odom:x'], "unit ''"),
        (['a=/odom:x', 'a=/odom:y'], 'there is a a already'), (['a=/odom:x['], 'is no field'),
    ],
)
def test_given_a_bad_signal_then_the_message_says_which_and_why(texts, words):
    with pytest.raises(UsageError) as raised:
        parse_signals(texts)
    assert str(raised.value).startswith(f'signals: {texts[-1]!r}: ')
    assert words in str(raised.value)
