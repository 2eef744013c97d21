"""Pictures of runs and campaigns, which notebooks show by themselves."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from taxinet_ros.analysis.report.parts import Picture, Theme, style_axes
from taxinet_ros.analysis.report.pictures import LIGHT, png_bytes
from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.files.atomic import write_atomically

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True, slots=True)
class Plot:
    """A picture; a notebook shows it.

    Attributes:
        picture: what is drawn.
    """

    picture: Picture

    def _repr_png_(self) -> bytes:
        return png_bytes(self.picture, LIGHT)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write it as PNG, and return the path."""
        write_atomically(Path(path), self._repr_png_())
        return Path(path)

    def __repr__(self) -> str:
        return f'<Plot {self.picture.title}: {self.picture.caption}>'


def run_plot(trace: pd.DataFrame, half_width_m: float) -> Plot:
    """True and estimated cross-track and heading error of a run over time."""
    return Plot(picture=Picture(
        name='run', title='A run', draw=partial(_draw, trace, half_width_m), size_in=(7.0, 4.2),
        caption='Cross-track and heading error, true and estimated, left positive. The band is '
        'the tolerance of the centreline, lines are the edges of the runway.',
    ))


def _draw(trace: pd.DataFrame, half_width_m: float, figure: Figure, theme: Theme) -> None:
    above, below = figure.subplots(2, 1, sharex=True)
    above.axhspan(-CENTRELINE_TOLERANCE_M, CENTRELINE_TOLERANCE_M, color=theme.faint, zorder=0)
    far_m = trace['cte_m'].abs().max()
    for edge in (-half_width_m, half_width_m) if far_m > half_width_m / 2 else ():
        above.axhline(edge, color=theme.ink, linewidth=0.8)
    for axes, scale, name, title in (
        (above, lambda value: value, 'cte_m', 'from the line [m]'),
        (below, np.degrees, 'he_rad', 'heading error [°]'),
    ):
        axes.plot(trace['t_s'], scale(trace[name]), color=theme.failed, label='aircraft')
        axes.plot(trace['t_s'], scale(trace[f'est_{name}']), color=theme.passed, linestyle='--',
                  linewidth=1.2, label='estimate')
        axes.set_ylabel(title)
        style_axes(axes)
    below.set_xlabel('time [s]')
    above.legend(loc='best', fontsize=8)
