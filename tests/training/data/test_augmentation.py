from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxinet_ros.core.camera.camera import Camera, intrinsics, project
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.training.data import augmentation as module
from taxinet_ros.training.data import photographs as photographs
from taxinet_ros.training.data.augmentation import Variation, augment, draw_variation
from taxinet_ros.training.data.photographs import GROUND_BLOCK, photograph

SCENE = Scenario(cross_track_m=2.0, heading_rad=0.1, distance_m=600.0)
NEUTRAL = Variation(
    roll_rad=0, pitch_rad=0, yaw_rad=0, left_m=0, up_m=0, zoom=(1, 1), gain=(1, 1, 1), gamma=1,
    blur_px=0, noise=0, seed=0, patches=0,
)  # fmt: skip


@pytest.fixture(scope='module')
def frame() -> np.ndarray:
    return Camera(SCENE).render(Aircraft(SCENE).state, 0)


def test_given_a_variation_when_developed_then_a_neutral_one_changes_nothing_and_any_repeats(
    frame: np.ndarray
) -> None:
    assert np.array_equal(NEUTRAL.develop(frame), frame)
    variation = draw_variation(np.random.default_rng(7))
    assert np.array_equal(variation.develop(frame), variation.develop(frame))


def test_given_a_higher_gain_when_developed_then_only_that_channel_brightens(
    frame: np.ndarray,
) -> None:
    made = replace(NEUTRAL, gain=(1.2, 1, 1)).develop(frame)
    assert made[..., 0].mean() > 1.1 * frame[..., 0].mean()
    assert np.array_equal(made[..., 1:], frame[..., 1:])


def test_given_a_zoom_when_developed_then_the_principal_point_stays() -> None:
    frame = np.zeros((200, 360, 3), np.uint8)
    frame[54:61, 176:184] = 255  # around the principal point, (179.5, 57.03)
    made = replace(NEUTRAL, zoom=(1.5, 1.5)).develop(frame)
    rows, columns = np.nonzero(made[..., 0] > 127)
    assert (columns.min() + columns.max()) / 2 == pytest.approx(intrinsics()[0, 2], abs=1)
    assert (rows.min() + rows.max()) / 2 == pytest.approx(intrinsics()[1, 2], abs=1)
    assert len(set(columns)) == pytest.approx(12, abs=1)


def test_given_patches_when_developed_then_parts_of_the_frame_are_darker(
    frame: np.ndarray,
) -> None:
    made = replace(NEUTRAL, patches=2, seed=5).develop(frame)
    assert (made <= frame).all()
    assert (made < 0.95 * frame).mean() > 0.02


def test_given_a_camera_higher_up_when_misplaced_then_near_ground_moves_down_in_the_picture() -> (
    None
):
    state = Aircraft(SCENE).state
    ahead = np.array([[state.x_m + 20, state.y_m, 0.0]])
    before, _ = project(state, ahead)
    raised, _ = project(replace(NEUTRAL, up_m=0.5).misplaced(state), ahead)
    turned, _ = project(replace(NEUTRAL, yaw_rad=0.1).misplaced(state), ahead)
    assert raised[0, 1] > before[0, 1] + 3
    assert turned[0, 0] > before[0, 0] + 10


def test_given_a_plain_dataset_when_photographed_then_it_is_what_the_camera_sees(
    frame: np.ndarray,
) -> None:
    picture, truth = photograph(SCENE, seed=1, index=GROUND_BLOCK)
    assert np.array_equal(picture, frame)
    assert (truth.cte_m, truth.he_rad) == pytest.approx((2.0, 0.1), abs=0.01)


@pytest.mark.parametrize('index', [0, GROUND_BLOCK])
def test_given_a_scene_on_a_track_when_photographed_then_its_errors_are_those_to_the_track(
    index: int,
) -> None:
    scene = Scenario(track='exit_left', distance_m=360.0, cross_track_m=1.5, heading_rad=-0.05)
    picture, truth = photograph(scene, varied=True, seed=1, index=index)
    assert (truth.cte_m, truth.he_rad) == pytest.approx((1.5, -0.05), abs=0.02)
    red, _, blue = (picture[30:100, :, channel].astype(int) for channel in range(3))
    assert (red - blue > 60).sum() > 100, 'the yellow line'


def test_given_a_varied_dataset_when_photographed_then_its_blocks_share_a_ground_of_their_own(
    frame: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[object] = []
    make = photographs.make_ground_atlas

    def counted(style: object, *where: object) -> np.ndarray:
        made.append(style)
        return make(style, *where)

    monkeypatch.setattr(photographs, 'make_ground_atlas', counted)
    photographs._varied_ground.cache_clear()
    plain, _ = photograph(SCENE, varied=True, seed=1, index=GROUND_BLOCK - 1)
    assert np.array_equal(plain, frame)
    first, truth = photograph(SCENE, varied=True, seed=1, index=GROUND_BLOCK)
    second, _ = photograph(SCENE, varied=True, seed=1, index=GROUND_BLOCK + 1)
    assert len(made) == 1
    assert np.abs(first.astype(float) - frame).mean() > 3
    assert np.abs(first.astype(float) - second).mean() > 3
    assert truth.cte_m == pytest.approx(2.0, abs=0.01)
    again, _ = photograph(SCENE, varied=True, seed=1, index=GROUND_BLOCK)
    assert np.array_equal(again, first)


PICTURES = np.random.default_rng(5).integers(0, 256, (12, 16, 32), np.uint8)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32), level=st.integers(0, 255), count=st.integers(0, 5))
def test_given_flat_pictures_when_augmented_then_the_mean_stays_within_the_stated_limits(
    seed: int, level: int, count: int
) -> None:
    flat = np.full((count, 64, 128), level, np.uint8)
    changed = augment(flat, np.random.default_rng(seed))
    assert (changed.shape, changed.dtype) == (flat.shape, np.uint8)
    gain, gamma, offset = module.GAIN, module.GAMMA, module.OFFSET
    share = level / 255
    low = np.clip(255 * gain[0] * share ** gamma[1] + offset[0], 0, 255)
    high = np.clip(255 * gain[1] * share ** gamma[0] + offset[1], 0, 255)
    # Where noise is cut off at black or white the mean shifts by less than its deviation.
    slack = module.NOISE[1]
    assert all(low - slack <= picture.mean() <= high + slack for picture in changed)


def test_given_a_generator_state_when_augmented_again_then_the_pictures_are_the_same() -> None:
    before = PICTURES.copy()
    once, again, other = (augment(PICTURES, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(once, again)
    assert not np.array_equal(once, other)
    assert np.array_equal(PICTURES, before)


def test_given_one_picture_many_times_when_augmented_then_every_copy_differs() -> None:
    copies = np.repeat(PICTURES[:1], 8, axis=0)
    changed = augment(copies, np.random.default_rng(1))
    assert len({picture.tobytes() for picture in changed}) == 8


def test_given_no_change_allowed_when_augmented_then_the_pictures_are_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in (('GAIN', 1), ('GAMMA', 1), ('OFFSET', 0), ('NOISE', 0)):
        monkeypatch.setattr(module, name, (value, value))
    monkeypatch.setattr(module, 'BLURRED', 0.0)
    assert np.array_equal(augment(PICTURES, np.random.default_rng(1)), PICTURES)


def test_given_a_bright_line_when_augmented_then_it_stays_in_its_place() -> None:
    pictures = np.full((40, 64, 128), 60, np.uint8)
    pictures[:, :, 70] = 200
    changed = augment(pictures, np.random.default_rng(3))
    assert set(changed.mean(axis=1).argmax(axis=1)) == {70}
