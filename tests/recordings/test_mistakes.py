"""Recordings that are wrong: one line names the likely mistake."""

import math
import re

import numpy as np
import pytest
from synthetic import BEGUN_NS, PERIOD_NS, Drive, fix, image, odometry, path, pixels_of

from taxinet_ros.errors import UsageError


def quarter(heading):
    return -heading


def weave(t):
    y, slope = 2 * math.sin(t / 3), 2 / 3 * math.cos(t / 3)
    return 500 + 5 * t, y, math.atan2(slope, 5)


MISTAKES = {
    'another place by a kilometre': (Drive(shift_deg=0.01), {}, r'off runway of kmwh_04, by 9\d\d'),
    'a time zone': (
        Drive(stamp=lambda kind, ns: ns + 8 * 3600 * 10**9 * (kind == 'image')), {},
        r'\+8 h: a time zone'),
    'no stamps': (
        Drive(stamp=lambda kind, ns: 0 if kind == 'image' else ns), {}, 'have no stamps'),
    'a computer that counts from its start': (
        Drive(stamp=lambda kind, ns: ns - BEGUN_NS + 10**9 if kind == 'image' else ns), {},
        'one counts from the start of a computer'),
    'a clock that was set': (
        Drive(stamp=lambda kind, ns: ns + 5 * 10**9 * (
            kind == 'image' and ns > BEGUN_NS + 30 * 10**9)), {},
        r'clock leaps by \+5.0 s at message 301'),
    'the heading of a compass': (
        Drive(heading=lambda h: h), {}, 'other convention; read it with heading_is compass'),
    'a heading from north': (
        Drive(heading=quarter), {}, r'its zero is another axis .* heading_offset -?90'),
    'a magnetic heading': (
        Drive(heading=lambda h: math.pi / 2 - h + math.radians(15)), {},
        'magnetic instead of true north.*heading_offset 15.0'),
    'a heading of something else': (
        Drive(heading=lambda h: 20 * h), {}, 'nothing to do with the direction of motion'),
    'mirrored pictures': (
        Drive(picture=lambda pixels: np.ascontiguousarray(pixels[:, ::-1])), {},
        'the pictures are mirrored'),
    'a sign': (Drive(), {'perception': 'turned'}, 'the signs of truth or network'),
    'degrees': (Drive(), {'perception': 'in_degrees'}, 'heading error is in degrees'),
    'the other direction': (
        Drive(along=lambda t: (1500 - 5 * t, 0.0, math.pi)), {}, 'against the direction of runway'),
    'two cameras on a topic': (
        Drive(more=[('/cam', 'sensor_msgs/msg/Image', image(
            pixels_of(0, 0, (8, 12)), BEGUN_NS + 50_000_000, 'rgb8', 'right'), BEGUN_NS)]), {},
        'pictures of two cameras on one topic: camera .601., right .1.'),
    'an encoding': (
        Drive(more=[('/cam', 'sensor_msgs/msg/Image', image(
            pixels_of(0, 0, (8, 12)), BEGUN_NS, 'mono16'), BEGUN_NS)]), {},
        "1 pictures: image encoding is 'mono16'"),
    'another frame of poses': (
        Drive(truth='odometry'), {'topic': '/odom', 'frame': '47.3,-119.4'},
        r'another runway \(track\), or another frame'),
    'clocks that differ by half a period': (
        Drive(along=weave, stamp=lambda kind, ns: ns + 8 * 10**9 * (kind == 'image')), {},
        'fall where the truth rises.*; or the clocks differ by seconds'),
}


OFTEN = 'a time zone', 'mirrored pictures', 'a sign', 'degrees', 'the other direction'


@pytest.mark.parametrize(('drive', 'more', 'line'), [
    pytest.param(*case, id=name, marks=[] if name in OFTEN else pytest.mark.nightly)
    for name, case in MISTAKES.items()
])
def test_given_a_mistake_then_a_line_names_it(scored, drive, more, line):
    try:
        lines = scored(drive, **more).notes
    except UsageError as error:
        lines = [str(error)]
    found = [one for one in lines if re.search(line, one)]
    assert len(found) == 1, lines
    assert '\n' not in found[0]


def test_given_a_good_recording_then_no_line_is_printed(scored):
    assert scored(Drive()).notes == []
    assert scored(Drive(noise_m=0.3, late_s=0.1)).notes == []
    assert scored(Drive(), heading='').notes == []


REFUSED = {
    'no truth': (Drive(seconds=3), {'topic': '/truth'}, r'/truth is not in it; what fits: /fix'),
    'another type': (Drive(seconds=3), {'topic': '/cam'}, '/cam is a sensor_msgs/msg/Image'),
    'no frame': (
        Drive(seconds=3, truth='odometry'), {'topic': '/odom'}, r'name their frame: runway, or '),
    'a frame without effect': (Drive(seconds=3), {'frame': 'runway'}, 'leave it out'),
    'no such transform': (
        Drive(seconds=3, truth='tf'), {'topic': '/tf:world:base_link', 'frame': 'runway'},
        'no transforms lead from world to base_link; recorded are map:odom, odom:base_link'),
    'no heading topic': (Drive(seconds=3), {'heading': '/compass'}, 'heading /compass: no such'),
    'a heading that is none': (Drive(seconds=3), {'heading': '/fix'}, 'expected one of '),
    'several truths': (
        Drive(seconds=3, truth='odometry', more=[('/odom2', 'nav_msgs/msg/Odometry', odometry(
            0, 0, 0, BEGUN_NS), BEGUN_NS)]), {'topic': ''}, 'several: .* name one as truth'),
}


@pytest.mark.parametrize(('drive', 'more', 'line'), REFUSED.values(), ids=REFUSED)
def test_given_what_cannot_be_used_then_it_is_refused_in_a_line(scored, drive, more, line):
    with pytest.raises(UsageError, match=line):
        scored(drive, **more)


def test_given_positions_without_a_fix_then_they_are_counted_and_left_out(scored):
    lost = [
        ('/fix', 'sensor_msgs/msg/NavSatFix', fix(0.0, 0.0, stamp_ns, status=-1), stamp_ns + 1)
        for stamp_ns in range(BEGUN_NS, BEGUN_NS + 7 * PERIOD_NS, PERIOD_NS)
    ]
    found = scored(Drive(seconds=5, more=lost))
    assert any('7 samples left out: no fix' in note for note in found.notes)
    with pytest.raises(UsageError, match='1 usable samples; name another topic'):
        scored(Drive(seconds=5), keep=lambda topic, number: topic != '/fix' or number < 1)


def test_given_a_path_then_it_is_smooth():
    assert abs(path(3.0)[1] - path(3.001)[1]) < 0.01
