"""The eye: one virtual camera for every real one, in geometry, in bits, and in perceptions."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from taxinet_ros.api.run import asked_perception
from taxinet_ros.core.camera.camera import Camera, pose
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.perception.eye import VIEWS, _places, find_eye
from taxinet_ros.core.perception.network import INPUT_SHAPE, UNSEEN
from taxinet_ros.core.perception.perception import NetworkPerception, make_perception
from taxinet_ros.core.perception.weights import TAXINET, card_path
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState
from taxinet_ros.errors import UsageError

AHEAD = VIEWS['ahead']
SCENES = {
    'wing': Scenario(),
    'wing moved': Scenario(
        camera_dy_m=-0.3, camera_dz_m=0.2, camera_droll_rad=math.radians(3),
        camera_dpitch_rad=math.radians(-3), camera_dyaw_rad=math.radians(3),
    ),
    'strut': Scenario(camera='strut', aircraft='c172p'),
    'nose': Scenario(camera='nose'),
}


def on_wheels(rig: Rig) -> AircraftState:
    """The aircraft at the origin, as it taxies."""
    settled = rig.aircraft.settled
    assert settled is not None
    return AircraftState(
        x_m=0.0, y_m=0.0, z_m=settled.z_m, roll_rad=settled.roll_rad,
        pitch_rad=settled.pitch_rad, yaw_rad=0.0, speed_mps=0.0, yaw_rate_radps=0.0,
    )


def ground_seen(rig: Rig) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Point of the ground that each pixel of a frame shows; NaN above the horizon."""
    camera = rig.camera
    rows, columns = np.indices(camera.shape[:2], float)
    x, y = camera.straight_rays(columns.ravel(), rows.ravel())
    _, to_optical, place = pose(on_wheels(rig), camera)
    ways = np.stack([x, y, np.ones_like(x)], axis=1) @ to_optical
    with np.errstate(divide='ignore'):
        reach = np.where(ways[:, 2] < 0, -place[2] / ways[:, 2], np.nan)
    points = place + reach[:, None] * ways
    return points[:, 0].reshape(rows.shape), points[:, 1].reshape(rows.shape)


def frame_of(rig: Rig, white: NDArray[np.bool_]) -> NDArray[np.uint8]:
    frame = np.where(white, 255, 0).astype(np.uint8)
    return np.repeat(frame.reshape(*rig.camera.shape[:2], 1), 3, axis=2)


@pytest.mark.parametrize(('x_m', 'y_m'), [(9.0, 2.0), (9.0, -3.0), (14.0, 0.0), (25.0, -8.0)])
@pytest.mark.parametrize('name', [
    pytest.param(name, marks=pytest.mark.nightly) if name == 'nose' else name for name in SCENES
])
def test_given_a_spot_on_the_ground_when_seen_from_any_rig_then_it_is_at_the_same_pixel(
    name: str, x_m: float, y_m: float
) -> None:
    rig = SCENES[name].rig
    x, y = ground_seen(rig)
    # Longer than wide: a pixel far ahead is so.
    white = np.square((x - x_m) / (0.12 * x_m)) + np.square((y - y_m) / (0.04 * x_m)) < 1
    picture = find_eye('ahead', rig).see(frame_of(rig, white)).astype(float)
    light = np.where(picture > UNSEEN + 1, picture, 0)  # what is not seen is grey
    assert light.sum() > 255 * 4
    rows, columns = np.indices(light.shape)
    found = (columns * light).sum() / light.sum(), (rows * light).sum() / light.sum()
    # The expected centre of gravity, of the same spot in the view itself.
    right, down = AHEAD.rays()
    ahead = AHEAD.height_m / np.where(down > 0, down, np.nan).ravel()
    aside = -ahead[:, None] * right.ravel()
    ideal = np.square((ahead[:, None] - x_m) / (0.12 * x_m)) + np.square(
        (aside - y_m) / (0.04 * x_m)) < 1
    share = ideal.reshape(64, 4, 192, 4).mean(axis=(1, 3))
    expected = (columns * share).sum() / share.sum(), (rows * share).sum() / share.sum()
    assert found == pytest.approx(expected, abs=0.35)
    assert AHEAD.pixel(x_m, y_m) == pytest.approx(expected, abs=1.5)


def test_given_a_lens_that_distorts_when_seen_then_a_straight_line_is_straight() -> None:
    rig = SCENES['nose'].rig
    _, y = ground_seen(rig)
    picture = find_eye('ahead', rig).see(frame_of(rig, y > -6.0))
    rows = np.arange(8, 30)
    edge = [int(np.argmax(picture[row] < 128)) for row in rows]  # bright on the left
    line = np.polyfit(rows, edge, 1)
    assert np.abs(np.polyval(line, rows) - edge).max() < 1.0
    assert line[0] == pytest.approx(1.17, abs=0.05)  # columns a row, 6 m beside the nose


def test_given_a_mirrored_rig_when_it_sees_a_mirrored_frame_then_its_picture_is_mirrored() -> None:
    camera = SCENES['strut'].camera_model
    left = dataclasses.replace(
        camera, offset_m=(0.2, 2.75, 0.66), yaw_rad=-camera.yaw_rad, document='left',
    )
    aircraft = Scenario().aircraft_model
    frame = np.random.default_rng(4).integers(0, 256, camera.shape, np.uint8)
    pictures = [
        find_eye('ahead', Rig(camera=one, aircraft=aircraft)).see(seen)
        for one, seen in ((camera, frame), (left, frame[:, ::-1]))
    ]
    np.testing.assert_array_equal(pictures[0], pictures[1][:, ::-1])
    white = ground_seen(SCENES['wing'].rig)[1] > 0
    picture = find_eye('ahead', SCENES['wing'].rig).see(frame_of(SCENES['wing'].rig, white))
    assert picture[20:40, 60:90].min() == 255  # left of the nose
    assert picture[20:40, 100:].max() <= UNSEEN


