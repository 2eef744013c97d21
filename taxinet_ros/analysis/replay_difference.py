"""How far the answers of a node, fed with a recorded run, lie from those recorded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One number that a node answers every step.

    Attributes:
        column: its name in a trace.
        label: for people.
        unit: in which people read it.
        scale: what makes that unit out of the trace's.
        truth: column of what it should be, or ''.
    """

    column: str
    label: str
    unit: str
    scale: float = 1.0
    truth: str = ''


_KNOWN = (
    Quantity(column='est_cte_m', label='cross-track estimate', unit='m', truth='cte_m'),
    Quantity(
        column='est_he_rad', label='heading estimate', unit='deg', scale=180 / math.pi,
        truth='he_rad',
    ),
    Quantity(column='steering_rad', label='steering angle', unit='deg', scale=180 / math.pi),
    Quantity(column='speed_cmd_mps', label='speed command', unit='m/s'),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Difference:
    """One quantity, recorded and replayed.

    Attributes:
        quantity: which.
        recorded: its values as recorded, (N,), in the unit for people; NaN where there was none.
        replayed: its values now, likewise.
        equal_steps: steps at which both are the same to the bit.
        first_seq: the first step at which they are not, or None.
        mean: mean absolute difference, over the steps at which both have a value.
        greatest: the greatest; infinite where only one of them has a value.
    """

    quantity: Quantity
    recorded: Values
    replayed: Values
    equal_steps: int
    first_seq: int | None
    mean: float
    greatest: float

    @property
    def delta(self) -> Values:
        """Replayed minus recorded, (N,); 0 where both are the same infinity."""
        with np.errstate(invalid='ignore'):
            return np.where(self.replayed == self.recorded, 0.0, self.replayed - self.recorded)


def quantities(names: Mapping[str, object], per_node: tuple[str, ...]) -> list[Quantity]:
    """The quantities of a trace whose column begins with one of ``per_node``, in its order."""
    known = {quantity.column: quantity for quantity in _KNOWN}
    return [
        known.get(name) or Quantity(column=name, label=name.replace('.', ', '), unit='')
        for name in names
        if name.startswith(per_node)
    ]


def difference(
    quantity: Quantity, trace: Mapping[str, NDArray[np.generic]], answers: Mapping[str, Values]
) -> Difference:
    """Compare one quantity of a recorded trace with what was answered now, step by step."""
    seqs = trace['seq'].astype(np.int64)
    now = np.full(len(seqs), np.nan)
    if quantity.column in answers:
        place = {int(seq): number for number, seq in enumerate(answers['seq'])}
        at = [place.get(int(seq), -1) for seq in seqs]
        known = np.array(at) >= 0
        now[known] = answers[quantity.column][[number for number in at if number >= 0]]
    before = trace[quantity.column].astype(np.float64)
    missing = np.isnan(before) & np.isnan(now)
    same = missing | (before.view(np.int64) == now.view(np.int64))
    with np.errstate(invalid='ignore'):
        away = np.abs(before - now) * quantity.scale
    away[same] = 0.0
    away[np.isnan(away)] = np.inf
    both = np.isfinite(away) & ~missing
    first = np.flatnonzero(~same)
    return Difference(
        quantity=quantity, recorded=before * quantity.scale, replayed=now * quantity.scale,
        equal_steps=int(same.sum()), first_seq=int(seqs[first[0]]) if len(first) else None,
        mean=float(away[both].mean()) if both.any() else 0.0,
        greatest=float(away.max(initial=0.0)),
    )
