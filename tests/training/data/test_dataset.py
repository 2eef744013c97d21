from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from training_samples import SCENES

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.perception.network import INPUT_SHAPE, shrink
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.types import TrackingError
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.training.data.dataset import draw_scenes, make_dataset
from taxinet_ros.training.data.photographs import GROUND_BLOCK, photograph, photographs


def test_given_scenes_when_made_into_a_dataset_then_rows_belong_to_their_starts_in_order() -> None:
    told: list[tuple[str, int, int]] = []
    made = make_dataset(SCENES, workers=1, progress=lambda *what: told.append(what))
    assert told == [('images', 1, 3), ('images', 2, 3), ('images', 3, 3)]
    state = Aircraft(SCENES[0]).state
    assert made.pictures.shape == (3, *INPUT_SHAPE)
    assert np.array_equal(made.pictures[0], shrink(Camera(SCENES[0]).render(state, 0)))
    assert (made.cte_m[0], made.he_rad[0]) == (state.y_m, state.yaw_rad)
    assert made.cte_m == pytest.approx([2.5, -4.0, 0.0], abs=0.01)
    assert made.he_rad == pytest.approx([-0.3, 0.1, 0.0], abs=0.01)
    some = made.take(np.array([True, False, True]))
    assert np.array_equal(some.pictures, made.pictures[::2])
    assert list(some.cte_m) == list(made.cte_m[::2])


def test_given_worker_processes_when_rendering_then_the_varied_dataset_is_the_same() -> None:
    numbered = [(48, SCENES[0]), (64, SCENES[1]), (80, SCENES[2])]  # in three tasks or two
    alone = list(photographs(numbered, keep, varied=True, seed=3, workers=1))
    helped = list(photographs(numbered, keep, varied=True, seed=3, workers=2))
    assert [index for index, *_ in alone] == [48, 64, 80]
    for (one, image, truth), (two, again, same) in zip(alone, helped, strict=True):
        assert (one, truth) == (two, same)
        assert np.array_equal(image, again)


@pytest.mark.nightly
def test_given_a_varied_world_when_rendering_then_seed_and_number_fix_every_look() -> None:
    def look(index: int, seed: int) -> bytes:
        return photograph(SCENES[0], varied=True, seed=seed, index=index)[0].tobytes()

    looks = [look(GROUND_BLOCK, 1), look(GROUND_BLOCK + 1, 1), look(GROUND_BLOCK, 2)]
    assert len(set(looks)) == 3
    assert look(GROUND_BLOCK, 1) == looks[0]


def keep(
    index: int, image: NDArray[np.uint8], truth: TrackingError, rig: Rig
) -> tuple[int, NDArray[np.uint8], TrackingError]:
    return index, image, truth


def kill_this_process(
    index: int, image: NDArray[np.uint8], truth: TrackingError, rig: Rig
) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_given_a_worker_that_is_killed_when_rendering_then_it_is_reported_and_not_waited_for() -> (
    None
):
    taken = photographs(enumerate(SCENES), kill_this_process, varied=False, seed=0, workers=2)
    with pytest.raises(InfraError, match='rendering worker'):
        next(taken)


def test_given_a_program_that_rejects_everything_when_drawn_then_one_line_says_so(
    tmp_path: Path,
) -> None:
    program = tmp_path / 'never.scenic'
    program.write_text(
        'model runway_world\nego = new Plane at (0, 400)\nx = Range(0, 1)\nrequire x > 2\n'
    )
    with pytest.raises(UsageError, match='reject') as caught:
        draw_scenes(program, seed=1, images=1)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('sampler', ['halton', 'sobol'])
def test_given_an_even_sampler_when_scenes_are_drawn_then_they_cover_the_program_evenly(
    sampler: str,
) -> None:
    scenes = draw_scenes('s_falsif', seed=3, images=64, sampler=sampler)
    assert scenes == draw_scenes('s_falsif', seed=3, images=64, sampler=sampler)
    quarters = np.histogram([s.distance_m for s in scenes], bins=4, range=(0, 2000))[0]
    assert quarters.min() >= 12
    wet = sum(s.rain_fraction > 0 for s in scenes) / 64
    assert wet == pytest.approx(1 / 3, abs=0.12)  # the program's own weights are kept


def test_given_a_grid_when_scenes_are_drawn_then_they_stand_at_even_steps() -> None:
    scenes = draw_scenes('halton_time_of_day', seed=3, images=8, sampler='grid')
    hours = sorted(scene.time_of_day_s / 3600 for scene in scenes)
    assert np.diff(hours) == pytest.approx([12 / 8] * 7, abs=1e-6)
