"""Others on the ground in Scenic programs: evaluated to data; the rest is refused by name."""

import contextlib
import math

import pytest

from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.programs import scenario_program
from taxinet_ros.scenes.source import Rejected, SceneSource, sample_scenarios
from taxinet_ros.trials.campaign import ProgramOrder
from taxinet_ros.trials.options import make_options

HEAD = 'model runway_world\nego = new Plane at (0, 400)\n'
BUSY = HEAD + """
y = Range(450, 520)
class Tug(Vehicle):
    colour: 'blue'
    length: 3
van = new Vehicle at (30, y), facing 90 deg, with behavior CrossRunway(Range(3, 6), delay=2)
new ParkedAircraft at (-25, Range(500, 600)), facing -90 deg
new Tug at (10, 480), with behavior GoStraight(5, 30)
new Person at (4, 470), with behavior FollowPath([(-4, 470), (-4 @ 480)], speed=1.5, wait=2)
new Cone at (5, 430), with colour 'red'
new ClosedMarking at (0, 480), facing 10 deg
"""


def test_given_ground_objects_then_a_scene_has_them_in_map(write):
    (scene,) = sample_scenarios(write(BUSY), 3, 1)
    van, parked, tug, person, cone, cross = scene.others.objects
    assert (van.kind, van.y_m, van.heading_deg, van.wait_s) == ('vehicle', -30.0, 90.0, 2.0)
    assert 450 <= van.x_m <= 520
    (leg,) = van.path
    assert (leg.x_m, leg.y_m) == (van.x_m, 30.0)
    assert 3 <= leg.speed_mps <= 6
    assert (parked.kind, parked.y_m, parked.heading_deg) == ('aircraft', 25.0, -90.0)
    assert (tug.colour, tug.size.length_m, tug.size.width_m) == ('blue', 3.0, 2.1)
    assert [(leg.x_m, leg.y_m) for leg in tug.path] == [(510.0, -10.0)]
    assert [(leg.x_m, leg.y_m, leg.speed_mps, leg.wait_s) for leg in person.path] == [
        (470.0, 4.0, 1.5, 2.0), (480.0, 4.0, 1.5, 2.0)
    ]
    assert (cone.colour, cone.x_m, cone.y_m) == ('red', 430.0, -5.0)
    assert (cross.solid, cross.heading_deg) == (False, pytest.approx(10))
    assert scene.others.text == scene.traffic


def test_given_distances_to_the_aircraft_then_they_are_of_the_object_and_are_searched(write):
    path = write(HEAD + """
van = new Vehicle at (30, 450), facing 90 deg, with behavior CrossRunway(
    4, delay=2, starts_within=Range(20, 60))
new Vehicle at (0, 380), with behavior FollowPath([(0, 800)], 8, 0, 0, Range(15, 20))
""")
    with SceneSource(path, seed=1) as source:
        assert [one.name for one in source.space()] == ['van.behavior', 'object2.behavior']
        low, high = (source.scene(0, (share,) * 2).others.objects for share in (0.0, 0.999999))
    assert [(one.stands_within_m, one.starts_within_m) for one in low] == [(0, 20), (15, 0)]
    assert high[0].starts_within_m == pytest.approx(60, abs=1e-4)
    assert high[1].stands_within_m == pytest.approx(20, abs=1e-4)
    assert (low[0].wait_s, low[0].path[0].speed_mps) == (2, 4)


def test_given_random_places_then_they_are_dimensions_and_points_set_them(write):
    with SceneSource(write(BUSY), seed=1) as source:
        names = [dimension.name for dimension in source.space()]
        assert names == ['y', 'van.behavior', 'object2.position.y']
        assert source.search_space().drawn == {'traffic'}
        low, high = (source.scene(0, (share,) * 3) for share in (0.0, 0.999999))
        assert [one.x_m for one in low.others.objects[:2]] == [450.0, 500.0]
        assert high.others.objects[0].path[0].speed_mps == pytest.approx(6, abs=1e-5)
        assert source.scene(5) == source.scene(5) != source.scene(6)


