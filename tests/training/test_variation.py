from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taxinet_ros.core.aircraft import Aircraft
from taxinet_ros.core.camera import Camera, intrinsics, project
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.training import photograph as photographs
from taxinet_ros.training.photograph import GROUND_BLOCK, photograph
from taxinet_ros.training.variation import Variation, varied

SCENE = Scenario(cross_track_m=2.0, heading_rad=0.1, distance_m=600.0)
NEUTRAL = Variation(
    roll_rad=0, pitch_rad=0, yaw_rad=0, left_m=0, up_m=0, zoom=(1, 1), gain=(1, 1, 1), gamma=1,
    blur_px=0, noise=0, seed=0, patches=0,
)  # fmt: skip


@pytest.fixture(scope='module')
def frame() -> np.ndarray:
    return Camera(SCENE).render(Aircraft(SCENE).state, 0)


def test_given_a_neutral_variation_when_developed_then_the_frame_is_unchanged(
    frame: np.ndarray,
) -> None:
    assert np.array_equal(NEUTRAL.develop(frame), frame)


def test_given_a_variation_when_developed_twice_then_the_frames_are_equal(
    frame: np.ndarray,
) -> None:
    variation = varied(np.random.default_rng(7))
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


def test_given_a_varied_dataset_when_photographed_then_its_blocks_share_a_ground_of_their_own(
    frame: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[object] = []
    make = photographs.make_ground_atlas

    def counted(style: object) -> np.ndarray:
        made.append(style)
        return make(style)

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
