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
        number: number of the epoch, from 1.
        learning_rate: learning rate at its last step.
        training_loss: mean over its steps, with changing weights and, if requested, on augmented
            pictures; it may therefore exceed ``validation_loss``.
        validation_loss: mean over the validation pictures, with the weights at its end.
        cte_mae_m, he_mae_deg: mean absolute errors on them [m] and [degrees].
    """

    number: int
    learning_rate: float
    training_loss: float
    validation_loss: float
    cte_mae_m: float
    he_mae_deg: float


def history_csv(history: Sequence[Epoch]) -> str:
    """The epochs as CSV with a header, one row per epoch."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(field.name for field in fields(Epoch))
    for epoch in history:
        writer.writerow(f'{value:.6g}' for value in astuple(epoch))
    return text.getvalue()


_BATCH = 256
_NORMAL_95 = 1.959964
"""Two-sided 95 % quantile of the standard normal distribution."""


def absolute_errors(network: TaxiNet, dataset: Dataset) -> NDArray[np.float64]:
    """Absolute errors of the estimates, (N, 2): [m] and [rad]."""
    starts = range(0, len(dataset), _BATCH)
    parts = [network.infer(dataset.pictures[start : start + _BATCH]) for start in starts]
    truth = np.stack([dataset.cte_m, dataset.he_rad], axis=1)
    return np.abs(np.concatenate([np.empty((0, 2)), *parts]) - truth)


def error_statistics(errors: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    """Mean, percentiles and maximum of errors (N, 2) in [m] and [rad], as in a model card."""
    columns = zip(ERROR_QUANTITIES, in_card_units(errors).T, strict=True)
    return {name: _row(column) for name, column in columns}


def in_card_units(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert errors (N, 2) from [m] and [rad] to [m] and [degrees]."""
    return np.stack([errors[:, 0], np.degrees(errors[:, 1])], axis=1)


def half_width_95(values: NDArray[np.float64]) -> float | None:
    """Half the width of a 95 % confidence interval of the mean, None for fewer than two values.

    It assumes a normally distributed mean, as for a few dozen independent errors.
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
