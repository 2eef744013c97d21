"""Pictures of forked runs: before and after on one time axis, and robustness over a change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from numpy.typing import NDArray

from taxinet_ros.analysis.report.parts import Picture, Theme
from taxinet_ros.core.mtl.interval import RobustnessInterval, lower_column, upper_column
from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.trace import Column
from taxinet_ros.core.types import NS_PER_S

_ROBUSTNESS_SHOWN = 12.0
_STEP_S = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Shown:
    """One of the two runs.

    Attributes:
        words: what it is, for the legend.
        columns: of its trace, see :mod:`taxinet_ros.core.trace`.
        frames: camera frames by control step, (H, W, 3) uint8 RGB.
    """

    words: str
    columns: Mapping[str, Column]
    frames: Mapping[int, NDArray[np.uint8]]


def shown_steps(step: int, last_seq: int) -> tuple[int, ...]:
    """Control steps of the frames to show: that of the fork, and evenly from there to the end."""
    return tuple(dict.fromkeys(
        int(found) for found in np.linspace(step, last_seq, 4).round()
    ))


def fork_picture(
    before: Shown, after: Shown, *, at_s: float, title: str, headline: str, half_width_m: float
) -> Picture:
    """Frames beside each other, and cross-track error and robustness over time.

    Args:
        before: the recorded run.
        after: the forked one.
        at_s: moment of the fork [s].
        title: title above the picture.
        headline: name of the requirement whose robustness is shown.
        half_width_m: half width of the runway [m].
    """
    def draw(figure: Figure, theme: Theme) -> None:
        figure.suptitle(title, fontsize=11, wrap=True)
        # One column of two gives an array, which the type of the function leaves open.
        pictures, curves = np.asarray(figure.subfigures(2, 1, height_ratios=(2.2, 4.6)))
        _draw_frames(pictures, theme, before, after)
        upper, lower = curves.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        limit = half_width_m + 4.0
        upper.axhspan(-CENTRELINE_TOLERANCE_M, CENTRELINE_TOLERANCE_M, color=theme.faint)
        for side in (-half_width_m, half_width_m):
            upper.axhline(side, color=theme.ink, linewidth=1.0)
        for run, colour in zip((before, after), _colours(theme), strict=True):
            _draw_errors(upper, run, colour)
            _draw_robustness(lower, run, colour, headline)
        for axes in (upper, lower):
            axes.axvline(at_s, color=theme.ink, linestyle=':', linewidth=1.2)
            axes.margins(x=0.01)
        upper.set_ylim(-limit, limit)
        upper.set_ylabel('cross-track error [m],\nleft is up')
        upper.annotate(
            f'fork, {at_s:g} s', (at_s, limit), textcoords='offset points', xytext=(4, -10),
            fontsize=8,
        )
        lower.axhline(0.0, color=theme.ink, linewidth=0.8)
        lower.set_ylim(-_ROBUSTNESS_SHOWN, 3.0)
        lower.set_ylabel(f'interval of ρ,\n{headline} [m]')
        lower.set_xlabel('time [s]')
        upper.legend(loc='lower left', fontsize=8, ncols=2)

    return Picture(
        name='fork', title=title, draw=draw, size_in=(9.0, 7.6),
        caption='Solid: truth; dashed: estimate. The band is the tolerance of the requirement.',
    )


def _colours(theme: Theme) -> tuple[str, str]:
    return theme.failed, theme.passed


def _draw_frames(figure: FigureBase, theme: Theme, before: Shown, after: Shown) -> None:
    steps = sorted(before.frames.keys() | after.frames.keys())
    grid = figure.subplots(2, max(len(steps), 1), squeeze=False)
    for row, run in enumerate((before, after)):
        for column, seq in enumerate(steps):
            axes = grid[row, column]
            axes.set_xticks([])
            axes.set_yticks([])
            axes.grid(visible=False)
            for spine in axes.spines.values():
                spine.set_color(_colours(theme)[row])
                spine.set_linewidth(2.0)
            if seq in run.frames:
                axes.imshow(run.frames[seq])
            else:
                axes.text(0.5, 0.5, 'ended', ha='center', va='center', transform=axes.transAxes)
            if row == 0:
                axes.set_title(f'{seq * _STEP_S:.1f} s', fontsize=9)
        grid[row, 0].set_ylabel(('before', 'after')[row], fontsize=9)


def _draw_errors(axes: Axes, run: Shown, colour: str) -> None:
    t_s = np.asarray(run.columns['t_ns'], dtype=np.float64) / NS_PER_S
    axes.plot(t_s, run.columns['cte_m'], color=colour, linewidth=1.6, label=run.words)
    axes.plot(
        t_s, run.columns['est_cte_m'], color=colour, linewidth=0.9, linestyle='--', alpha=0.7
    )


def _draw_robustness(axes: Axes, run: Shown, colour: str, headline: str) -> None:
    t_s = np.asarray(run.columns['t_ns'], dtype=np.float64) / NS_PER_S
    low, high = (
        np.clip(np.asarray(run.columns[column(headline)], dtype=np.float64), -1e6, 1e6)
        for column in (lower_column, upper_column)
    )
    axes.fill_between(t_s, low, high, color=colour, alpha=0.25, linewidth=0)
    axes.plot(t_s, high, color=colour, linewidth=1.2)


def sweep_picture(
    values: Sequence[float], rho: Sequence[RobustnessInterval], *, label: str, title: str,
    before: tuple[float | None, float], headline: str,
) -> Picture:
    """Robustness of forked runs over what was changed.

    Args:
        values: the changed value of each run, in the user's unit.
        rho: interval of the robustness of each run.
        label: name of the value, with its unit.
        title: title above the picture.
        before: value and least robustness of the recorded run.
        headline: name of the requirement.
    """
    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        low, high = np.array(rho, dtype=np.float64).T
        axes.axhline(0.0, color=theme.ink, linewidth=1.0)
        axes.fill_between(values, low, high, color=theme.faint)
        axes.plot(values, low, color=theme.faint, linewidth=1.2, zorder=1)
        for sign, colour, words in (
            (low > 0, theme.passed, 'satisfied'), (low <= 0, theme.failed, 'violated'),
        ):
            if sign.any():
                axes.plot(
                    np.array(values)[sign], low[sign], linestyle='', marker='o', markersize=5,
                    color=colour, label=words,
                )
        if before[0] is not None:
            axes.plot(
                [before[0]], [before[1]], linestyle='', marker='D', markersize=8, fillstyle='none',
                color=theme.ink, label='recorded',
            )
        axes.set_xlabel(label)
        axes.set_ylabel(f'ρ of {headline} [m]')
        axes.set_title(title, fontsize=11)
        axes.legend(fontsize=8)

    return Picture(
        name='sweep', title=title, draw=draw,
        caption='Each point is the run repeated to the fork, and gone on with this value.',
    )
