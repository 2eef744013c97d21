"""Control points in Scenic programs: each is a parameter under the name of its key and time."""

import pytest

from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.programs import scenario_program
from taxinet_ros.scenes.source import SceneSource, sample_scenarios

HEAD = 'model runway_world\nego = new Plane at (0, 400)\n'
GUSTY = HEAD + """
param wind_speed = 2
param 'wind_speed@5' = Range(0, 20)
param 'wind_speed_mps@7.50' = Range(0, 20)
param 'wind_speed@form' = Uniform('linear', 'cubic')
param 'runway_state@4' = 'icy'
"""
KEYS = ['wind_speed_mps@5', 'wind_speed_mps@7.5']


def test_given_random_control_points_then_each_is_a_dimension(write):
    with SceneSource(write(GUSTY), seed=1) as source:
        space = source.search_space()
        assert [dimension.name for dimension in source.space()] == [
            'wind_speed@5', 'wind_speed_mps@7.50', 'wind_speed@form']
        assert [sorted(choice.feeds) for choice in space.choices] == [
            [KEYS[0]], [KEYS[1]], ['wind_speed_mps@form']]
        low, high = (source.scene(0, (share,) * 3) for share in (0.0, 0.75))
    assert dict(low.points) == {KEYS[0]: 0.0, KEYS[1]: 0.0, 'runway_state@4': 'icy'}
    assert dict(high.points) == {
        'wind_speed_mps@form': 'cubic', KEYS[0]: 15.0, KEYS[1]: 15.0, 'runway_state@4': 'icy'}
    assert low.wind_speed_mps == 2.0


def test_given_set_then_a_control_point_is_no_dimension_and_the_others_stay(write):
    overrides = {'wind_speed@5': '10 kt', 'wind_speed_mps': '0'}
    with SceneSource(write(GUSTY), seed=1, overrides=overrides) as source:
        assert [dimension.name for dimension in source.space()] == [
            'wind_speed_mps@7.50', 'wind_speed@form']
        scene = source.scene(0)
    assert scene.wind_speed_mps == 0.0
    assert scene.points[KEYS[0]] == pytest.approx(5.144, abs=1e-3)


def test_given_a_scene_with_signals_when_written_as_a_program_then_that_draws_it(write):
    (scene,) = sample_scenarios(write(GUSTY), 3, 1)
    program = scenario_program(scene, 'about', {KEYS[0]: 'matters'})
    assert program.count('# matters') == 1
    assert sample_scenarios(write(program), 3, 1) == [scene]


def test_given_a_wind_that_may_be_none_then_its_directions_are_left_out(write):
    text = HEAD + (
        "param 'wind_speed@5' = Uniform(0, 3)\nparam wind_direction = Range(1, 90)\n"
        "param 'wind_direction@5' = Range(1, 90)\n"
    )
    scenes = sample_scenarios(write(text), 3, 8)
    assert {scene.windy for scene in scenes} == {False, True}
    for scene in scenes:
        assert scene.windy is ('wind_direction_deg@5' in scene.points)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('text', 'said'), [
    ("param 'place@3' = 'bikf_10'", 'param place@3: place cannot change within a run; what can: '),
    ("param 'wind_speed@0' = 3", 'param wind_speed@0: the value at 0 s is wind_speed_mps itself'),
    ("param 'wind_speed@soon' = 3", 'expected wind_speed_mps@SECONDS'),
    ("param 'fog@3' = 3", 'param fog@3: unknown, so it has no effect'),
    ("param 'wind_speed@3' = 3\nparam 'wind_speed_mps@3' = 3", 'are the same; leave one out'),
    ("param 'wind_speed@3' = 'much'", "wind_speed_mps@3 needs a number, got 'much'"),
    ("param 'wind_speed@3' = 99", 'wind_speed_mps@3 is 99, outside 0..30 m/s'),
    ("param 'runway_state@3' = Uniform('icy', 'mud')", "'mud', not one of dry, auto, wet, icy"),
    ("param 'wind_speed@31' = 3", 'wind_speed_mps@31 is after the end of the run at 30 s'),
])
def test_given_what_no_control_point_can_be_then_it_is_refused(write, text, said):
    with pytest.raises(UsageError) as error:
        sample_scenarios(write(HEAD + text), 3, 1)
    assert said in str(error.value)
    assert '\n' not in str(error.value)
