"""Picture of a requirement's parts: robustness over time, and the sample that decides."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from taxinet_ros.analysis.report.parts import Theme, style_axes
from taxinet_ros.core.mtl.explain import Clause, Explanation
from taxinet_ros.core.types import NS_PER_S, time_words

ROW_IN = 0.95
"""Height of one part [inch]."""


def draw_clauses(figure: FigureBase, found: Explanation, theme: Theme, end_s: float) -> None:
    """Draw each part over the samples that the requirement reads; the run ends at ``end_s``."""
    t_s = np.array(found.stamps_ns) / NS_PER_S
    rows = figure.subplots(len(found.clauses), 1, sharex=True, squeeze=False)[:, 0]
    for axes, one in zip(rows, found.clauses, strict=True):
        _draw(axes, one, t_s, theme, one is found.witness)
        style_axes(axes)
        axes.tick_params(labelsize=7)
    rows[-1].set_xlim(0, max(end_s, float(t_s[-1])))
    rows[-1].set_xlabel('time [s]', fontsize=8)


def _draw(axes: Axes, one: Clause, t_s: np.ndarray, theme: Theme, witness: bool) -> None:
    lower, upper = np.array(one.lower), np.array(one.upper)
    known = np.concatenate([[0.0], lower[np.isfinite(lower)], upper[np.isfinite(upper)]])
    pad = 0.15 * float(np.ptp(known)) or 1.0
    floor, ceiling = float(known.min()) - pad, float(known.max()) + pad
    low, high = np.clip(lower, floor, ceiling), np.clip(upper, floor, ceiling)
    axes.set_ylim(floor, ceiling)
    axes.axhline(0, color=theme.ink, linewidth=0.8)
    axes.fill_between(t_s, low, high, color=theme.passed, alpha=0.25, linewidth=0)
    exact = lower == upper
    single = 'o' if np.isfinite(low).sum() == 1 else ''
    for fits, colour in ((lower > 0, theme.passed), (upper <= 0, theme.failed)):
        axes.plot(t_s, np.where(exact & fits, low, np.nan), color=colour, linewidth=1.4,
                  marker=single, markersize=3)
    colour = theme.failed if upper[one.row] <= 0 else theme.passed
    if one.decides:
        axes.plot([t_s[one.row]], [(high if upper[one.row] <= 0 else low)[one.row]], marker='o',
                  markersize=8 if witness else 5, markerfacecolor=colour if witness else 'none',
                  markeredgecolor=colour, clip_on=False, zorder=5)
    text = one.text if len(one.text) <= 96 else f'{one.text[:95]}…'  # as much as fits
    at = time_words(t_s[one.row])
    words = f'{one.interval.words()} at {at}' if one.interval else 'not needed'
    axes.set_title(f'{"    " * one.depth}{text}', fontsize=8, loc='left', color=theme.ink)
    axes.set_title(
        f'{words}{", decides" if witness else ""}', fontsize=8, loc='right',
        color=colour if one.decides else theme.ink,
        weight='bold' if witness else 'normal',
    )
