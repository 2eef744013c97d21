"""Pictures of a confirmation experiment: every arm's runs, and how much each scene changes."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from taxinet_ros.analysis.figure_parts import plain
from taxinet_ros.analysis.paired_arms import Comparison, PairedArms, rho_of
from taxinet_ros.analysis.report_parts import Picture, Theme

_NAMES = {
    'time_of_day': ('time of day', 'h'), 'distance': ('distance past the threshold', 'm'),
    'cross_track': ('cross-track error at the start', 'm'),
    'heading': ('heading error at the start', '°'), 'rain': ('rain', '%'),
}
"""Keys of the scenario for people, with their units."""

_LOWEST_SHOWN = -6.0
"""Runs that leave the centreline for good are shown at the picture's lower edge."""

_MOST_CHANGE = 8.0

_BINS, LEAST_IN_BIN = 12, 3
"""Parts of what is drawn over, and the least number of runs in one that say something."""


def title_of(key: str) -> str:
    """A key of the scenario for people, with its unit."""
    name, unit = _NAMES.get(key, (key, ''))
    return f'{name} [{unit}]' if unit else name


def range_words(key: str, low: float, high: float) -> str:
    """From where to where a key goes, for people."""
    name, unit = _NAMES.get(key, (key, ''))
    digits = 0 if abs(high) >= 100 else 1
    return f'{name} {low:.{digits}f} to {high:.{digits}f} {unit}'.strip()


def arms_picture(found: PairedArms) -> Picture:
    """Every arm's runs, in a colour of its own."""
    names = ' and '.join(found.rows)
    lines = (
        'neighbours are joined' if found.alone
        else 'lines are medians, and pairs with another verdict are joined'
    )
    return Picture(
        name='experiment', title=f'ρ with {names}',
        caption=f'A dot is a run; {lines}. Above 0 the formula is satisfied; what is below '
                f'{_LOWEST_SHOWN:g} would be a triangle at the edge.',
        draw=partial(_draw, found), size_in=(7.6, 4.0),
    )


def _draw(found: PairedArms, figure: Figure, theme: Theme) -> None:
    axes = figure.subplots()
    experiment = found.experiment
    places = {row.index: getattr(row, found.over) for row in found.rows[experiment.compare_to]}
    if not found.alone:
        for one in found.comparisons:
            _join_flips(axes, one, places, theme)
    others = iter(theme.others * len(experiment.arms))
    for arm in experiment.arms:
        # The suspect in the colour of failure; two arms are told apart by anybody.
        base = arm.name == experiment.compare_to
        colour = theme.failed if base else theme.passed if len(experiment.arms) == 2 \
            else next(others)
        _draw_arm(axes, found, arm.name, places, colour, above=not base)
    axes.axhline(0, color=theme.ink, linewidth=0.8)
    axes.set(
        xlabel=title_of(found.over),
        ylabel=f'ρ of {experiment.specs[0].partition("=")[0]} [m]', ylim=(_lowest(found), None),
    )
    # Upright lines join pairs there, and would be lost among those of a grid.
    plain(axes, grid='both' if found.alone else 'y')
    axes.legend(frameon=False, loc='lower center', bbox_to_anchor=(0.5, 1.0),
                ncols=len(experiment.arms))


def _lowest(found: PairedArms) -> float:
    rhos = [rho_of(row) for rows in found.rows.values() for row in rows if row.outcome.judged]
    return max(min([0.0, *rhos]) - 0.2, _LOWEST_SHOWN)


def _draw_arm(
    axes: Axes, found: PairedArms, name: str, places: dict[int, float], colour: str, *,
    above: bool,
) -> None:
    points = sorted(
        (float(places[row.index]), rho_of(row)) for row in found.rows[name]
        if row.outcome.judged and places.get(row.index) is not None
    )
    x, rho = (np.array(values, dtype=np.float64) for values in zip(*points, strict=True)) \
        if points else (np.empty(0), np.empty(0))
    shown = np.maximum(rho, _LOWEST_SHOWN)
    order = 4 if above else 3
    inside = rho > _LOWEST_SHOWN
    axes.plot(x[inside], rho[inside], 'o', color=colour, markersize=4 if found.alone else 3,
              alpha=1.0 if found.alone else 0.6, zorder=order, label=name, markeredgewidth=0)
    axes.plot(x[~inside], shown[~inside], 'v', color=colour, markersize=5, zorder=order,
              clip_on=False, markeredgewidth=0)
    if found.alone:
        axes.plot(x, shown, color=colour, linewidth=1.0, alpha=0.7, zorder=order - 2)
    elif len(x):
        axes.plot(*_medians(x, shown), color=colour, linewidth=2.0, zorder=order + 2)


def _join_flips(
    axes: Axes, one: Comparison, places: dict[int, float], theme: Theme
) -> None:
    for a, b in one.pairs:
        if a.outcome is not b.outcome and places.get(a.index) is not None:
            ends = [max(rho_of(row), _LOWEST_SHOWN) for row in (a, b)]
            axes.plot([places[a.index]] * 2, ends, color=theme.faint, linewidth=0.8, zorder=1)


def change_picture(found: PairedArms, one: Comparison) -> Picture:
    """How much rho changes from the arm compared to."""
    return Picture(
        name=f'change_{one.arm}', title=f'Change of ρ from {one.base} to {one.arm}',
        caption='A dot is a scene: how much greater its ρ is in one arm than in the other; the '
                f'line is the median. Beyond {_MOST_CHANGE:g} m dots are drawn at the edge.',
        draw=partial(_draw_change, found, one), size_in=(7.6, 3.2),
    )


def _draw_change(found: PairedArms, one: Comparison, figure: Figure, theme: Theme) -> None:
    axes = figure.subplots()
    x, change = changes(found, one)
    shown = np.clip(change, -_MOST_CHANGE, _MOST_CHANGE)
    axes.axhline(0, color=theme.ink, linewidth=0.8)
    axes.plot(x, shown, 'o', color=theme.passed, markersize=4, alpha=0.7, markeredgewidth=0,
              clip_on=False)
    if len(x):
        axes.plot(*_medians(x, shown), color=theme.failed, linewidth=2.0)
    axes.set(xlabel=title_of(found.over), ylabel='change of ρ [m]')
    plain(axes)


def changes(found: PairedArms, one: Comparison) -> tuple[np.ndarray, np.ndarray]:
    """Where each pair is, and how much its rho changes."""
    known = [
        (float(getattr(a, found.over)), rho_of(b) - rho_of(a)) for a, b in one.pairs
        if getattr(a, found.over) is not None
    ]
    points = np.array(known, dtype=np.float64).reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    return points[:, 0], points[:, 1]


def bins(x: np.ndarray) -> list[tuple[float, float, np.ndarray]]:
    """Equal parts of the range: ends, and who is within."""
    edges = np.linspace(x.min(), x.max(), _BINS + 1)
    part = np.clip(np.searchsorted(edges, x, side='right') - 1, 0, _BINS - 1)
    return [(float(edges[n]), float(edges[n + 1]), part == n) for n in range(_BINS)]


def _medians(x: np.ndarray, y: np.ndarray) -> tuple[list[float], list[float]]:
    """Medians in equal parts of the range, without those that have too few runs."""
    full = [part for part in bins(x) if part[2].sum() >= LEAST_IN_BIN]
    return (
        [(low + high) / 2 for low, high, _ in full],
        [float(np.median(y[inside])) for _, _, inside in full],
    )
