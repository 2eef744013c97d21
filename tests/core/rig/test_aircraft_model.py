"""Aircraft as data: files, models of one's own, what is measured of them, outline and shadow."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from itertools import product
from pathlib import Path

import cv2
import jsbsim
import numpy as np
import pytest
import yaml

import taxinet_ros as tx
from taxinet_ros.core.camera.airframe import OwnShadow
from taxinet_ros.core.camera.camera import Camera, project
from taxinet_ros.core.camera.solids import hull_faces, solid_drawing
from taxinet_ros.core.documents import canonical
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.motion.aircraft import Aircraft, checked_aircraft, full_steering_rad
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.rig.aircraft_model import make_aircraft, read_aircraft
from taxinet_ros.core.rig.catalogue import (
    AIRCRAFT,
    find_aircraft,
    find_camera,
    load_aircraft,
    load_camera,
)
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.errors import InfraError, UsageError

MODELS = Path(jsbsim.__file__).parent / 'aircraft'
OWN = {
    'name': 'cub', 'title': 'Piper Cub', 'model': './J3Cub', 'taxi_speed_mps': [2, 8],
    'outline': [
        {'part': 'body', 'sections': [[2, 0, 0, 0.4, 0.4], [0, 0, 0, 0.4, 0.6],
                                      [-4.5, 0, 0, 0.1, 0.1]]},
        {'part': 'wing', 'mirror': True,
         'sections': [[0.7, 0, 0.8, 1.6, 0.2], [0.7, 5.3, 0.9, 1.6, 0.2]]},
    ],
}
CORNERS = tuple(product((-8.0, 8.0), (-20.0, 20.0)))


def written(folder: Path, values: dict) -> Path:
    path = folder / 'own.yaml'
    path.write_text(yaml.safe_dump(values))
    return path


@pytest.fixture(scope='module')
def cub(tmp_path_factory) -> str:
    """An aircraft with a model of one's own: one of JSBSim's collection, copied away from there."""
    folder = tmp_path_factory.mktemp('cub')
    shutil.copytree(MODELS / 'J3Cub', folder / 'J3Cub')
    text = load_aircraft(written(folder, OWN))
    shutil.rmtree(folder)
    return text


@pytest.mark.parametrize('name', AIRCRAFT.shipped)
def test_given_a_shipped_aircraft_when_its_document_is_read_then_it_is_the_same_aircraft(name):
    aircraft = find_aircraft(name)
    again = find_aircraft(aircraft.document)
    assert (again.settled, again.speed_gains) == (aircraft.settled, aircraft.speed_gains)
    assert again.reference == f'{name}@{aircraft.digest[:12]}' != aircraft.reference
    assert full_steering_rad(aircraft) == aircraft.max_steering_rad


def test_given_a_model_of_ones_own_when_a_scenario_has_it_then_no_file_is_needed(cub):
    document = json.loads(cub)
    assert set(document['model']['files']) > {'J3Cub.xml', 'Engines/Continental A-65-8.xml'}
    assert not any('<!--' in text for text in document['model']['files'].values())
    assert find_aircraft(cub).reference.startswith('cub@')
    assert scenario_from_human({'aircraft': cub}).aircraft == cub


def test_given_a_model_of_ones_own_when_measured_then_it_stands_still_in_its_attitude(cub):
    aircraft = checked_aircraft(find_aircraft(cub))
    assert aircraft.settled.z_m == pytest.approx(1.16, abs=0.05)
    assert aircraft == checked_aircraft(find_aircraft(cub)), 'the same numbers every time'
    moving = Aircraft(Scenario(aircraft=cub))
    for _ in range(100):
        state = moving.advance(TaxiCommand(steering_rad=-moving.state.yaw_rad, speed_mps=5.0))
        assert state.z_m == pytest.approx(aircraft.settled.z_m, abs=0.02)
        assert state.speed_mps == pytest.approx(5.0, abs=0.5)


@pytest.mark.parametrize(('cross_track_m', 'heading_deg'), CORNERS)
def test_given_the_truth_when_steered_by_the_shipped_law_then_a_model_of_ones_own_is_mastered(
    cub, cross_track_m, heading_deg
):
    scene = Scenario(
        aircraft=cub, cross_track_m=cross_track_m, heading_rad=math.radians(heading_deg)
    )
    judgement = run_closed_loop(
        scene, make_perception('truth'), specs=[SHIPPED['phi_eventually']]
    )
    assert judgement.complete
    assert judgement.satisfied
    assert not judgement.statistics.left_runway


def test_given_a_model_of_ones_own_then_it_follows_wind_and_slope_too(cub):
    def after(**values: float) -> float:
        moving = Aircraft(Scenario(aircraft=cub, **values))
        for _ in range(40):
            moving.advance(TaxiCommand(steering_rad=0.0, speed_mps=5.0))
        return moving.state.x_m

    assert len({after(), after(slope_fraction=0.04), after(wind_speed_mps=10.0)}) == 3


def test_given_wind_that_lifts_it_then_the_run_is_no_taxiing_and_has_no_verdict(cub):
    windy = Scenario(
        aircraft=cub, wind_speed_mps=30.0, wind_direction_rad=math.radians(54.0), duration_s=3.0
    )
    with pytest.raises(InfraError, match='above its wheels: the wind lifts it'):
        tx.run(windy, perception='truth')


def test_given_a_camera_below_a_measured_aircraft_then_one_line_says_so(cub, tmp_path):
    low = {'name': 'low', 'offset_m': [0, 0, -1.5], 'size_px': [64, 48], 'field_of_view_deg': 60}
    scene = Scenario(aircraft=cub, camera=load_camera(written(tmp_path, low)))
    with pytest.raises(UsageError, match=r'camera low on aircraft cub is -0\.31 m above'):
        tx.render(scene)


def test_given_a_limit_of_the_wheel_when_steered_then_it_turns_no_further():
    narrow = dataclasses.replace(find_aircraft('caravan'), max_steering_rad=math.radians(5.0))
    def turned(model=None) -> float:
        moving = Aircraft(Scenario(), model=model)
        for _ in range(20):
            moving.advance(TaxiCommand(steering_rad=math.radians(12.0), speed_mps=5.0))
        return moving.state.yaw_rad

    assert turned(narrow) == pytest.approx(turned() * 5 / 12, rel=0.1)


@pytest.mark.parametrize(('changes', 'words'), [
    ({'model': None}, "the key 'model' is missing; expected the name of one of JSBSim's models"),
    ({'model': './nothing.xml'}, 'model: {folder}/nothing.xml: cannot be read: No such file'),
    ({'model': 'c 172'}, "model: 'c 172' is none of JSBSim's models; for one of your own write"),
    ({'model': 172}, "model: expected the name of one of JSBSim's models, or the path of"),
    ({'max_steering_deg': 'far'}, 'max_steering_deg: expected a number, 1 to 80, got'),
    ({'taxi_speed_mps': [6, 8]}, 'taxi_speed_mps: expected the lowest and the highest, with'),
    ({'settled': {'pitch_deg': 1}}, "settled: the key 'height_m' is missing"),
    ({'outline': [{'part': 'cone'}]}, 'outline[0].part: expected one of hull, prism, wheel,'),
    ({'outline': [{'part': 'rod', 'radius': 1}]}, 'outline[0].radius: unknown key of a rod; known'),
    ({'outline': [{'part': 'hull', 'points': [[0, 0, 0]]}]},
     'outline[0].points: expected 4 or more lists [x, y, z], got'),
    ({'outline': [{'part': 'wing', 'sections': [[1, 2, 3, 4, 5], [1, 2]]}]},
     'outline[0].sections: expected [x_front, y, z, chord, thickness] in metres, got [1, 2]'),
    ({'outline': [{'part': 'hull', 'points': [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]}]},
     'outline[0]: this hull is a line or a point'),
    ({'outline': [{'part': 'wing', 'sections': [[0, 0, 0, 0, 0], [0, 3, 0, 0, 0]]}]},
     'outline[0]: this wing is a line or a point'),
    ({'wings': 2}, 'wings: unknown key; known: name'),
])
def test_given_a_bad_value_when_read_then_one_line_names_file_and_key(tmp_path, changes, words):
    values = {'name': 'own', 'model': 'c172p', **changes}
    path = written(tmp_path, {key: value for key, value in values.items() if value is not None})
    with pytest.raises(UsageError) as caught:
        read_aircraft(path)
    assert str(caught.value).startswith(f'{path}: {words.format(folder=tmp_path)}')
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('text', 'words'), [
    ('<fdm_config', 'no XML: unclosed token'),
    ('<fdm_config name="m"><x file="/etc/passwd"/></fdm_config>', "includes '/etc/passwd', no"),
    ('<fdm_config name="m"><x file="../../m"/></fdm_config>', "includes '../../m', no plain name"),
])
def test_given_a_model_that_reaches_out_when_read_then_refused(tmp_path, text, words):
    (tmp_path / 'm.xml').write_text(text)
    with pytest.raises(UsageError, match=words.replace('.', r'\.')):
        read_aircraft(written(tmp_path, {'name': 'own', 'model': './m.xml'}))


@pytest.mark.parametrize(('files', 'words'), [
    ({'m.xml': '<fdm_config><output name="/tmp/x" type="CSV"/></fdm_config>'}, 'has an output or'),
    ({'m.xml': '<!DOCTYPE a [<!ENTITY b "c">]><fdm_config/>'}, 'has declarations or comments'),
    ({'../m.xml': '<a/>', 'm.xml': '<fdm_config/>'}, "'../m.xml' is no plain name of a file"),
    ({'n.xml': '<fdm_config/>'}, 'm.xml is missing'),
    ({'m.xml': f'<fdm_config>{"x" * 700_000}</fdm_config>'}, '1 files of 700025 characters, more'),
])
def test_given_a_document_that_reaches_out_when_found_then_refused(files, words):
    document = json.dumps({'name': 'own', 'model': {'name': 'm', 'files': files}})
    with pytest.raises(UsageError, match=words):
        Scenario(aircraft=document)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('values', 'words'), [
    ({'model': 'F450'}, 'aircraft own: no wheel of the model F450 steers'),
    ({'model': 'DHC6'}, 'aircraft own: JSBSim gives other numbers every time with the model DHC6'),
    ({'model': 'c172p', 'max_steering_deg': 30}, 'but the wheel of the model turns to 10 deg at'),
    ({'model': 'J3Cub', 'settled': {'height_m': 2, 'pitch_deg': -12}},
     'aircraft own: settled is not how it taxis, which is {height_m: 1.161, pitch_deg: -12.02'),
    ({'model': 'c172p', 'settled': {'height_m': 1.328, 'pitch_deg': 2.5}, 'speed_hold': {
        'lever_per_mps': 2.5, 'lever_per_m': 0.02, 'brake_per_lever': 1, 'rolling_lever': 0,
    }}, 'aircraft own: settled is not how it taxis'),
    ({'model': 'c182'}, 'aircraft own: its engine does not move it, or does not run at idle'),
    ({'model': 'pa28'}, 'aircraft own: with the wheel [78] deg left it turned -'),
])
def test_given_an_aircraft_that_cannot_taxi_when_checked_then_one_line_says_why(
    tmp_path, values, words
):
    aircraft = read_aircraft(written(tmp_path, {'name': 'own', **values}))
    with pytest.raises(UsageError, match=words) as caught:
        checked_aircraft(aircraft)
    assert '\n' not in str(caught.value)


def test_given_its_taxi_speeds_when_a_scenario_has_another_then_refused(cub):
    with pytest.raises(UsageError, match='aircraft cub: speed_mps is 9, it taxis at 2 to 8'):
        Scenario(aircraft=cub, speed_mps=9.0)


def test_given_a_box_when_its_faces_are_found_then_six_squares_look_outwards():
    (part,) = make_aircraft({
        'name': 'own', 'model': 'c172p',
        'outline': [{'part': 'prism', 'ends': [[-1, -1, 1, -1, 1], [1, -1, 1, -1, 1]]}],
    }, Path('own.yaml')).outline
    faces = hull_faces(part)
    assert len(faces) == 6
    for normal, corners in faces:
        assert len(corners) == 4
        np.testing.assert_allclose(corners @ normal, 1.0)


def test_given_points_within_its_faces_when_they_are_found_then_only_corners_are_left():
    box = [[x, y, z] for x in (0, 2) for y in (-1, 1) for z in (0, 1)]
    more = [[1, 0, 1], [1.5, 0.2, 1], [1, -1, 1], [0, 0.5, 0.5], [2, 1, 1], [0.1, 0.2, 0.3]]

    def faces(points):
        outline = [{'part': 'hull', 'points': points}]
        values = {'name': 'own', 'model': 'c172p', 'outline': outline}
        found = hull_faces(make_aircraft(values, Path('own.yaml')).outline[0])
        return sorted(
            (normal.round(9).tolist(), sorted(corners.tolist())) for normal, corners in found
        )

    assert faces(box + more) == faces(box)


def test_given_the_cessna_when_its_shadow_falls_straight_down_then_it_is_as_wide_as_its_wings():
    aircraft = find_aircraft('c172p')
    parts = [part for part in aircraft.outline if part.shades]
    points = np.concatenate([part.points for part in parts])
    assert np.ptp(points[:, 1]) == pytest.approx(11.0, abs=0.1), 'span'
    assert np.ptp(points[:, 0]) == pytest.approx(8.28, abs=0.2), 'length'
    assert points[:, 2].min() == pytest.approx(-aircraft.settled.z_m, abs=0.05), 'on its wheels'
    assert points[:, 2].max() + aircraft.settled.z_m == pytest.approx(2.72, abs=0.1), 'height'
    scale = 20.0
    intrinsics = np.array([[scale, 0, 150], [0, scale, 150], [0, 0, 1.0]])
    shadow = OwnShadow(parts, np.array([0, 0, 1.0]), 0.001, intrinsics, 300, 300)
    down = np.array([[0, -1.0, 0], [-1.0, 0, 0], [0, 0, -1.0]])
    place = np.array([0, 0, aircraft.settled.z_m])
    rows, columns, mask = shadow.mask(np.eye(3), place, down, np.array([0, 0, 1.0]))
    shade = np.zeros((300, 300), np.uint8)
    shade[rows, columns] = mask
    wide, long = (np.flatnonzero(shade.max(axis=axis) > 128).size / scale for axis in (0, 1))
    assert (wide, long) == (pytest.approx(11.0, abs=0.2), pytest.approx(8.28, abs=0.3))


def test_given_the_sun_from_behind_when_photographed_then_each_aircraft_has_its_own_shadow():
    """The shade on the ground is where the outline throws it."""
    shades = []
    for name in AIRCRAFT.shipped:
        scene = Scenario(aircraft=name, camera='strut', time_of_day_s=16 * 3600.0)
        state = Aircraft(scene).state
        lit, shaded = (
            Camera(dataclasses.replace(scene, shadows=on)).render(state, 0).astype(int)
            for on in (False, True)
        )
        shade = (lit - shaded).sum(axis=2) > 30
        assert 0.02 < shade.mean() < 0.6
        shades.append(shade)
    assert (shades[0] != shades[1]).mean() > 0.02


@pytest.mark.parametrize('name', AIRCRAFT.shipped)
def test_given_a_camera_on_the_fin_when_photographed_then_wing_tips_are_where_projected(name):
    aircraft, camera = find_aircraft(name), find_camera('tail')
    scene = Scenario(aircraft=name, camera='tail')
    state = Aircraft(scene).state
    drawn = solid_drawing(aircraft, camera, camera.shape[:2])
    covered = np.zeros(camera.shape[:2], bool)
    covered[drawn.rows, drawn.columns] = drawn.behind[:, :, 0] < 128
    assert 0.03 < covered.mean() < 0.6
    eye = np.array(camera.offset_m)
    seen = [part.points for part in aircraft.outline if part.seen]
    hulls = np.zeros(covered.shape, np.uint8)
    for points in seen:
        optical = (points - eye) @ camera.body_to_optical.T
        if (optical[:, 2] > 0.1).all():
            hull = cv2.convexHull(camera.pixels(optical).astype(np.float32))
            cv2.fillConvexPoly(hulls, np.rint(hull * 16).astype(np.int32), (1,), shift=4)
    away = covered & ~cv2.dilate(hulls, np.ones((3, 3))).astype(bool)
    assert away.mean() < 0.02
    assert (covered & (hulls > 0)).sum() > 0.9 * hulls.sum()
    frame = Camera(scene).render(state, 0)
    bare = Camera(scene, model=dataclasses.replace(camera, name='bare')).render(state, 0)
    np.testing.assert_array_equal(frame, bare)
    ahead, _ = project(state, np.array([[state.x_m + 200.0, state.y_m, 0.0]]), camera)
    assert abs(ahead[0, 0] - 239.5) < 10


def test_given_the_wing_camera_when_on_the_cessna_then_nothing_of_a_caravan_is_seen():
    scene = Scenario(aircraft='c172p', shadows=False)
    state = Aircraft(scene).state
    frame = Camera(scene).render(state, 0).astype(int)
    document = json.loads(find_aircraft('c172p').document)
    del document['outline']
    bare = dataclasses.replace(scene, aircraft=canonical(document))
    np.testing.assert_array_equal(frame, Camera(bare).render(state, 0))
    assert frame[:100, :40].mean() < 200, 'ground, no cowling'
