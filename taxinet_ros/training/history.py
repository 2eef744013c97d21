"""What happened in a training, epoch by epoch."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields


@dataclass(frozen=True, kw_only=True, slots=True)
class Epoch:
    """One pass over all the training pictures, and a look at the validation pictures after it.

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
