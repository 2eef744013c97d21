"""Places out of an apt.dat: a small one of an airport that does not exist."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import pytest

from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.place.apt_dat import read_airport_place
from taxinet_ros.core.place.catalogue import find_place, typed_place
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.errors import UsageError

HEADER = 'I\n1100 Version - written for a test\n\n'
OTHER = '1 10 0 0 XTS Too short\n100 30 1 0 0.25 0 2 0 09 1 2 0 0 1 0 0 0 27 1 3 0 0 1 0 0 0\n\n'
RUNWAYS = """\
1    328 0 0 XTST Test Field
1302 city Nowhere
100 30.00 1 0 0.25 0 2 0 09 50.0 8.0 60 0 2 0 0 0 27 50.0 8.028 0 0 3 0 0 0
100 45.00 2 0 0.25 0 2 0 01L 49.99 8.014 0 0 3 0 0 0 19R 50.01 8.014 0 0 3 0 0 0
100 18.00 3 0 0.25 0 2 0 05 49.99 8.001 0 0 1 0 0 0 23 50.01 8.021 0 0 1 0 0 0
101 49 1 08 35.04420911 -106.59855700 26 35.04420911 -106.59855711
"""
GROUND = """\
110 2 0.25 150.29 apron
111 50.001 8.002
111 50.001 8.004
111 50.002 8.004
113 50.002 8.002
111 50.0012 8.0025
111 50.0012 8.0030
113 50.0015 8.0030
120 yellow line
111 50.0005 8.002 1
112 50.0005 8.003 50.0005 8.004 1
115 50.0015 8.004
20 50.0 8.0 0 0 1 {@Y}A
1200
1201 50.0005 8.002 both 0 A1
1201 50.0005 8.006 both 1 A2
1202 0 1 oneway taxiway_C A
1202 1 7 twoway taxiway_C A
"""
AFTER = '\n17 0 0 0 XHEL A heliport\n99\n'


def written(folder: Path, text: str = HEADER + OTHER + RUNWAYS + GROUND + AFTER) -> Path:
    path = folder / 'apt.dat'
    path.write_text(text, encoding='utf-8')
    return path


def test_given_an_airport_when_read_then_the_runway_is_as_its_row_has_it(tmp_path):
    place = read_airport_place(written(tmp_path), 'xtst', '9')
    runway = place.runway
    assert (place.name, place.title) == ('xtst_09', 'Test Field (XTST) runway 09')
    assert runway.designations == ('09', '27')
    assert runway.length_m == pytest.approx(2008, abs=1)
    assert math.degrees(runway.bearing_rad) == pytest.approx(90, abs=0.02)
    assert (runway.width_m, runway.elevation_m, runway.surface) == (30, 99.97, 'asphalt')
    assert (runway.displaced_m, runway.category) == ((60, 0), 'precision')
    assert runway.time_zone == 'UTC+01:00'


def test_given_the_other_end_when_read_then_it_is_turned_round(tmp_path):
    runway = read_airport_place(written(tmp_path), 'XTST', '27').runway
    assert runway.designations == ('27', '09')
    assert math.degrees(runway.bearing_rad) == pytest.approx(270, abs=0.02)
    assert runway.displaced_m == (0, 60)


def test_given_wider_runways_across_then_they_cross_and_narrower_ones_do_not(tmp_path):
    path = written(tmp_path)
    (crossing,) = read_airport_place(path, 'XTST', '09').runway.crossings
    assert crossing.x_m == pytest.approx(1004, abs=1)
    assert crossing.width_m == 45
    assert math.degrees(crossing.yaw_rad) == pytest.approx(90, abs=0.1)
    assert read_airport_place(path, 'XTST', '01L').runway.crossings == ()


def test_given_ground_when_read_then_areas_lines_and_routes_are_in_the_runways_frame(tmp_path):
    place = read_airport_place(written(tmp_path), 'XTST', '09')
    apron, *others = place.pavements
    assert (apron.surface, len(apron.outline), len(apron.holes)) == ('concrete', 4, 1)
    assert [other.surface for other in others] == ['concrete', 'other']
    assert apron.outline[0] == pytest.approx((143.4, 111.2), abs=0.5)
    (line,) = place.lines
    assert line.style == 1
    assert len(line.points) == 2 + 8 + 8 - 1
    assert line.points[-1] == pytest.approx((286.8, 166.9), abs=0.5)
    (route,) = place.routes
    assert (route.name, route.one_way, route.on_runway) == ('A', True, False)


def test_given_nodes_with_types_when_read_then_each_part_is_a_line_of_its_own(tmp_path):
    ground = """\
