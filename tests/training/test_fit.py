from __future__ import annotations

import numpy as np

from taxinet_ros.core.network import (
    ARCHITECTURES,
    DEFAULT_ARCHITECTURE,
    HE_SCALE_RAD,
    INPUT_SHAPE,
    TaxiNet,
)
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.weights import to_bytes
from taxinet_ros.training.dataset import Dataset
from taxinet_ros.training.evaluate import SLICES, absolute_errors, by_slice, statistics
from taxinet_ros.training.fit import fit

ARCHITECTURE = ARCHITECTURES[DEFAULT_ARCHITECTURE]


def bright_columns(images: int, seed: int) -> Dataset:
    """Pictures with a bright column whose place says where the aircraft is."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-0.8, 0.8, images)
    pictures = rng.integers(0, 60, (images, *INPUT_SHAPE), np.uint8)
    for picture, middle in zip(pictures, place, strict=True):
        column = int(64 + 60 * middle)
        picture[:, column - 3 : column + 3] = 255
    return Dataset(
        scenarios=(Scenario(),) * images,
        pictures=pictures,
        cte_m=10 * place,
        he_rad=-HE_SCALE_RAD * place,
    )


def fitted(dataset: Dataset, seed: int = 1, losses: list[float] | None = None) -> bytes:
    weights = fit(
        ARCHITECTURE, dataset, epochs=3, batch=16, learning_rate=2e-3, seed=seed, losses=losses
    )
    return to_bytes(weights)


def test_given_the_same_seed_when_fitted_twice_then_the_weights_are_the_same_bytes() -> None:
    dataset = bright_columns(64, 1)
    first = fitted(dataset)
    assert fitted(dataset) == first
    assert fitted(dataset, seed=2) != first


def test_given_a_simple_world_when_fitted_then_the_loss_falls_and_new_pictures_are_understood() -> (
    None
):
    losses: list[float] = []
    told: list[tuple[str, int, int]] = []
    weights = fit(
        ARCHITECTURE, bright_columns(512, 1), epochs=6, batch=16, learning_rate=2e-3, seed=1,
        progress=lambda *what: told.append(what), losses=losses,
    )  # fmt: skip
    assert told == [('epochs', epoch, 6) for epoch in range(1, 7)]
    assert len(losses) == 6
    assert losses[-1] < 0.2 * losses[0]
    unseen = bright_columns(64, 2)
    errors = absolute_errors(TaxiNet(ARCHITECTURE, weights), unseen)
    assert errors.shape == (64, 2)
    assert errors[:, 0].mean() < 0.2 * np.abs(unseen.cte_m).mean()
    assert errors[:, 1].mean() < 0.2 * np.abs(unseen.he_rad).mean()


def test_given_errors_when_summed_up_then_metres_and_degrees_have_their_statistics() -> None:
    errors = np.stack([np.arange(101) / 100, np.radians(np.arange(101))], axis=1)
    assert statistics(errors) == {
        'cte_m': {'mae': 0.5, 'p50': 0.5, 'p90': 0.9, 'p99': 0.99, 'max': 1.0},
        'he_deg': {'mae': 50.0, 'p50': 50.0, 'p90': 90.0, 'p99': 99.0, 'max': 100.0},
    }


def test_given_scenes_of_two_slices_when_measured_then_each_has_its_own_errors() -> None:
    hour = 3600.0
    dataset = bright_columns(4, 3)
    scenarios = (
        Scenario(time_of_day_s=10 * hour),
        Scenario(time_of_day_s=10 * hour, distance_m=1450.0),
        Scenario(time_of_day_s=14 * hour, clouds='overcast', rain=0.5),
        Scenario(time_of_day_s=7 * hour),
    )
    dataset = Dataset(
        scenarios=scenarios, pictures=dataset.pictures, cte_m=dataset.cte_m, he_rad=dataset.he_rad
    )
    weights = fit(ARCHITECTURE, dataset, epochs=1, batch=4, learning_rate=1e-4, seed=1)
    network = TaxiNet(ARCHITECTURE, weights)
    table = {row.name: row for row in by_slice(network, dataset)}
    assert list(table) == list(SLICES)
    counts = {name: row.images for name, row in table.items()}
    assert counts == {
        'all': 4, 'like the training': 1, 'early morning': 1, 'afternoon, clear': 0,
        'broken or stratus, dry': 0, 'rain': 1, 'crossing': 1,
    }  # fmt: skip
    single = statistics(absolute_errors(network, dataset)[2:3])
    assert table['rain'].errors == single
    assert table['afternoon, clear'].errors == {}
