"""A picture of what a node answered in a recorded run, and what it answers now."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from taxinet_ros.analysis.replay_difference import Difference

# Okabe and Ito's colours; the newer one is dashed as well, for print in grey.
_TRUTH: dict[str, Any] = {'color': '0.15', 'linewidth': 1.0, 'linestyle': ':', 'label': 'truth'}
_BEFORE: dict[str, Any] = {'color': '#0072B2', 'linewidth': 2.4, 'alpha': 0.55}
_NOW: dict[str, Any] = {'color': '#D55E00', 'linewidth': 1.1, 'linestyle': (0, (4, 1.5))}

_FEW = 5


def plot_replay(
    differences: Sequence[Difference], trace: Mapping[str, NDArray[np.generic]], path: Path, *,
    title: str, recorded: str, replayed: str,
) -> None:
    """Draw each quantity over time: recorded, replayed, and the truth where there is one.

    Below each lies the difference of the two. The same values give the same bytes.

    Args:
        differences: what to draw, one row each.
        trace: columns of the recorded run.
        path: PNG file to write.
        title: heads the picture.
        recorded: what the recorded values are called in the legend.
        replayed: what the replayed ones are called.

    Raises:
        ValueError: there is nothing to draw.
    """
    if not differences:
        raise ValueError('no quantity to draw')
    rows = 2 * len(differences)
    figure = Figure(figsize=(9.5, 0.9 + 3.1 * len(differences)), dpi=110, layout='constrained')
    FigureCanvasAgg(figure)
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
    """What makes values visible that have no neighbour to draw a line to."""
    return {'marker': 'o', 'markersize': size} if np.isfinite(values).sum() < _FEW else {}
