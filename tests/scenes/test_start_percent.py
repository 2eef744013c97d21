"""``start_percent``: how far along the aircraft starts, at whatever place the scene has."""

from __future__ import annotations

from typing import Any

import pytest

from taxinet_ros.core.place.catalogue import typed_place
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.source import SceneSource, sample_scenarios

MODEL = 'model runway_world\n'
PERCENT = MODEL + 'param start_percent = {}\nego = new Plane at ({}), facing 2 deg\n'


@pytest.mark.parametrize('place', ['kmwh_04', 'nzqn_05', 'random:20039'])
def test_given_a_place_then_starts_are_spread_over_its_runway(place: str) -> None:
    scenes = sample_scenarios('anywhere', 3, 60, {'place': place})
    last_m = typed_place(place).runway.last_start_m
    distances_m = sorted(scene.distance_m for scene in scenes)
    assert {scene.runway for scene in scenes} == {typed_place(place).runway}
    assert 0 <= distances_m[0] < 0.2 * last_m
    assert 0.8 * last_m < distances_m[-1] <= last_m
    assert 0.3 * last_m < distances_m[30] < 0.7 * last_m


def test_given_a_place_that_is_drawn_then_each_scene_has_the_percentage_of_its_own(
    write: Any,
) -> None:
    text = PERCENT.format(50, '-3, 0') + "param place = Uniform('random:1', 'bikf_10')\n"
    with SceneSource(write(text), seed=0) as source:
        scenes = [source.scene(index) for index in range(12)]
    assert len({scene.runway.length_m for scene in scenes}) == 2
    for scene in scenes:
        assert scene.distance_m == pytest.approx(scene.runway.last_start_m / 2)
        assert scene.cross_track_m == pytest.approx(3)


def test_given_a_track_then_it_is_the_track_s_starts(write: Any) -> None:
    track = typed_place('kmwh_04').track('exit_left')
    with SceneSource(write(PERCENT.format(100, '0, 0')), seed=0,
                     overrides={'track': 'exit_left'}) as source:
        assert source.scene(0).distance_m == pytest.approx(track.last_start_m)


def test_given_a_distance_by_set_then_it_is_that_one_and_no_dimension_is_left(write: Any) -> None:
    path = write(PERCENT.format('Range(0, 100)', 'Range(-2, 2), 0'))
    with SceneSource(path, seed=0) as source:
        assert {one.name for one in source.space()} == {'start_percent', 'ego.position.x'}
    with SceneSource(path, seed=0, overrides={'distance_m': '321'}) as source:
        assert source.scene(0).distance_m == 321
        assert [one.name for one in source.space()] == ['ego.position.x']


@pytest.mark.parametrize(('percent', 'where', 'message'), [
    ('101', '0, 0', 'start_percent is 101.0; expected a number from 0 to 100, in percent of the'),
    ("'far'", '0, 0', "start_percent is 'far'; expected a number from 0 to 100"),
    ('50', '0, 30', 'start_percent says how far along it starts; place the ego at (x, 0)'),
])
def test_given_a_percentage_that_cannot_be_then_it_is_refused(
    write: Any, percent: str, where: str, message: str
) -> None:
    with pytest.raises(UsageError) as refused:
        sample_scenarios(write(PERCENT.format(percent, where)), 0, 1)
    assert message in str(refused.value)
