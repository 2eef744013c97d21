from __future__ import annotations

import csv
import dataclasses

import numpy as np
import pytest
import torch
from training_samples import bright_columns

from taxinet_ros.core.perception.network import ARCHITECTURES, DEFAULT_ARCHITECTURE, TaxiNet
from taxinet_ros.core.perception.weights import to_bytes
from taxinet_ros.errors import UsageError
from taxinet_ros.training.accuracy import (
    Epoch,
    absolute_errors,
    error_statistics,
    half_width_95,
    history_csv,
)
from taxinet_ros.training.fit import Fitted, Recipe, fit
from taxinet_ros.training.learning_curves import learning_curves

ARCHITECTURE = ARCHITECTURES[DEFAULT_ARCHITECTURE]
RECIPE = Recipe(epochs=3, batch=16, learning_rate=2e-3, seed=1)
TRAINING = bright_columns(64, 1)
VALIDATION = bright_columns(32, 2)


def fitted(**changes: object) -> Fitted:
    return fit(ARCHITECTURE, TRAINING, VALIDATION, dataclasses.replace(RECIPE, **changes))


def test_given_the_same_recipe_when_fitted_by_other_threads_then_the_weights_are_the_same_bytes(
) -> None:
    plain, augmented = (
        [fitted(seed=1, augmented=augmented, epochs=2, workers=workers) for workers in (1, 3)]
        for augmented in (False, True)
    )
    for first, again in (plain, augmented):
        assert to_bytes(again.weights) == to_bytes(first.weights)
        assert again.history == first.history
    others = fitted(seed=2, epochs=2), fitted(seed=2, augmented=True, epochs=2), augmented[0]
    assert len({to_bytes(one.weights) for one in (plain[0], *others)}) == 4


@pytest.mark.skipif(not torch.cuda.is_available(), reason='no GPU on this machine')
def test_given_a_gpu_when_fitted_twice_then_the_same_bytes_and_near_those_of_the_cpu() -> None:
    first, again = (fitted(device='cuda', augmented=True) for _ in range(2))
    assert to_bytes(again.weights) == to_bytes(first.weights)
    on_cpu = fitted(augmented=True)
    losses = [one.history[-1].validation_loss for one in (first, on_cpu)]
    assert losses[0] == pytest.approx(losses[1], rel=0.3)


def test_given_pictures_of_an_eye_when_mirrored_then_one_side_teaches_the_other() -> None:
    rolled = [dataclasses.replace(one, pictures=np.roll(one.pictures, 32, axis=2))
              for one in (TRAINING, VALIDATION)]  # 0 is in the middle
    left, right = rolled[0].take(TRAINING.cte_m > 0), rolled[1].take(VALIDATION.cte_m < 0)
    found = {}
    for mirrored in (False, True):
        recipe = dataclasses.replace(RECIPE, epochs=8, batch=8, mirrored=mirrored)
        result = fit(ARCHITECTURE, left, right, recipe)
        answers = TaxiNet(ARCHITECTURE, result.weights).infer(right.pictures)
        found[mirrored] = np.abs(answers[:, 0] - right.cte_m).mean()
    assert found[True] < 0.5 * found[False]


def test_given_a_simple_world_when_fitted_then_the_loss_falls_and_new_pictures_are_understood() -> (
    None
):
    told: list[tuple[str, int, int]] = []
    recipe = dataclasses.replace(RECIPE, epochs=6)
    result = fit(
        ARCHITECTURE, bright_columns(192, 1), VALIDATION, recipe, lambda *what: told.append(what)
    )
    assert told == [('epochs', epoch, 6) for epoch in range(1, 7)]
    assert [epoch.number for epoch in result.history] == [1, 2, 3, 4, 5, 6]
    assert result.history[-1].training_loss < 0.2 * result.history[0].training_loss
    rates = [epoch.learning_rate for epoch in result.history]
    assert max(rates) <= RECIPE.learning_rate
    assert rates[-1] < 0.01 * max(rates)
    unseen = bright_columns(64, 3)
    errors = absolute_errors(TaxiNet(ARCHITECTURE, result.weights), unseen)
    assert errors.shape == (64, 2)
    assert errors[:, 0].mean() < 0.2 * np.abs(unseen.cte_m).mean()
    assert errors[:, 1].mean() < 0.2 * np.abs(unseen.he_rad).mean()