@pytest.mark.parametrize('name', SCENES)
def test_given_a_frame_when_seen_then_the_bits_are_those_of_whole_numbers(name: str) -> None:
    rig = SCENES[name].rig
    frame = np.random.default_rng(7).integers(0, 256, rig.camera.shape, np.uint8)
    height, width = frame.shape[:2]
    wide = frame.astype(np.int64)
    grey = (9798 * wide[..., 0] + 19235 * wide[..., 1] + 3735 * wide[..., 2] + (1 << 14)) >> 15
    u, v = np.moveaxis(_places(AHEAD, rig).astype(np.int64), -1, 0)
    outside = (u < 0) | (v < 0) | (u > 32 * (width - 1)) | (v > 32 * (height - 1))
    column, row = (np.clip(at >> 5, 0, most - 2) for at, most in ((u, width), (v, height)))
    right, low = u - 32 * column, v - 32 * row
    mixed = (
        grey[row, column] * (32 - right) * (32 - low) + grey[row, column + 1] * right * (32 - low)
        + grey[row + 1, column] * (32 - right) * low + grey[row + 1, column + 1] * right * low
    )
    expected = (np.where(outside, 1024 * UNSEEN, mixed).sum(axis=-1) + 8192) >> 14
    np.testing.assert_array_equal(find_eye('ahead', rig).see(frame), expected)
    assert 0.6 < 1 - outside.mean() <= 1


def test_given_what_no_ray_reaches_when_seen_then_it_is_the_fixed_grey() -> None:
    rig = SCENES['wing'].rig  # it sees nothing above the horizon
    picture = find_eye('ahead', rig).see(np.full(rig.camera.shape, 250, np.uint8))
    assert (picture[0] == UNSEEN).all()
    assert (picture[10:60, 100:150] == 250).all()
    assert set(np.unique(picture[:, 100:150])) - {UNSEEN, 250} < set(range(UNSEEN, 250))


def test_given_a_frame_of_another_size_when_seen_then_it_is_refused() -> None:
    eye = find_eye('ahead', SCENES['nose'].rig)
    with pytest.raises(ValueError, match=r'\(200, 360, 3\)'):
        eye.see(np.zeros((200, 360, 3), np.uint8))


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """Today's weights, with a card that asks for the eye."""
    path = tmp_path / 'ahead.safetensors'
    shutil.copy(TAXINET, path)
    card = json.loads(card_path(TAXINET).read_text())
    card_path(path).write_text(json.dumps(card | {'view': 'ahead'}))
    return path


def test_given_a_network_that_asks_for_the_eye_when_driven_then_it_gets_its_picture(
    weights: Path,
) -> None:
    scene = Scenario(camera='nose', cross_track_m=3.0, duration_s=0.2)
    perception = make_perception(str(weights))
    assert isinstance(perception, NetworkPerception)
    steps = []
    run_closed_loop(scene, perception, specs=[], on_step=steps.append)
    image = steps[0].observation.image
    picture = find_eye('ahead', scene.rig).see(image)
    assert picture.shape == INPUT_SHAPE
    assert (steps[0].estimate.cte_m, steps[0].estimate.he_rad) == perception._network.look(picture)
    perception.begin()
    with pytest.raises(UsageError, match='virtual camera ahead'):
        perception.estimate(image, None)


def test_given_an_unknown_view_when_loaded_then_it_is_refused(weights: Path) -> None:
    card = card_path(weights)
    card.write_text(card.read_text().replace('"ahead"', '"behind"'))
    with pytest.raises(UsageError, match='view'):
        make_perception(str(weights))


USER = """
def see(image, rig):
    return rig.camera.offset_m[1], 0.0

class Keeps:
    def __call__(self, image, *, rig=None):
        return len(rig.aircraft.name), 0.0

def plain(image):
    return 1.0, 0.0
"""


def test_given_a_function_with_a_rig_when_asked_then_it_gets_it_and_others_do_not(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'own.py'
    path.write_text(USER)
    scene = SCENES['strut']
    image = Camera(scene).render(Aircraft(scene).state, 0)
    for name, expected in (('see', -2.75), ('Keeps', 5.0), ('plain', 1.0)):
        perception = make_perception(f'{path}:{name}')
        perception.begin(scene.rig)
        assert perception.estimate(image, None).cte_m == expected


def test_given_functions_and_objects_of_the_api_when_begun_then_those_that_ask_get_the_rig() -> (
    None
):
    class Begun:
        rig: Rig | None = None

        def begin(self, rig: Rig) -> None:
            self.rig = rig

        def estimate(self, image: object, truth: object) -> tuple[float, float]:
            assert self.rig is not None
            return self.rig.camera.offset_m[0], 0.0

    scene = SCENES['nose']
    image = np.zeros(scene.camera_model.shape, np.uint8)
    for given, expected in (
        (Begun(), 4.1), (lambda image, rig: (rig.camera.offset_m[0], 0.0), 4.1),
        (lambda image: (1.0, 0.0), 1.0),
    ):
        perception = asked_perception(given)
        perception.begin(scene.rig)
        assert perception.estimate(image, None).cte_m == expected
