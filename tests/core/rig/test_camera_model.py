"""Cameras as data: files, projection, pictures of any size through any lens, exposure and noise."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from taxinet_ros.core.camera.camera import Camera, project
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.rig.camera_model import make_camera
from taxinet_ros.core.rig.catalogue import CAMERAS, WING, find_camera, load_camera
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.types import AircraftState
from taxinet_ros.errors import UsageError

OWN = {
    'name': 'own', 'offset_m': [1.0, -2.0, 0.6], 'pitch_deg': 9, 'yaw_deg': -3, 'roll_deg': 2,
    'size_px': [502, 301], 'field_of_view_deg': 80,
}
FISH = [-0.25, 0.06, 0.004, -0.003, -0.006]
STATE = AircraftState(
    x_m=640.0, y_m=1.5, z_m=1.55, roll_rad=0.0, pitch_rad=0.002, yaw_rad=0.06, speed_mps=5.0,
    yaw_rate_radps=0.0,
)


def own(**changes):
    return make_camera({**OWN, **changes}, Path('own.yaml'))


def test_given_the_usual_camera_then_it_is_the_papers():
    k = WING.intrinsics
    assert (k[0, 0], k[1, 1]) == (1125 * 360 / 1720, 1125 / (730 / 200))
    assert (k[0, 2], k[1, 2]) == (179.5, (540 - 330) / (730 / 200) - 0.5)
    assert WING.shape == (200, 360, 3)
    assert Scenario().camera == CAMERAS.default == 'wing'


@pytest.mark.parametrize('name', CAMERAS.shipped)
def test_given_a_shipped_camera_then_its_document_is_the_same_and_it_sees_ground_and_sky(name):
    camera = find_camera(name)
    again = find_camera(camera.document)
    assert again.view == camera.view
    assert again.reference == f'{name}@{camera.digest[:12]}' != camera.reference
    scene = Scenario(camera=name)
    frame = Camera(scene).render(Aircraft(scene).state, 0)
    assert frame.shape == camera.shape
    assert frame[-1].mean() < 0.8 * frame[0].mean() or name == 'wing'
    np.testing.assert_array_equal(frame, Camera(scene).render(Aircraft(scene).state, 0))


def test_given_a_file_when_a_scenario_has_it_then_whole_and_tables_have_its_digest(tmp_path):
    path = tmp_path / 'own.yaml'
    path.write_text(yaml.safe_dump(OWN))
    scene = scenario_from_human({'camera': str(path)})
    assert json.loads(scene.camera) == OWN
    reference = scene.to_human()['camera']
    assert reference == f'own@{CAMERAS.typed(str(path)).digest[:12]}'
    assert scenario_from_human({'camera': reference}) == scene == Scenario(camera=load_camera(path))


@pytest.mark.parametrize('distortion', [None, FISH], ids=['pinhole', 'distorted'])
def test_given_points_when_projected_then_their_pixels_look_at_them(distortion):
    camera = own(**({'distortion': distortion} if distortion else {}))
    u, v = np.meshgrid(np.linspace(0, 501, 21), np.linspace(120, 300, 17))
    u, v = u.ravel(), v.ravel()
    x, y = camera.straight_rays(u, v)
    points = np.stack([x, y, np.ones_like(x)], axis=1) * 7.0
    np.testing.assert_allclose(camera.pixels(points), np.stack([u, v], axis=1), atol=1e-6)
    if distortion:
        # OpenCV's own model of the coefficients of sensor_msgs/CameraInfo.
        theirs, _ = cv2.projectPoints(
            points, np.zeros(3), np.zeros(3), camera.intrinsics, np.array(distortion)
        )
        np.testing.assert_allclose(camera.pixels(points), theirs[:, 0], atol=1e-9)
        # Far aside the polynomial would fold back into the picture.
        assert np.isnan(camera.pixels(np.array([[40.0, 1.0, 1.0]]))).all()


@pytest.mark.parametrize('changes', [
    {}, {'distortion': FISH}, {'size_px': [360, 200], 'focal_px': [240, 310]},
], ids=['larger', 'distorted', 'other pixels'])
def test_given_paint_on_the_ground_when_photographed_then_it_is_where_projected(changes):
    values = {**OWN, **changes}
    if 'focal_px' in changes:
        del values['field_of_view_deg']
    camera = make_camera(values, Path('own.yaml'))
    scene = Scenario(shadows=False, clouds='overcast')
    frame = Camera(scene, model=camera).render(STATE, 0).astype(int).sum(axis=2)
    assert frame.shape == camera.shape[:2]
    # The left edge stripe of KMWH 04 and the asphalt on both sides of it, 0.9 m wide.
    lines = []
    for y_m in (14.67, 13.2, 11.5):
        points = np.array([[STATE.x_m + ahead, y_m, 0.0] for ahead in np.linspace(18, 45, 12)])
        pixels, depth = project(STATE, points, camera)
        assert (depth > 0).all()
        seen = np.rint(pixels).astype(int)
        inside = ((seen >= 0) & (seen < (camera.width_px, camera.height_px))).all(axis=1)
        assert inside.sum() >= 5
        lines.append(np.median([frame[v, u] for u, v in seen[inside]]))
    paint, *asphalt = lines
    assert paint > max(asphalt) + 60


@pytest.mark.parametrize('hour', [7, 12], ids=['glare', 'noon'])
def test_given_a_rolled_camera_when_photographed_then_haze_and_light_are_those_of_a_level_one(hour):
    level, rolled = (
        own(roll_deg=roll, yaw_deg=0, pitch_deg=0, offset_m=[6, 0, 1]) for roll in (0, 20)
    )
    scene = Scenario(time_of_day_s=hour * 3600.0, shadows=False)
    # Grass on both sides, far ahead: in the rolled picture on both sides of its middle row.
    points = np.array([
        [STATE.x_m + ahead, STATE.y_m + side * ahead, 0.0]
        for ahead in (80, 120, 200) for side in (-0.6, -0.5, 0.5, 0.6)
    ])
    seen = []
    for camera in (level, rolled):
        frame = cv2.blur(Camera(scene, model=camera).render(STATE, 0), (5, 5)).astype(float)
        pixels, _ = project(STATE, points, camera)
        seen.append([frame[v, u] for u, v in np.rint(pixels).astype(int)])
    assert np.abs(np.subtract(*seen)).max() < 12


def test_given_distortion_when_photographed_then_the_picture_is_the_pinholes_taken_apart():
    lens = own(distortion=FISH)
    scene = Scenario(shadows=False)
    bent = Camera(scene, model=lens).render(STATE, 0).astype(float)
    straight = Camera(scene, model=own()).render(STATE, 0)
    rows, columns = np.mgrid[0:301, 0:502].astype(float)
    x, y = lens.straight_rays(columns, rows)
    (fx, fy), (cx, cy) = lens.focal_px, lens.centre_px
    u, v = (fx * x + cx).astype(np.float32), (fy * y + cy).astype(np.float32)
    wanted = cv2.remap(straight, u, v, cv2.INTER_LINEAR).astype(float)
    inside = (u > 1) & (u < 500) & (v > 1) & (v < 299)
    assert inside.mean() > 0.5
    assert np.abs(bent - wanted)[inside].mean() < 2.0, 'but for the dither of the textures'
    assert np.abs(bent - straight.astype(float)).mean() > 2.0


@pytest.mark.parametrize('size', [[8, 8], [361, 201], [1000, 30], [720, 400]])
def test_given_a_size_when_photographed_in_rain_then_the_picture_has_it(size):
    camera = own(size_px=size)
    scene = Scenario(clouds='stratus', rain_fraction=0.5)
    assert Camera(scene, model=camera).render(STATE, 0).shape == (size[1], size[0], 3)


def test_given_twice_the_resolution_when_photographed_then_the_scene_is_the_same():
    usual = Camera(Scenario(shadows=False), model=own(size_px=[360, 200])).render(STATE, 0)
    large = Camera(Scenario(shadows=False), model=own(size_px=[720, 400])).render(STATE, 0)
    less = cv2.resize(large, (360, 200), interpolation=cv2.INTER_AREA)
    assert np.abs(less.astype(int) - usual).mean() < 5


def test_given_an_exposure_when_photographed_then_light_doubles_with_every_stop():
    def level(ev: float) -> float:
        camera = own(exposure_ev=ev)
        frame = Camera(Scenario(shadows=False, clouds='overcast'), model=camera).render(STATE, 0)
        return float(((frame[200:, 200:] / 255.0) ** 2.2).mean())

    assert level(-1) == pytest.approx(level(0) / 2, rel=0.05)
    assert level(1) > 1.4 * level(0)


def test_given_noise_when_photographed_then_it_has_its_deviation_and_is_the_runs_own():
    scene = Scenario(shadows=False, clouds='overcast')
    plain = Camera(scene, model=own()).render(STATE, 0).astype(int)
    noisy = Camera(scene, model=own(noise_codes=4.0))
    first = noisy.render(STATE, 0).astype(int)
    assert (first - plain)[200:].std() == pytest.approx(4.0, rel=0.03)
    later = noisy.render(STATE, 100_000_000).astype(int)
    assert np.abs(later - first).mean() > 3
    again = Camera(scene, model=own(noise_codes=4.0)).render(STATE, 0)
    np.testing.assert_array_equal(again, first)
    elsewhere = dataclasses.replace(scene, cross_track_m=1.0)
    assert (Camera(elsewhere, model=own(noise_codes=4.0)).render(STATE, 0) != first).any()


@pytest.mark.parametrize(('changes', 'words'), [
    ({'size_px': [360, 4000]}, 'size_px: expected a list of 2 numbers, 8 to 2048, got'),
    ({'size_px': [360.5, 200]}, 'size_px: expected whole numbers, got 360.5 x 200'),
    ({'focal_px': [300, 300]}, 'expected either field_of_view_deg, along a row, or focal_px'),
    ({'field_of_view_deg': 170}, 'field_of_view_deg: expected a number, 1 to 150, got 170'),
    ({'field_of_view_deg': 149, 'size_px': [200, 800]}, 'the picture looks 86 deg aside of its'),
    ({'distortion': [-0.9, 0, 0, 0, 0]}, 'distortion: it cannot be undone everywhere in the'),
    ({'distortion': [0.1, 0]}, 'distortion: expected a list of 5 numbers'),
    ({'roll_deg': 40}, 'roll_deg: expected a number, -20 to 20, got 40'),
    ({'zoom': 2}, 'zoom: unknown key; known: name'),
    ({'name': 'My Camera'}, 'name: expected a lower-case word'),
    ({'noise_codes': -1}, 'noise_codes: expected a number, 0 to 64, got -1'),
])
def test_given_a_bad_value_when_read_then_one_line_names_file_and_key(tmp_path, changes, words):
    path = tmp_path / 'own.yaml'
    path.write_text(yaml.safe_dump({**OWN, **changes}))
    with pytest.raises(UsageError) as caught:
        CAMERAS.typed(str(path))
    assert str(caught.value).startswith(f'{path}: {words}')
    assert '\n' not in str(caught.value)


def test_given_a_camera_below_the_ground_when_a_scenario_has_it_then_refused():
    low = own(offset_m=[0, 0, -1.5]).text
    with pytest.raises(UsageError, match=r'camera own on aircraft caravan is 0\.05 m'):
        Scenario(camera=low)


def test_given_no_such_camera_when_named_then_the_known_ones_are_listed():
    with pytest.raises(UsageError, match=r'camera is .fish., not one of wing, strut, nose, tail'):
        Scenario(camera='fish')