def test_given_hold_lines_then_when_they_are_cleared_is_a_dimension_and_of_others_refused(write):
    text = 'new HoldLine at (1, Range(450, 480)), with until_s Range(10, 20)\n'
    with SceneSource(write(HEAD + text + 'new HoldLine at (0, 600)\n'), seed=1) as source:
        names = [dimension.name for dimension in source.space()]
        assert names == ['object1.position.y', 'object1.until_s']
        first, last = source.scene(0, (0.0, 0.5)).others.hold_lines
    assert (first.x_m, first.y_m, first.until_s) == (450, -1, pytest.approx(15, abs=1e-5))
    assert (last.x_m, last.until_s, last.size.height_m) == (600, math.inf, 0.0)
    for wrong, words in (
        ('new Cone at (0, 500), with until_s 3', '3: with until_s: no property of Cone'),
        ("new HoldLine at (0, 500), with until_s 'soon'", 'until_s: expected a number, 0 to 3600'),
        ('new HoldLine at (30, 500)', 'has no effect: it is 30.0 m beside the track runway'),
    ):
        with pytest.raises(UsageError, match=words):
            sample_scenarios(write(HEAD + wrong), 1, 1)


@pytest.mark.parametrize('by', ['the program', 'the command line'])
def test_given_a_track_then_objects_are_placed_along_it_as_the_aircraft_is(write, by):
    text = """ego = new Plane at (1, 380)
new Cone at (3, 395), facing 20 deg
new Vehicle at (-6, 80), facing 90 deg, with behavior CrossRunway(5)
new Vehicle at (2, 250), with behavior GoStraight(5, 60)
new Person ahead of ego by 10
"""
    own, overrides = ("param track = 'exit_left'\n", {}) if by == 'the program' else (
        '', {'track': 'exit_left'}
    )
    path = write('model runway_world\n' + own + text)
    with SceneSource(path, seed=1, overrides=overrides) as source:
        scene = source.scene(0)
    line = scene.line
    cone, across, straight, person = scene.others.objects
    at = line.measure(cone.x_m, cone.y_m, math.radians(cone.heading_deg))
    assert at == pytest.approx((395, -3, math.radians(20)))
    ends = [line.measure(one.x_m, one.y_m)[:2] for one in (across, across.path[0])]
    assert ends == [pytest.approx((80, 6)), pytest.approx((80, -6))]
    # In the bend of 90 deg: straight ahead, the way it faces.
    assert math.hypot(straight.path[0].x_m - straight.x_m, straight.path[0].y_m - straight.y_m) \
        == pytest.approx(60)
    assert straight.pose_at(0).heading_rad == pytest.approx(math.radians(straight.heading_deg))
    assert line.measure(person.x_m, person.y_m)[1] == pytest.approx(-1)


def test_given_an_override_then_the_objects_of_the_program_are_not_there_nor_searched(write):
    path = write(BUSY.replace('(0, 400)', '(Range(-3, 3), 400)'))
    with SceneSource(path, seed=1, overrides={'traffic': 'nobody'}) as source:
        assert source.scene(0).traffic == 'nobody'
        assert [dimension.name for dimension in source.space()] == ['ego.position.x']


def test_given_a_scenario_with_others_when_written_as_a_program_then_it_draws_the_same(write):
    scene = Scenario(traffic=load_traffic([
        {'kind': 'vehicle', 'x_m': 450, 'y_m': 8, 'path': [{'x_m': 9, 'y_m': 9, 'speed_mps': 3}]}
    ]))
    path = write(scenario_program(scene, 'about', {}))
    assert sample_scenarios(path, 0, 1) == [scene]


def test_given_files_to_choose_from_then_each_scene_has_one_of_them(write, tmp_path):
    file = tmp_path / 'one.yaml'
    file.write_text('objects: [{kind: cone, x_m: 430, y_m: 2}]\n')
    path = write(HEAD + f"param traffic = Uniform('nobody', '{file}')\n")
    found = {len(scene.others.objects) for scene in sample_scenarios(path, 1, 12)}
    assert found == {0, 1}


