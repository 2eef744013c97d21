from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from training_samples import coloured_frame, foreign_folder

from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NO_ESTIMATE, TrackingError
from taxinet_ros.errors import UsageError
from taxinet_ros.training.accuracy import absolute_errors, error_statistics
from taxinet_ros.training.data.dataset import draw_scenes, make_dataset
from taxinet_ros.training.evaluation import (
    SLICES,
    by_slice,
    evaluate_folder,
    evaluate_program,
    image_perception,
    mirrored_errors,
)


class Constant:
    """Says half a metre to the left, and nothing at every third look."""

    word = 'taxinet'
    fingerprint = 'f'
    needs_image = True

    def __init__(self) -> None:
        self.looks = 0

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        assert image is not None
        assert (image.shape, image.dtype) == ((200, 360, 3), np.uint8)
        assert truth is None, 'the network must not see the truth'
        self.looks += 1
        return NO_ESTIMATE if self.looks % 3 == 0 else TrackingError(cte_m=0.5, he_rad=0.0)


def test_given_scenes_of_several_slices_when_measured_then_each_has_its_own_errors() -> None:
    hour = 3600.0
    scenes = (
        Scenario(time_of_day_s=10 * hour),
        Scenario(time_of_day_s=10 * hour, distance_m=1450.0),
        Scenario(time_of_day_s=14 * hour, clouds='overcast', rain_fraction=0.5),
        Scenario(time_of_day_s=7 * hour),
    )
    errors = np.array([[1.0, 0.1], [2.0, 0.2], [3.0, 0.3], [math.nan, math.nan]])
    table = {row.name: row for row in by_slice(errors, scenes)}
    assert list(table) == list(SLICES)
    assert {name: (row.images, row.without_estimate) for name, row in table.items()} == {
        'all': (4, 1), 'late morning, fine': (1, 0), 'early morning': (1, 1),
        'afternoon, clear': (0, 0), 'broken or stratus, dry': (0, 0), 'rain': (1, 0),
        'crossing': (1, 0),
    }  # fmt: skip
    assert table['all'].errors == error_statistics(errors[:3])
    assert table['all'].half_widths['cte_m'] == pytest.approx(1.959964 * 1 / math.sqrt(3))
    assert table['rain'].errors == error_statistics(errors[2:3])
    assert table['rain'].half_widths == {'cte_m': None, 'he_deg': None}
    assert table['afternoon, clear'].errors == table['early morning'].errors == {}


