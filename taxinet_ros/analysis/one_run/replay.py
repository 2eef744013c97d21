"""Comparison of a node's answers to a recorded run with the recorded ones: values, picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from taxinet_ros.core.topics import MTL_MONITOR, PERCEPTION, STEERING_CONTROLLER
from taxinet_ros.core.types import NS_PER_S, time_words

Values = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A number that a node answers at every step.

    Attributes:
        column: name in a trace.
        label: display name.
        unit: display unit.
        scale: factor from the trace's unit to the display unit.
        truth: column of the true value, or ''.
    """

    column: str
    label: str
    unit: str
    scale: float = 1.0
    truth: str = ''

_COLUMNS = {
    PERCEPTION: ('est_cte_m', 'est_he_rad'),
    STEERING_CONTROLLER: ('steering_rad', 'speed_cmd_mps'),
    MTL_MONITOR: ('rho_lower.', 'rho_upper.'),
}
"""Columns of a run's trace that a node fills, by its name."""
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
        quantity: the quantity.
        recorded: recorded values, (N,), in the display unit; NaN where there was none.
        replayed: replayed values, likewise.
        equal_steps: number of steps at which both are bit-identical.
        first_seq: first step at which they differ, or None.
        first_s: its simulated time [s], or None.
        mean: mean absolute difference over the steps at which both have a value.
        greatest: greatest absolute difference; infinite if only one has a value somewhere.
    """

    quantity: Quantity
    recorded: Values
    replayed: Values
    equal_steps: int
    first_seq: int | None
    first_s: float | None
    mean: float
    greatest: float

    @property
    def delta(self) -> Values:
        """Replayed minus recorded, (N,); 0 where both are the same infinity."""
        with np.errstate(invalid='ignore'):
            return np.where(self.replayed == self.recorded, 0.0, self.replayed - self.recorded)


def quantities(names: Mapping[str, object], per_node: tuple[str, ...]) -> list[Quantity]:
    """The quantities of a trace whose column starts with one of ``per_node``, in this order."""
    known = {quantity.column: quantity for quantity in _KNOWN}
    return [
        known.get(name) or Quantity(column=name, label=name.replace('.', ', '), unit='')
        for name in names
        if name.startswith(per_node)
    ]


def difference(
    quantity: Quantity, trace: Mapping[str, NDArray[np.generic]], answers: Mapping[str, Values]
) -> Difference:
    """Compare one quantity of a recorded trace with the new answers, step by step."""
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
        first_s=float(trace['t_ns'][first[0]]) / NS_PER_S if len(first) else None,
        mean=float(away[both].mean()) if both.any() else 0.0,
        greatest=float(away.max(initial=0.0)),
    )


def differences(
    node: str, trace: Mapping[str, NDArray[np.generic]], answers: Mapping[str, Values]
) -> list[Difference]:
    """Compare all that a node answers; arguments as of :func:`difference`."""
    return [
        difference(quantity, trace, answers)
        for quantity in quantities(trace, _COLUMNS.get(node, ()))
    ]


# Okabe-Ito colours; the replayed curve is also dashed, for greyscale prints.
_TRUTH: dict[str, Any] = {'color': '0.15', 'linewidth': 1.0, 'linestyle': ':', 'label': 'truth'}
_BEFORE: dict[str, Any] = {'color': '#0072B2', 'linewidth': 2.4, 'alpha': 0.55}
_NOW: dict[str, Any] = {'color': '#D55E00', 'linewidth': 1.1, 'linestyle': (0, (4, 1.5))}
_FEW = 5


def plot_replay(
    differences: Sequence[Difference], trace: Mapping[str, NDArray[np.generic]], path: Path, *,
    title: str, recorded: str, replayed: str,
) -> None:
    """Draw each quantity over time: recorded, replayed, and the truth if known.

    Below each is the difference of the two. The same values give the same bytes.

    Args:
        differences: the quantities to draw, one row each.
        trace: columns of the recorded run.
        path: PNG file to write.
        title: title of the picture.
        recorded: name of the recorded values in the legend.
        replayed: name of the replayed values.
    """
    rows = 2 * len(differences)
    figure = Figure(figsize=(9.5, 0.9 + 3.1 * len(differences)), dpi=110, layout='constrained')
    ratios = [3, 1] * len(differences)
    grid = figure.subplots(rows, 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0]
    t_s = trace['t_ns'].astype(np.float64) / 1e9
    for number, one in enumerate(differences):
        upper, lower = grid[2 * number], grid[2 * number + 1]
        _draw(upper, one, t_s, trace, recorded, replayed)
        _draw_difference(lower, one, t_s)
    grid[-1].set_xlabel('time [s]')
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=3, frameon=False)
    figure.suptitle(title, fontsize=12)
    figure.savefig(path, format='png', metadata={'Software': None})


def _draw(
    axes: Axes, one: Difference, t_s: NDArray[np.float64],
    trace: Mapping[str, NDArray[np.generic]], recorded: str, replayed: str,
) -> None:
    quantity = one.quantity
    axes.plot(t_s, one.recorded, label=recorded, **_BEFORE, **_dots(one.recorded, 9))
    axes.plot(t_s, one.replayed, label=replayed, **_NOW, **_dots(one.replayed, 5))
    endless = int(np.isinf(one.recorded).sum())
    if endless:
        words = f'recorded: infinite at {endless} of {len(t_s)} steps'
        axes.text(0.01, 0.04, words, transform=axes.transAxes, fontsize=8, color='0.35')
    if quantity.truth:
        axes.plot(t_s, trace[quantity.truth].astype(np.float64) * quantity.scale, **_TRUTH)
    unit = f' [{quantity.unit}]' if quantity.unit else ''
    axes.set_ylabel(f'{quantity.label}{unit}')
    axes.grid(visible=True, color='0.92', linewidth=0.6)
    axes.margins(x=0.01)


def _draw_difference(axes: Axes, one: Difference, t_s: NDArray[np.float64]) -> None:
    axes.set_ylabel('now −\nrecorded', fontsize=8)
    if one.first_seq is None:
        axes.text(
            0.5, 0.5, 'the same at every step, to the bit', transform=axes.transAxes,
            ha='center', va='center', fontsize=8, color='0.35',
        )
        axes.set_yticks([])
        return
    axes.plot(t_s, one.delta, color='0.25', linewidth=0.9)
    axes.axhline(0.0, color='0.7', linewidth=0.7, zorder=0)
    axes.grid(visible=True, color='0.92', linewidth=0.6)


def _dots(values: NDArray[np.float64], size: int) -> dict[str, Any]:
    """Style that shows isolated values, which have no neighbour to join by a line."""
    return {'marker': 'o', 'markersize': size} if np.isfinite(values).sum() < _FEW else {}

def within(one: Difference, allowed: Mapping[str, float]) -> bool:
    """Whether a difference is within the tolerance; without one, it must be zero."""
    most = allowed.get(one.quantity.column, 0.0)
    return one.first_seq is None if most == 0 else one.greatest <= most


def replay_lines(
    found: Sequence[Difference], allowed: Mapping[str, float]
) -> list[tuple[str, str]]:
    """Lines of a table of differences, with their styles.

    Args:
        found: the differences.
        allowed: greatest differences by column, in display units; of others 0.
    """
    heading = ('quantity', 'mean |Δ|', 'max |Δ|', 'allowed', 'equal steps', 'first other')
    rows = [heading, *(_cells(one, allowed) for one in found)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    styles = ['bold', *('' if within(one, allowed) else 'red' for one in found)]
    lines = (
        f'{row[0]:<{widths[0]}}' + ''.join(
            f'  {cell:>{width}}' for cell, width in zip(row[1:], widths[1:], strict=True))
        for row in rows
    )
    return list(zip(lines, styles, strict=True))


def _cells(one: Difference, allowed: Mapping[str, float]) -> tuple[str, ...]:
    unit = f' {one.quantity.unit}' if one.quantity.unit else ''
    most = allowed.get(one.quantity.column, 0.0)
    first = '-' if one.first_s is None else (
        f'step {one.first_seq} ({time_words(one.first_s)})'
    )
    return (
        one.quantity.label, f'{one.mean:.3g}{unit}', f'{one.greatest:.3g}{unit}',
        f'{most:g}{unit}' if most else 'no bit', f'{one.equal_steps} of {len(one.recorded)}',
        first,
    )


def conclusion(found: Sequence[Difference], *, equal: bool) -> str:
    """What follows; ``equal``: all are within their tolerances."""
    if all(one.first_seq is None for one in found):
        return 'bit-identical'
    return 'the same within the tolerance' if equal else 'different'


def write_values(
    found: Sequence[Difference], trace: Mapping[str, NDArray[np.generic]], path: Path
) -> None:
    """Write one row per step: recorded, replayed and true values, in display units."""
    columns: dict[str, NDArray[np.generic]] = {'seq': trace['seq']}
    for one in found:
        quantity = one.quantity
        name = quantity.label.replace(' ', '_').replace('-', '_')
        suffix = f'_{quantity.unit.replace("/", "p")}' if quantity.unit else ''
        columns[f'recorded_{name}{suffix}'] = one.recorded
        columns[f'replayed_{name}{suffix}'] = one.replayed
        if quantity.truth:
            true = trace[quantity.truth].astype('float64') * quantity.scale
            columns[f'true_{name.removesuffix("_estimate")}{suffix}'] = true
    pd.DataFrame(columns).to_csv(path, index=False, na_rep='nan')