@pytest.mark.one_in(4)
@pytest.mark.parametrize(('text', 'words'), [
    ('new Vehicle at (3, 450), with speed 3', '3: speed has no effect here: .* GoStraight'),
    ('new Vehicle at (3, 450), with color (1, 0, 0)', '3: color has no effect here: .*colour'),
    ('new Vehicle at (3, 450), with colour "pink"', '3: colour: expected one of white'),
    ('new Vehicle at (3, 450, 4)', '3: an altitude of 4 m has no effect here: it stands on'),
    ('new Patch at (0, 450), with behavior CrossRunway(3)', '3: path: patch lies on the ground'),
    ('new Vehicle at (3, 450), with behavior CrossRunway(99)', '3: speed_mps: expected a number'),
    ('new Vehicle at (0, 450), with behavior CrossRunway(5)', r'3: path\[0\]: it is there already'),
    ('new Vehicle at (3, 450), with behavior FollowPath(5, 4)', '3: path: expected a list of'),
    ('new Vehicle at (3, 450), with behavior CrossRunway(3, stands_within=0)',
     '3: stands_within_m: expected a number, 1 to 1000'),
    ('new Vehicle at (3, 450), with sensors {"a": 1}', '3: sensors has no effect here'),
    ('new Object at (3, 450)', '3: a further Object: it is no ground object'),
    ('param traffic = "nobody"\nnew Cone at (1, 450)', '3: param traffic has no effect here'),
    ('param traffic = "lorries"', '3: param traffic is .*nor a YAML file'),
    ('van = new Vehicle at (3, 450)\nvan.width = 3', '3: width of the Vehicle is set when'),
])
def test_given_what_has_no_effect_then_it_is_refused_by_name_and_line(text, words, write):
    with pytest.raises(UsageError, match=rf'mine\.scenic:{words}'):
        sample_scenarios(write(HEAD + text + '\n'), 0, 1)


def test_given_a_behavior_of_a_library_then_it_is_refused(write, tmp_path):
    (tmp_path / 'library.scenic').write_text(
        'model runway_world\nbehavior Drive():\n    wait\n', encoding='utf-8'
    )
    text = HEAD + 'from library import Drive\nnew Vehicle at (3, 450), with behavior Drive()\n'
    with pytest.raises(UsageError, match=r'mine\.scenic:4: behavior Drive has no effect here'):
        sample_scenarios(write(text), 0, 1)


def test_given_a_size_that_cannot_be_by_chance_then_only_such_scenes_are_rejected(write):
    path = write(HEAD + 'new Vehicle at (3, 450), with width Range(-3, 3)\n')
    with SceneSource(path, seed=1) as source:
        widths, words = [], []
        for index in range(20):
            try:
                widths.append(source.scene(index).others.objects[0].size.width_m)
            except Rejected as error:
                words.append(str(error))
        assert all('width_m: expected a number, 0.1' in word for word in words)
        assert 3 < len(widths) < 17
        assert all(0.1 <= width <= 3 and math.isfinite(width) for width in widths)


@pytest.mark.parametrize(('thing', 'spec', 'words'), [
    ('Cone at (Range(5, 7), 440)', 'hold_short', 'reads hold_distance, and there is no hold_line'),
    ('HoldLine at (0, Range(440, 460))', 'keep_clear', 'reads clearance, and nobody is on the gr'),
    ('HoldLine at (0, Range(440, 460))', 'hold_short', ''),
])
def test_given_objects_of_another_sort_in_each_scene_then_a_formula_about_others_is_refused(
    tmp_path, thing, spec, words
):
    program = tmp_path / 'mine.scenic'
    program.write_text(f'model runway_world\nego = new Plane at (0, 400)\nnew {thing}\n')
    refused = pytest.raises(UsageError, match=words) if words else contextlib.nullcontext()
    options = make_options(
        program=str(program), runs=2, seed=0, perception='truth', specs=[spec],
        out=tmp_path / 'out',
    )
    scenes = ProgramOrder(options)
    with scenes.source, refused:
        scenes.prepare()


def test_given_hold_lines_of_a_file_then_they_may_be_on_the_track_that_the_program_follows(write):
    line = '{"objects": [{"kind": "hold_line", "x_m": 900, "y_m": 114, "heading_deg": 90}]}'
    turn = "model runway_world\nparam track = 'exit_left'\nego = new Plane at (0, 340)\n"
    (given,) = sample_scenarios(write(turn), 1, 1, {'traffic': line})
    (said,) = sample_scenarios(write(f"{turn}param traffic = '{line}'\n"), 1, 1)
    assert given == said
    assert len(said.hold_lines) == 1
    with pytest.raises(UsageError, match='no effect: it is 114'):
        sample_scenarios(write(HEAD), 1, 1, {'traffic': line})
