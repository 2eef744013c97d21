from __future__ import annotations

import os
import signal

import numpy as np
import pytest

from taxinet_ros.core.aircraft import Aircraft
from taxinet_ros.core.camera import Camera
from taxinet_ros.core.errors import InfraError, UsageError
from taxinet_ros.core.network import INPUT_SHAPE, shrink
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.training import dataset
from taxinet_ros.training.dataset import draw_scenes, make_dataset, photograph

SCENES = [
    Scenario(cross_track_m=2.5, heading_rad=-0.3, distance_m=600.0),
    Scenario(cross_track_m=-4.0, heading_rad=0.1, distance_m=900.0),
    Scenario(cross_track_m=0.0, heading_rad=0.0, distance_m=1700.0, clouds='overcast'),
]


def test_given_a_scene_when_photographed_then_picture_and_labels_belong_to_its_start() -> None:
    picture, cte_m, he_rad = photograph(SCENES[0])
    state = Aircraft(SCENES[0]).state
    assert np.array_equal(picture, shrink(Camera(SCENES[0]).render(state, 0)))
    assert (cte_m, he_rad) == (state.y_m, state.yaw_rad)
    assert (cte_m, he_rad) == pytest.approx((2.5, -0.3), abs=0.01)


def test_given_scenes_when_made_into_a_dataset_then_rows_keep_their_order() -> None:
    told: list[tuple[str, int, int]] = []
    made = make_dataset(SCENES, workers=1, progress=lambda *what: told.append(what))
    assert told == [('images', 1, 3), ('images', 2, 3), ('images', 3, 3)]
    assert made.pictures.shape == (3, *INPUT_SHAPE)
    assert made.cte_m == pytest.approx([2.5, -4.0, 0.0], abs=0.01)
    assert made.he_rad == pytest.approx([-0.3, 0.1, 0.0], abs=0.01)
    assert made.take(slice(1, None)).scenarios == tuple(SCENES[1:])
    assert np.array_equal(made.take(np.array([True, False, True])).pictures, made.pictures[::2])


def test_given_worker_processes_when_rendering_then_the_dataset_is_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(dataset, '_CHUNK', 1)  # so that both have something to do
    alone = make_dataset(SCENES, workers=1)
    helped = make_dataset(SCENES, workers=2)
    assert len(helped) == 3
    assert np.array_equal(helped.pictures, alone.pictures)
    assert np.array_equal(helped.cte_m, alone.cte_m)
    assert np.array_equal(helped.he_rad, alone.he_rad)


def kill_this_process(scene: Scenario) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_given_a_worker_that_is_killed_when_rendering_then_it_is_reported_and_not_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(dataset, 'photograph', kill_this_process)
    with pytest.raises(InfraError, match='training worker'):
        make_dataset(SCENES, workers=2)


def test_given_a_program_that_rejects_everything_when_drawn_then_one_line_says_so(
    tmp_path: object,
) -> None:
    program = os.path.join(str(tmp_path), 'never.scenic')
    with open(program, 'w', encoding='utf-8') as file:
        file.write('model runway_world\nego = new Plane at (0, 400)\nx = Range(0, 1)\n')
        file.write('require x > 2\n')
    with pytest.raises(UsageError, match='reject') as caught:
        draw_scenes(program, seed=1, images=1)
    assert '\n' not in str(caught.value)
