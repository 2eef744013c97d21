"""Accuracy of a network: values per epoch, and errors on a dataset."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.perception.network import TaxiNet
from taxinet_ros.core.perception.weights import ERROR_QUANTITIES
from taxinet_ros.training.data.dataset import Dataset


@dataclass(frozen=True, kw_only=True, slots=True)
class Epoch:
    """One epoch: a pass over the training images and its validation.

    Attributes:
        number: from 1.
        learning_rate: at its last step.
        training_loss: mean over its steps, while the weights changed and, where asked for, on
            augmented pictures; it may therefore lie above the other.
        validation_loss: mean over the validation pictures, with the weights at its end.
        cte_mae_m, he_mae_deg: mean absolute errors there [m] and [degrees].
    """

    number: int
    learning_rate: float
    training_loss: float
    validation_loss: float
    cte_mae_m: float
    he_mae_deg: float


def history_csv(history: Sequence[Epoch]) -> str:
    """The epochs as CSV, one line each under the names of their values."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(field.name for field in fields(Epoch))
    for epoch in history:
        writer.writerow(f'{value:.6g}' for value in astuple(epoch))
    return text.getvalue()


_BATCH = 256
_NORMAL_95 = 1.959964
"""Standard deviations that hold 95 % of a normal distribution on both sides of its mean."""


def absolute_errors(network: TaxiNet, dataset: Dataset) -> NDArray[np.float64]:
    """Distances of the estimates from the truth, (N, 2): [m] and [rad]."""
    starts = range(0, len(dataset), _BATCH)
    parts = [network.infer(dataset.pictures[start : start + _BATCH]) for start in starts]
    truth = np.stack([dataset.cte_m, dataset.he_rad], axis=1)
    return np.abs(np.concatenate([np.empty((0, 2)), *parts]) - truth)


def error_statistics(errors: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    """Mean, percentiles and maximum of errors (N, 2) in [m] and [rad], as a model card has them."""
    columns = zip(ERROR_QUANTITIES, in_card_units(errors).T, strict=True)
    return {name: _row(column) for name, column in columns}


def in_card_units(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Errors (N, 2) in [m] and [degrees] of those in [m] and [rad]."""
    return np.stack([errors[:, 0], np.degrees(errors[:, 1])], axis=1)


def half_width_95(values: NDArray[np.float64]) -> float | None:
    """Half the width of a 95 % confidence interval of the mean, None for fewer than two values.

    It takes the mean for normally distributed, which that of some dozens of independent errors is.
    """
    if len(values) < 2:
        return None
    return _NORMAL_95 * float(values.std(ddof=1)) / math.sqrt(len(values))


def _row(errors: NDArray[np.float64]) -> dict[str, float]:
    values = {
        'mae': errors.mean(),
        'p50': np.percentile(errors, 50),
        'p90': np.percentile(errors, 90),
        'p99': np.percentile(errors, 99),
        'max': errors.max(),
    }
    return {name: round(float(value), 4) for name, value in values.items()}
