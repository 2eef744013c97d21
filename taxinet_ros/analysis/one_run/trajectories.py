"""Pictures of the trajectories of runs, one column per perception."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from taxinet_ros.core.place.runway import KMWH_HALF_WIDTH_M

BAND_M = 1.5
"""Half width of the band in the paper's specification [m] (paper, section 3.1)."""

# Okabe-Ito blue and vermilion, distinguishable with all common colour vision deficiencies; a failed
# run is also dashed, for greyscale prints.
_Style = dict[str, Any]
_PASSED: _Style = {'color': '#0072B2', 'linestyle': '-', 'zorder': 3}
_FAILED: _Style = {'color': '#D55E00', 'linestyle': (0, (5, 1.5)), 'zorder': 4}
_BAND: _Style = {'color': '#009E73', 'alpha': 0.18, 'linewidth': 0, 'zorder': 1}
_EDGE: _Style = {'color': '0.25', 'linewidth': 1.4, 'zorder': 2}

_BEYOND_EDGE_M = 4.0
"""Width of grass shown beyond the runway edges [m]; runs may leave the picture."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """The true trajectory of one run.

    Attributes:
        label: name of the column, usually the perception's word.
        t_s: stamps from the start of the run [s], (N,).
        x_m: distance along the track [m], (N,).
        cte_m: cross-track error [m], left positive, (N,).
        ok: whether the run satisfied its specification; None if it was not judged.
        half_width_m: half width of its runway [m].
    """

    label: str
    t_s: NDArray[np.float64]
    x_m: NDArray[np.float64]
    cte_m: NDArray[np.float64]
    ok: bool | None
    half_width_m: float = KMWH_HALF_WIDTH_M


def plot_trajectories(trajectories: Sequence[Trajectory], path: Path, title: str = '') -> None:
    """Draw cross-track error over time and over distance, one column per label.

    The same trajectories give the same bytes. Left of the centreline is up; a dot marks a start.

    Args:
        trajectories: runs of one or more labels, with columns in order of appearance.
        path: PNG file to write.
        title: title of the picture.
    """
    labels = list(dict.fromkeys(one.label for one in trajectories))
    figure = Figure(figsize=(1.6 + 5.2 * len(labels), 7.2), dpi=110, layout='constrained')
    grid = figure.subplots(2, len(labels), squeeze=False, sharey=True, sharex='row')
    for column, label in enumerate(labels):
        own = [one for one in trajectories if one.label == label]
        _draw(grid[0, column], own, [one.t_s for one in own])
        _draw(grid[1, column], own, [one.x_m for one in own])
        grid[0, column].set_title(f'{label}: {_count(own)}', fontsize=12)
        grid[0, column].set_xlabel('time [s]')
        grid[1, column].set_xlabel('distance along the track [m]')
    for axes in grid[:, 0]:
        axes.set_ylabel('cross-track error [m], left is up')
    _legend(figure, trajectories)
    if title:
        figure.suptitle(title, fontsize=13)
    figure.savefig(path, format='png', metadata={'Software': None})


def _draw(axes: Axes, own: Sequence[Trajectory], along: Sequence[NDArray[np.float64]]) -> None:
    edge = max(one.half_width_m for one in own)
    limit = edge + _BEYOND_EDGE_M
    axes.axhspan(-limit, -edge, color='0.88', zorder=0)
    axes.axhspan(edge, limit, color='0.88', zorder=0)
    axes.axhspan(-BAND_M, BAND_M, **_BAND)
    for side in (-edge, edge):
        axes.axhline(side, **_EDGE)
    # Many passed runs are translucent; a failed run must stand out among them.
    alpha = float(np.clip(8 / max(len(own), 1), 0.4, 1.0))
    for one, x in zip(own, along, strict=True):
        style = _style(one)
        axes.plot(x, one.cte_m, linewidth=1.4, alpha=1.0 if one.ok is False else alpha, **style)
        axes.plot(x[:1], one.cte_m[:1], marker='o', markersize=3.5, **style)
    axes.text(
        0.01, 0.985, 'off the runway', transform=axes.transAxes, va='top', fontsize=8, color='0.35'
    )
    axes.set_ylim(-limit, limit)
    axes.margins(x=0.01)
    axes.grid(visible=True, color='0.9', linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)


def _style(one: Trajectory) -> _Style:
    if one.ok is None:
        return {'color': '0.5', 'linestyle': ':', 'zorder': 2}
    return dict(_PASSED if one.ok else _FAILED)


def _count(own: Sequence[Trajectory]) -> str:
    judged = [one for one in own if one.ok is not None]
    if not judged:
        return 'no run was judged'
    unjudged = len(own) - len(judged)
    rest = f', {unjudged} not judged' if unjudged else ''
    return f'{sum(bool(one.ok) for one in judged)} of {len(judged)} runs passed{rest}'


def _legend(figure: Figure, trajectories: Sequence[Trajectory]) -> None:
    names = {True: 'passed', False: 'failed', None: 'not judged'}
    kinds = {one.ok: one for one in trajectories}
    handles: list[Line2D] = [
        Line2D([], [], label=name, linewidth=1.8, **_style(kinds[ok]))
        for ok, name in names.items() if ok in kinds
    ]
    handles.append(Line2D([], [], color='#009E73', alpha=0.35, linewidth=9,
                          label=f'within {BAND_M:g} m of the centreline'))
    handles.append(Line2D([], [], color='0.25', linewidth=1.4, label='runway edge'))
    columns = 3 if len({one.label for one in trajectories}) == 1 else len(handles)
    figure.legend(handles=handles, loc='outside lower center', ncols=columns, frameon=False)
