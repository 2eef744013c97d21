"""The worst run on the first screen of a report: one frame of the camera, and the path."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from taxinet_ros.analysis.report.parts import Picture, Theme, style_axes
from taxinet_ros.analysis.report.pictures import data_address, view_picture
from taxinet_ros.analysis.report.viewer import Deciding, RunView, signal_unit
from taxinet_ros.bag.run.trace import Column
from taxinet_ros.core.mtl.interval import rho_text
from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.types import time_words
from taxinet_ros.core.verdict.run_statistics import deciding_steps

_BEYOND_EDGE_M = 3.0
_MORE_STEPS = 5


def rho_words(rho: float) -> str:
    """A robustness with sign and two decimals: ``−1.30``."""
    return rho_text(rho).replace('-', '−')


def view_worst(view: RunView, rho: float | None) -> dict[str, Any]:
    """What the template takes of the run on the first screen; '' for a frame that is not there.

    The frame is that nearest to the sample that decides the requirement, if this is about another
    signal than pose; else that at which the estimate is farthest off before the aircraft leaves its
    line, or the aircraft from the line where no estimate is known.

    Args:
        view: the run, of one step or more.
        rho: its robustness, if known.
    """
    row, known = _moment(view)
    at = time_words(view.t_s[row])
    cte, estimate = view.curves['cte'][row], view.curves['cteEstimate'][row]
    seen = f'The camera at {at}: the aircraft is {_side_words(cte)} of the line'
    seen += f', the network reports {_side_words(estimate)}. ' if known else '. '
    decides = view.deciding
    meaning = 'The band is the tolerance, lines are the edges of the pavement.'
    if decides is not None:
        shown = f'{view.signals[decides.signal][decides.row]:.2f}'.removesuffix('.00')
        value = f'{shown} {signal_unit(decides.signal)}'
        meaning = (
            f'{decides.spec} is decided at {time_words(view.t_s[decides.row])}, where '
            f'{decides.signal} is {value.strip()}.'.replace('-', '−')
        )
    frames = view.frames
    number = frames.steps.index(row) if row in frames.steps else None
    scene = view.summary
    return {
        'run_id': view.run_id, 'rho': '' if rho is None else rho_words(rho), 'at': at,
        'frame': '' if number is None else data_address(frames.files[number]),
        'path': view_picture(Picture(
            name='worst-path', caption='', size_in=(5.0, 2.5),
            title='The path of this run' if decides is None else f'{decides.signal} of this run',
            draw=partial(_draw, view, row) if decides is None else partial(_draw_signal, view, row),
        )),
        'caption': (f'{scene[:1].upper()}{scene[1:]}. ' if scene else '')
        + (seen if number is not None else '')
        + meaning,
    }


def _moment(view: RunView) -> tuple[int, bool]:
    """Row of the trace to show, of those with a frame, and whether the estimate is known there."""
    rows = np.array(view.frames.steps or range(len(view.t_s)))
    if view.deciding is not None:
        return int(rows[np.abs(rows - view.deciding.row).argmin()]), False
    cte = view.curves['cte'][rows]
    wrong = np.abs(view.curves['cteEstimate'][rows] - cte)
    off = np.abs(view.curves['cte']) > view.half_width_m
    on = int(off.argmax()) if off.any() else len(off)
    wrong[rows >= deciding_steps(_numbers(view.curves['cte'][:on]), _numbers(view.t_s))] = np.nan
    if np.isfinite(wrong).any() and np.nanmax(wrong) > 0:
        return int(rows[np.nanargmax(wrong)]), True
    far = np.where(np.isfinite(cte), np.abs(cte), -1.0)
    return int(rows[far.argmax()]), False


def _numbers(column: Column) -> NDArray[np.float64]:
    return np.asarray(column, dtype=np.float64)


def _side_words(cte_m: float) -> str:
    side = 'left' if cte_m >= 0 else 'right'
    return f'{abs(cte_m):.1f} m {side}'


def draw_limit(deciding: Deciding, axes: Axes, theme: Theme) -> None:
    """Draw the number that a signal is compared with, and name the axes of its curve."""
    if math.isfinite(deciding.bound):
        axes.axhline(deciding.bound, color=theme.ink, linewidth=1.0, label='limit')
    axes.set_xlabel('time [s]')
    axes.set_ylabel(deciding.label)


def _draw_signal(view: RunView, row: int, figure: Figure, theme: Theme) -> None:
    axes, decides = figure.subplots(), view.deciding
    assert decides is not None
    values = view.signals[decides.signal]
    draw_limit(decides, axes, theme)
    axes.plot(view.t_s, values, color=theme.failed, linewidth=2.0, label='aircraft')
    axes.plot(view.t_s[decides.row], values[decides.row], 'o', color=theme.ink, markersize=6,
              label='decides')
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.margins(x=0.02)
    style_axes(axes, grid='none')
    figure.legend(loc='outside upper center', ncols=3, frameon=False, fontsize=9)


def _draw(view: RunView, row: int, figure: Figure, theme: Theme) -> None:
    axes = figure.subplots()
    straight = view.track.is_runway
    edge, cte = view.half_width_m, view.curves['cte']
    on = np.flatnonzero(np.abs(cte) <= edge)
    # What the network reports about grass says nothing, and hides the rest.
    until = slice(0, max(int(on[-1]) if len(on) else 0, row) + _MORE_STEPS)
    across = (view.curves['x'] if straight else view.t_s)[until]
    axes.axhspan(-CENTRELINE_TOLERANCE_M, CENTRELINE_TOLERANCE_M, color=theme.faint, zorder=0)
    for side in (-edge, edge):
        axes.axhline(side, color=theme.ink, linewidth=1.0)
    axes.plot(across, cte[until], color=theme.failed, linewidth=2.0, label='aircraft')
    axes.plot(across, view.curves['cteEstimate'][until], color=theme.passed, linewidth=1.2,
              linestyle='--', label='network')
    axes.plot(across[row], cte[row], 'o', color=theme.ink, markersize=6,
              label='this frame')
    axes.set_ylim(-edge - _BEYOND_EDGE_M, edge + _BEYOND_EDGE_M)
    axes.set_xlabel('along the runway [m]' if straight else 'time [s]')
    axes.set_ylabel('from the line [m],\nleft is up')
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.margins(x=0.02)
    style_axes(axes, grid='none')
    figure.legend(loc='outside upper center', ncols=3, frameon=False, fontsize=9)
