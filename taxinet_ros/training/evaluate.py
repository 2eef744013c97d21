"""How well a network sees: in its own world, and where falsification looks for its gaps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.network import ARCHITECTURES, TaxiNet
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.weights import ERROR_QUANTITIES, SHIPPED, Model, load_model
from taxinet_ros.training.dataset import Dataset, Progress, draw_scenes, make_dataset, silent

_BATCH = 256

SLICES: dict[str, Callable[[Scenario], bool]] = {
    'all': lambda scene: True,
    'like the training': lambda s: _as_trained(s),
    'early morning': lambda s: _fine(s) and s.time_of_day_s < 8.5 * 3600,
    'afternoon, clear': lambda s: s.clouds == 'clear' and s.time_of_day_s > 12 * 3600,
    'broken or stratus, dry': lambda s: s.clouds in ('broken', 'stratus') and s.rain == 0,
    'rain': lambda s: s.rain > 0,
    'crossing': lambda s: _late_morning(s) and _at_crossing(s),
}
"""Parts of S_falsif that the paper's analysis tells apart, each by what belongs to it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SliceErrors:
    """Absolute errors on one part of a dataset.

    Attributes:
        name: of the part.
        images: pictures in it.
        errors: as in a model card, by quantity and statistic; empty where ``images`` is 0.
    """

    name: str
    images: int
    errors: dict[str, dict[str, float]]


def _fine(s: Scenario) -> bool:
    return s.rain == 0 and s.clouds not in ('broken', 'stratus') and not _at_crossing(s)


def _late_morning(s: Scenario) -> bool:
    return 8.5 * 3600 <= s.time_of_day_s <= 12 * 3600


def _at_crossing(s: Scenario) -> bool:
    return 1300 < s.distance_m < 1600


def _as_trained(s: Scenario) -> bool:
    return _fine(s) and _late_morning(s)


def absolute_errors(network: TaxiNet, dataset: Dataset) -> NDArray[np.float64]:
    """Distances of the estimates from the truth, (N, 2): [m] and [rad]."""
    starts = range(0, len(dataset), _BATCH)
    parts = [network.infer(dataset.pictures[start : start + _BATCH]) for start in starts]
    truth = np.stack([dataset.cte_m, dataset.he_rad], axis=1)
    return np.abs(np.concatenate([np.empty((0, 2)), *parts]) - truth)


def statistics(errors: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    """Mean, percentiles and maximum of errors (N, 2) in [m] and [rad], as a model card has them."""
    in_units = (errors[:, 0], np.degrees(errors[:, 1]))
    return {name: _row(column) for name, column in zip(ERROR_QUANTITIES, in_units, strict=True)}


def _row(errors: NDArray[np.float64]) -> dict[str, float]:
    values = {
        'mae': errors.mean(),
        'p50': np.percentile(errors, 50),
        'p90': np.percentile(errors, 90),
        'p99': np.percentile(errors, 99),
        'max': errors.max(),
    }
    return {name: round(float(value), 4) for name, value in values.items()}


def network_of(model: Model) -> TaxiNet:
    """The network that a checked model describes."""
    return TaxiNet(ARCHITECTURES[model.card.architecture], model.weights)


def evaluate(
    weights: Path = SHIPPED,
    *,
    program: str = 's_falsif',
    images: int = 2000,
    seed: int = 1,
    workers: int = 2,
    progress: Progress = silent,
) -> list[SliceErrors]:
    """Measure a network on the scenes of a program, whole and by :data:`SLICES`.

    Raises:
        UsageError: weights or program cannot be used.
        InfraError: a worker process died, or the simulator failed.
    """
    network = network_of(load_model(weights))
    scenes = draw_scenes(program, seed=seed, images=images, progress=progress)
    return by_slice(network, make_dataset(scenes, workers=workers, progress=progress))


def by_slice(network: TaxiNet, dataset: Dataset) -> list[SliceErrors]:
    """Errors on every part of a dataset."""
    errors = absolute_errors(network, dataset)
    rows = []
    for name, belongs in SLICES.items():
        chosen = np.array([belongs(scene) for scene in dataset.scenarios], bool)
        images = int(chosen.sum())
        values = statistics(errors[chosen]) if images else {}
        rows.append(SliceErrors(name=name, images=images, errors=values))
    return rows