def test_given_a_folder_when_measured_then_errors_are_those_of_its_labels(tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    folder = foreign_folder(tmp_path / 'f', images=5)
    (row,) = evaluate_folder(Constant(), folder, lambda *what: told.append(what))
    assert told[-1] == ('images', 5, 5)
    assert (row.name, row.images, row.without_estimate) == ('all', 5, 1)
    # Images 0, 1, 3 and 4 m to the left, each seen at 0.5 m.
    assert row.errors['cte_m']['mae'] == pytest.approx((0.5 + 0.5 + 2.5 + 3.5) / 4)
    assert row.errors['he_deg']['max'] == pytest.approx(10.0)


def test_given_a_network_with_a_view_when_measured_on_a_folder_then_it_sees_as_in_a_run(
    tmp_path: Path,
) -> None:
    network = make_perception('anywhere')
    folder = foreign_folder(tmp_path / 'f', images=3, camera='wing', aircraft='c172p')
    (row,) = evaluate_folder(network, folder)
    network.begin(Scenario(aircraft='c172p').rig)
    seen = [network.estimate(coloured_frame(index), None).cte_m for index in range(3)]
    mean = np.abs(np.array(seen) - [0, 1, 2]).mean()
    assert row.errors['cte_m']['mae'] == round(float(mean), 4)
    with pytest.raises(UsageError, match='names no camera and no aircraft'):
        evaluate_folder(network, foreign_folder(tmp_path / 'unnamed'))


def test_given_estimates_with_the_wrong_sign_then_their_errors_turned_round_are_told() -> None:
    rng = np.random.default_rng(5)
    truth = np.stack([rng.uniform(-8, 8, 200), rng.uniform(-0.5, 0.5, 200)], axis=1)
    good = truth + rng.normal(0, 1, truth.shape) * (1.0, 0.05)
    bad = rng.normal(0, 1, truth.shape) * (4.0, 0.3)
    assert mirrored_errors(good, truth) == mirrored_errors(bad, truth) == {}
    assert mirrored_errors(good * (1, -1), truth) == {
        'he_deg': pytest.approx(np.degrees(abs(good - truth)[:, 1].mean()), abs=1e-4)
    }
    assert set(mirrored_errors(-good, truth)) == {'cte_m', 'he_deg'}
    assert mirrored_errors(-good[:7], truth[:7]) == {}, 'too few to tell'
    assert mirrored_errors(np.ones_like(truth), truth) == {}
    lost = np.where(np.arange(200)[:, None] < 190, math.nan, -good)
    assert set(mirrored_errors(lost, truth)) == {'cte_m', 'he_deg'}


def test_given_estimates_that_are_worse_than_guessing_then_that_is_told(tmp_path: Path) -> None:
    folder = foreign_folder(tmp_path / 'f', images=15)  # 0 to 14 m to the left, some seen at 0.5 m
    (row,) = evaluate_folder(Constant(), folder)
    assert row.mirrored == {}
    assert row.guessed['cte_m'] < row.errors['cte_m']['mae']
    assert set(row.guessed) == {'cte_m', 'he_deg'}
    good = evaluate_program(make_perception('taxinet'), 's_falsif', images=8, seed=9, workers=1)
    assert good[0].guessed == {}


def test_given_a_program_when_measured_then_full_frames_give_the_errors_of_shrunk_ones() -> None:
    perception = make_perception('taxinet')
    rows = evaluate_program(perception, 's_falsif', images=3, seed=9, workers=1)
    dataset = make_dataset(draw_scenes('s_falsif', seed=9, images=3), workers=1)
    shrunk = absolute_errors(perception._network, dataset)
    assert (rows[0].name, rows[0].images, rows[0].without_estimate) == ('all', 3, 0)
    for quantity, expected in error_statistics(shrunk).items():
        assert rows[0].errors[quantity] == pytest.approx(expected, abs=2e-4)


def test_given_a_perception_that_does_not_look_when_chosen_then_it_is_refused() -> None:
    with pytest.raises(UsageError, match='uses no camera image'):
        image_perception('truth')
    assert image_perception('taxinet').needs_image


@pytest.mark.parametrize('change', [{'images': 0}, {'workers': 0}])
def test_given_a_number_that_cannot_be_when_measured_then_one_line_names_it(
    change: dict[str, int],
) -> None:
    with pytest.raises(UsageError, match=next(iter(change))):
        evaluate_program(Constant(), 'nominal', **change)


@pytest.fixture(scope='module')
def unseen() -> list[Scenario]:
    """Scenes of S_falsif by a seed that no shipped network was trained or chosen with."""
    return draw_scenes('s_falsif', seed=77, images=180)


def mean_errors(word: str, scenes: list[Scenario]) -> tuple[float, float]:
    perception = make_perception(word)
    dataset = make_dataset(scenes, workers=1)
    cte_m, he_rad = absolute_errors(perception._network, dataset).mean(axis=0)
    return float(cte_m), math.degrees(he_rad)


def test_given_the_network_of_all_the_world_when_measured_on_unseen_scenes_then_it_sees_well(
    unseen: list[Scenario],
) -> None:
    cte_mae_m, he_mae_deg = mean_errors('taxinet', unseen)
    assert cte_mae_m <= 0.4
    assert he_mae_deg <= 1.5


@pytest.mark.nightly
def test_given_the_original_when_measured_then_it_sees_well_in_its_world_and_badly_beyond(
    unseen: list[Scenario],
) -> None:
    own = draw_scenes('training_original', seed=77, images=60)
    wet = [scene for scene in unseen if scene.rain_fraction > 0]
    at_home, _ = mean_errors('original', own)
    in_rain, _ = mean_errors('original', wet)
    assert at_home <= 0.15
    assert len(wet) > 50
    assert in_rain > 1.0
