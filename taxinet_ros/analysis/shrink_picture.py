"""A picture of a failed run, of the shrunk one, and of plain taxiing: their paths over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from taxinet_ros.analysis.trajectories import BAND_M, Trajectory
from taxinet_ros.core.runway import HALF_WIDTH_M

# Okabe and Ito's colours, told apart with every common colour blindness; the dashes help in grey.
_STYLES: tuple[dict[str, Any], ...] = (
    {'color': '#D55E00', 'linestyle': (0, (5, 1.5)), 'linewidth': 1.6},
    {'color': 'black', 'linestyle': '-', 'linewidth': 2.2},
    {'color': '#0072B2', 'linestyle': (0, (1, 1)), 'linewidth': 2.0},
)
_LEAST_M, _BEYOND_EDGE_M = 2.5, 4.0


def shrink_picture(runs: Sequence[Trajectory], path: Path, title: str) -> None:
    """Draw up to three runs on top of one another. The same runs give the same bytes.

    Args:
        runs: the original, the shrunk and the nominal one, as far as there are; the labels are
            shown.
        path: PNG file to write.
        title: heads the picture.

    Raises:
        ValueError: there is nothing to draw, or there are too many.
    """
    if not 0 < len(runs) <= len(_STYLES):
        raise ValueError(f'{len(runs)} runs to draw')
    figure = Figure(figsize=(8.0, 4.4), dpi=110, layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    _background(axes, _limit(runs))
    for order, (run, style) in enumerate(zip(runs, _STYLES, strict=False)):
        axes.plot(run.t_s, run.cte_m, label=run.label, zorder=3 + order, **style)
        axes.plot(run.t_s[:1], run.cte_m[:1], marker='o', markersize=4, color=style['color'])
    axes.set_xlabel('time [s]')
    axes.set_ylabel('cross-track error [m], left is up')
    axes.set_title(title, fontsize=11)
    band, *lines = axes.get_legend_handles_labels()[0]
    figure.legend(
        handles=[*lines, band], loc='outside lower center', ncols=4, frameon=False, fontsize=9
    )
    figure.savefig(path, format='png', metadata={'Software': None})


def _limit(runs: Sequence[Trajectory]) -> float:
    """Half the height shown [m]: all that the runs do, but little more grass than runway."""
    farthest = max(float(np.abs(run.cte_m).max()) for run in runs)
    return float(np.clip(1.1 * farthest, _LEAST_M, HALF_WIDTH_M + _BEYOND_EDGE_M))


def _background(axes: Axes, limit: float) -> None:
    axes.axhspan(-BAND_M, BAND_M, color='#009E73', alpha=0.18, linewidth=0, zorder=1,
                 label=f'within {BAND_M:g} m of the centreline')
    if limit > HALF_WIDTH_M:
        for side in (-1, 1):
            axes.axhspan(side * HALF_WIDTH_M, side * limit, color='0.88', zorder=0)
            axes.axhline(side * HALF_WIDTH_M, color='0.25', linewidth=1.4, zorder=2)
        axes.text(0.01, 0.985, 'off the runway', transform=axes.transAxes, va='top', fontsize=8,
                  color='0.35')
    axes.set_ylim(-limit, limit)
    axes.margins(x=0.01)
    axes.grid(visible=True, color='0.9', linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)