110 1 0.25 0 taxiway
111 50.001 8.002 3
111 50.001 8.004 3 102
111 50.002 8.004 102
113 50.002 8.002
120 line
111 50.0005 8.002 1
111 50.0005 8.003 51
111 50.0005 8.004 51
115 50.0005 8.005
120 light
111 50.0005 8.002 101
115 50.0005 8.003
"""
    place = read_airport_place(written(tmp_path, HEADER + RUNWAYS + ground + AFTER), 'XTST', '09')
    assert [(line.style, len(line.points)) for line in place.lines] == [(3, 3), (1, 2), (51, 3)]
    assert place.lines[1].points[-1] == place.lines[2].points[0]
    assert place.pavements[0].outline[:3] == place.lines[0].points


def test_given_a_packed_file_when_read_then_it_is_the_same_place(tmp_path):
    path = written(tmp_path)
    packed = tmp_path / 'apt.dat.gz'
    packed.write_bytes(gzip.compress(path.read_bytes()))
    there = read_airport_place(path, 'XTST', '09')
    assert read_airport_place(packed, 'XTST', '09') == there
    assert find_place(there.document).runway == there.runway


def test_given_a_file_that_is_written_again_then_its_new_airport_is_read(tmp_path):
    there = typed_place(f'{written(tmp_path)}:XTST/09')
    assert typed_place(f'{tmp_path}/apt.dat:XTST/09') is there
    text = HEADER + OTHER + RUNWAYS.replace('100 30.00', '100 60.0') + GROUND + AFTER
    assert typed_place(f'{written(tmp_path, text)}:XTST/09').runway.width_m == 60
    (tmp_path / 'apt.dat').unlink()
    with pytest.raises(UsageError, match='cannot be read'):
        typed_place(f'{tmp_path}/apt.dat:XTST/09')


def test_given_a_place_typed_as_file_and_runway_then_scenes_are_there(tmp_path):
    path = written(tmp_path)
    scene = scenario_from_human({'place': f'{path}:XTST/27', 'distance': 1000})
    assert scene.runway.designations == ('27', '09')
    there = typed_place(f'{path}:XTST/27@Europe/Berlin')
    assert there.runway.time_zone == 'Europe/Berlin'


@pytest.mark.parametrize(('text', 'words'), [
    ('', 'is empty'),
    ('PK\n1100\n', 'row 1: no apt.dat'),
    ('I\nnone\n', 'row 1: no apt.dat'),
    ('I\n715 Version\n1 0 0 0 XTST Old\n', 'row 2: version 715; read are 1000 to 1200'),
    (HEADER + OTHER + AFTER, 'has no airport XTST'),
    (HEADER + OTHER + RUNWAYS.replace('100 30.00', '100 broad'), 'row 9: width: expected a number'),
    (HEADER + OTHER + RUNWAYS.replace(' 27 50.0 8.028 0 0 3 0 0 0', ''), 'row 9: a runway has 25'),
    (HEADER + OTHER + RUNWAYS.replace('27 50.0 8.028', '27 95.0 8.028'),
     'row 9: no position on the Earth: 95 8.028'),
    (HEADER + OTHER + RUNWAYS.replace('27 50.0 8.028', '27 50.0 8.0'),
     'row 9: both ends are at the same point'),
    (HEADER + OTHER + RUNWAYS + 'rubbish here\n', "row 13: no row code: 'rubbish'"),
    (HEADER + OTHER + RUNWAYS + GROUND.replace('111 50.001 8.002\n', '111 50.001\n'),
     "row 14: a coordinate: expected a number, got 'nothing'"),
    (HEADER + OTHER + RUNWAYS.replace('100 30.00 1', '100 30.00 4'),
     'row 9: the surface 4 is neither asphalt nor concrete'),
])
def test_given_a_broken_or_foreign_file_when_read_then_one_line_says_which_row(
    tmp_path, text, words
):
    path = written(tmp_path, text)
    with pytest.raises(UsageError) as caught:
        read_airport_place(path, 'XTST', '09')
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
    assert '\n' not in str(caught.value)


def test_given_no_such_runway_when_asked_for_then_those_that_there_are_are_named(tmp_path):
    with pytest.raises(UsageError, match="has no runway '36'; it has 09, 27, 01L, 19R, 05, 23"):
        read_airport_place(written(tmp_path), 'XTST', '36')


@pytest.mark.parametrize(('text', 'words'), [
    (':XTST', 'XTST needs a runway, as in KSEA/16L; it has 09, 27, 01L, 19R, 05, 23'),
    (':XTST/', 'XTST needs a runway, as in KSEA/16L; it has 09'),
    ('', 'name an airport and a runway, as '),
])
def test_given_a_file_without_a_runway_when_typed_then_it_is_said_what_is_missing(
    tmp_path, text, words
):
    with pytest.raises(UsageError, match=words):
        typed_place(f'{written(tmp_path)}{text}')


def test_given_taxi_routes_when_followed_then_a_run_goes_off_the_runway_along_them(tmp_path):
    network = (
        '1201 50.0000 8.006 both 0 on the runway\n1201 50.0020 8.006 both 1 corner\n'
        '1201 50.0020 8.010 both 2 apron\n1201 50.0030 8.010 both 3 hangar\n'
        '1202 0 1 twoway taxiway_C A\n1202 1 2 twoway taxiway_C B\n1202 2 3 twoway taxiway_C C\n'
    )
    path = written(tmp_path, HEADER + OTHER + RUNWAYS + network + AFTER)
    start = scenario_from_human({
        'place': f'{path}:XTST/09', 'track': 'A+B', 'distance': 150, 'cross_track': -2,
        'heading': 5,
    })
    assert find_place(start.place).track_names == ('runway', 'A', 'B', 'C')
    path.unlink()
    bend = start.line.legs[1]
    assert (bend.curvature, start.line.width_m) == (-1 / 30, 15.0)
    assert bend.start_m == pytest.approx(192.5, abs=1), '0.002 deg of latitude, less the arc'
    steps = []
    judged = run_closed_loop(
        start, make_perception('truth'), specs=[SHIPPED['phi_eventually']], on_step=steps.append
    )
    assert judged.satisfied
    last = steps[-1].observation.state
    assert last.y_m == pytest.approx(222.5, abs=2)
    assert math.degrees(last.yaw_rad) == pytest.approx(0, abs=2)