def test_given_an_epoch_that_was_better_when_fitted_then_its_weights_are_kept() -> None:
    # Labels that contradict what is learnt: the longer it is learnt, the worse it gets.
    opposed = dataclasses.replace(
        VALIDATION, cte_m=-VALIDATION.cte_m, he_rad=-VALIDATION.he_rad
    )
    result = fit(ARCHITECTURE, TRAINING, opposed, dataclasses.replace(RECIPE, epochs=8))
    losses = [epoch.validation_loss for epoch in result.history]
    best = result.history[result.best_epoch - 1]
    assert len(losses) == 8
    assert result.best_epoch < 8
    assert best.validation_loss == min(losses)
    errors = absolute_errors(TaxiNet(ARCHITECTURE, result.weights), opposed).mean(axis=0)
    assert (best.cte_mae_m, best.he_mae_deg) == pytest.approx((errors[0], np.degrees(errors[1])))


@pytest.mark.parametrize('images', [16, 48, 80, 96])
def test_given_few_steps_in_all_when_fitted_then_every_epoch_is_done(images: int) -> None:
    recipe = dataclasses.replace(RECIPE, epochs=2)
    result = fit(ARCHITECTURE, bright_columns(images, 1), VALIDATION, recipe)
    assert [epoch.number for epoch in result.history] == [1, 2]


def test_given_a_rate_far_too_high_when_fitted_then_one_line_says_so() -> None:
    with pytest.raises(UsageError, match='lower the learning rate') as caught:
        fitted(learning_rate=1e30)
    assert '\n' not in str(caught.value)


def test_given_errors_when_summed_up_then_metres_and_degrees_have_their_statistics() -> None:
    errors = np.stack([np.arange(101) / 100, np.radians(np.arange(101))], axis=1)
    assert error_statistics(errors) == {
        'cte_m': {'mae': 0.5, 'p50': 0.5, 'p90': 0.9, 'p99': 0.99, 'max': 1.0},
        'he_deg': {'mae': 50.0, 'p50': 50.0, 'p90': 90.0, 'p99': 99.0, 'max': 100.0},
    }


def test_given_many_samples_when_their_means_are_bounded_then_most_intervals_hold_the_truth() -> (
    None
):
    samples = np.random.default_rng(1).exponential(2.0, (1000, 50))
    held = [abs(sample.mean() - 2.0) <= (half_width_95(sample) or 0) for sample in samples]
    assert 0.90 <= np.mean(held) <= 0.97
    assert half_width_95(np.array([1.0])) is None


def epochs(count: int) -> list[Epoch]:
    return [
        Epoch(number=i, learning_rate=1e-3 / i, training_loss=0.5 / i, validation_loss=0.6 / i,
              cte_mae_m=3 / i, he_mae_deg=9 / i)
        for i in range(1, count + 1)
    ]  # fmt: skip


@pytest.mark.nightly
def test_given_a_history_when_written_then_table_and_picture_show_every_epoch() -> None:
    count = 5
    history = epochs(count)
    rows = list(csv.DictReader(history_csv(history).splitlines()))
    assert [int(row['number']) for row in rows] == list(range(1, count + 1))
    assert float(rows[-1]['validation_loss']) == pytest.approx(0.6 / count, rel=1e-5)
    picture = learning_curves(history, count, 'net')
    assert picture.startswith(b'\x89PNG')
    assert learning_curves(history, count, 'net') == picture
    assert learning_curves(history[:1], 1, 'net') != picture
