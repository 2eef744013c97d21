"""Cameras that are moved: their files, their place in scenarios, what they see of the aircraft."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import yaml

from taxinet_ros.analysis.runs.features import BY_NAME
from taxinet_ros.core.camera.airframe import covering_doubts, drawing
from taxinet_ros.core.camera.camera import Camera, project
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.rig.catalogue import CAMERAS, WING, find_aircraft, load_camera
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import CAMERA_OFFSETS
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.source import SceneSource
from taxinet_ros.trials.options import split_settings

SCENE = {'time_of_day_h': 15.0, 'distance_m': 300.0}


def shot(scene):
    return Camera(scene).render(Aircraft(scene).state, 0)


def file_of(tmp_path, values, name='mine.yaml'):
    (tmp_path / name).write_text(yaml.safe_dump(values))
    return str(tmp_path / name)


def test_wing_written_to_yaml_and_read_back_gives_the_same_bytes(tmp_path):
    path = file_of(tmp_path, json.loads(WING.document))
    scene = scenario_from_human({**SCENE, 'camera': path})
    assert not scene.camera_model.shipped
    np.testing.assert_array_equal(shot(scene), shot(scenario_from_human(SCENE)))


def test_a_typed_copy_of_wing_says_itself_how_the_aircraft_is_drawn(tmp_path):
    typed = {
        'name': 'typed', 'offset_m': [0.085, -2.17, 0.5], 'pitch_deg': 10.42, 'yaw_deg': -4.15,
        'size_px': [360, 200], 'focal_px': [235.465, 308.219], 'centre_px': [179.5, 57.0342],
    }
    copy = scenario_from_human({
        **SCENE, 'camera': file_of(tmp_path, {**typed, 'aircraft_parts': 'by_hand'})})
    same = np.abs(shot(copy).astype(int) - shot(scenario_from_human(SCENE)))
    assert np.mean(same > 8) < 0.01
    outline = CAMERAS.typed(file_of(tmp_path, typed, 'other.yaml'))
    (line,) = covering_doubts(find_aircraft('caravan'), outline)
    assert 'covers 94 % of the picture' in line
    assert line.startswith(f'camera {outline.reference}: ')


@pytest.mark.parametrize('aircraft', ['caravan', 'c172p'])
@pytest.mark.parametrize('camera', CAMERAS.shipped)
def test_no_shipped_camera_is_covered_by_the_aircraft(aircraft, camera):
    assert not covering_doubts(find_aircraft(aircraft), CAMERAS.find(camera))


def test_a_camera_file_with_a_base_is_the_base_and_offsets_in_tables(tmp_path):
    path = file_of(tmp_path, {'base': 'wing', 'dz_m': -0.1, 'dpitch_deg': 2})
    by_file = scenario_from_human({**SCENE, 'camera': path})
    by_keys = scenario_from_human({**SCENE, 'camera_dz_m': -0.1, 'camera_dpitch_deg': 2})
    assert by_file == by_keys
    told = by_file.to_human()
    assert (told['camera'], told['camera_dz_m'], told['camera_dpitch_deg']) == ('wing', -0.1, 2.0)
    assert by_file.camera_model.offset_m == (0.085, -2.17, 0.4)
    overrides, _ = split_settings([f'camera={path}'])
    assert overrides == {'camera': 'wing', 'camera_dz_m': '-0.1', 'camera_dpitch_deg': '2.0'}


@pytest.mark.nightly
def test_a_base_may_be_a_file_beside_the_file_and_travels_whole(tmp_path):
    own = {**json.loads(CAMERAS.find('nose').document), 'name': 'own'}
    file_of(tmp_path, own, 'own.yaml')
    moved = load_camera(file_of(tmp_path, {'base': 'own.yaml', 'dx_m': 0.25}))
    assert json.loads(moved)['base'] == own
    scene = Scenario(camera=moved)
    assert (scene.to_human()['camera'][:4], scene.camera_dx_m) == ('own@', 0.25)


@pytest.mark.parametrize(('values', 'words'), [
    ({'dz_m': 2}, 'dz_m: expected a number, -1 to 1, got 2'),
    ({'name': 'low'}, 'name: unknown key; known: base, dx_m'),
    ({'base': 'wingg'}, "camera is 'wingg', not one of wing, strut"),
    ({'base': {'base': 'wing', 'dx_m': 0.1}}, 'base: unknown key'),
])
def test_a_bad_offset_is_refused_in_one_line(tmp_path, values, words):
    with pytest.raises(UsageError) as caught:
        CAMERAS.typed(file_of(tmp_path, {'base': 'wing', 'dx_m': 0.1, **values}))
    assert words in str(caught.value)
    assert '\n' not in str(caught.value)


def test_an_offset_given_twice_or_beyond_what_a_camera_may_be_is_refused(tmp_path):
    low = load_camera(file_of(tmp_path, {'base': 'wing', 'dz_m': -0.1}))
    with pytest.raises(UsageError, match='camera_dz_m is given twice'):
        Scenario(camera=low, camera_dz_m=0.2)
    steep = {**json.loads(WING.document), 'name': 'steep', 'pitch_deg': 55.0}
    with pytest.raises(UsageError, match='camera steep: with its offset pitch_deg is 65, outside'):
        scenario_from_human({
            'camera': file_of(tmp_path, steep), 'camera_dpitch_deg': 10})


def test_without_offsets_a_scene_is_recorded_as_before_there_were_any():
    # Of the commit before them.
    assert Scenario().digest == '25c1a7cf5fbfe79110d72143a03e3b46'
    assert Scenario().recorded()['camera'] == 'wing'
    assert not [name for name in Scenario().recorded() if name.startswith('camera_d')
                and 'dropout' not in name]


def test_a_drawn_offset_is_recorded_so_that_it_gives_the_same_bytes():
    scene = Scenario(camera_dpitch_rad=0.0123456789012345, camera_dx_m=-0.1234567890123)
    again = Scenario(**scene.recorded())
    assert again == scene
    assert again.camera_model == scene.camera_model
    assert eval(repr(scene), {'Scenario': Scenario}) == scene
    assert scenario_from_human(scene.to_human()) == scene


@pytest.mark.parametrize(('key', 'offset'), [
    ('camera_dx_m', -0.3), ('camera_dy_m', 0.2), ('camera_dz_m', -0.2), ('camera_droll_deg', 4.0),
    ('camera_dpitch_deg', -3.0), ('camera_dyaw_deg', 5.0),
])
def test_the_hand_drawn_parts_stay_on_the_aircraft(key, offset):
    """The rim of the cowling moves in the picture as its point of the aircraft does."""
    model = scenario_from_human({key: offset}).camera_model

    def rim_px(camera, row):
        parts = drawing(find_aircraft('caravan'), camera, (200, 360))
        return float((1 - parts.behind[row, :, 0] / 255).sum()) - 0.5

    there = np.array([[rim_px(WING, 27), 27.0, 1.0]])
    point = 3.7 * there @ np.linalg.inv(WING.intrinsics).T @ WING.body_to_optical + WING.offset_m
    ((u, v),) = model.pixels((point - model.offset_m) @ model.body_to_optical.T)
    assert abs(u - there[0, 0]) + abs(v - 27.0) > 4
    assert rim_px(model, round(v)) == pytest.approx(u, abs=0.6)


def test_points_project_where_another_moved_camera_has_them():
    scene = scenario_from_human({'camera': 'tail', 'camera_dyaw_deg': 3})
    state = Aircraft(scene).state
    tip = np.array([[state.x_m + 40.0, state.y_m, 0.0]])
    (moved,), _ = project(state, tip, scene.camera_model)
    (usual,), _ = project(state, tip, CAMERAS.find('tail'))
    assert moved[0] - usual[0] == pytest.approx(240 * np.tan(np.radians(3)), rel=0.05)


def test_every_offset_changes_the_picture_and_is_named_by_its_title():
    usual = shot(scenario_from_human(SCENE))
    for field in CAMERA_OFFSETS:
        assert (shot(scenario_from_human({**SCENE, field.key: 0.5})) != usual).any(), field.key
    assert dataclasses.replace(Scenario(), camera_dz_m=-0.1).camera_model.title.endswith(
        '; dz_m -0.1')


def test_a_program_draws_offsets_a_search_varies_them_and_analyses_can_name_them(tmp_path):
    program = tmp_path / 'mount.scenic'
    program.write_text(
        'model runway_world\nparam camera = "nose"\nparam camera_dpitch_deg = Range(-2, 2)\n'
        'ego = new Plane at (0, 300)\n')
    with SceneSource(program, seed=0, overrides={'camera_dz_m': '-0.1'}) as source:
        drawn = [source.scene(index) for index in range(3)]
        (searched,) = source.space()
    assert searched.name == 'camera_dpitch_deg'
    assert len({scene.camera_dpitch_rad for scene in drawn}) == 3
    assert {(scene.camera, scene.camera_dz_m) for scene in drawn} == {('nose', -0.1)}
    for field in CAMERA_OFFSETS:
        words = BY_NAME[field.key].interval_words(None, -0.5)
        assert words.startswith(f'{field.title}: below \N{MINUS SIGN}0.5')
