"""Robustness over the features of the scenes, as the paper's Figures 4 to 7 show it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from taxinet_ros.analysis.campaign_runs import CampaignRuns
from taxinet_ros.analysis.figure_parts import (
    all_rho,
    dot_style,
    feature_axis,
    network_colours,
    plain,
    rho_axis,
)
from taxinet_ros.analysis.group_rates import Floats
from taxinet_ros.analysis.rate_bins import medians
from taxinet_ros.analysis.report_parts import Picture, Theme
from taxinet_ros.analysis.run_features import (
    CLOUDS_KIND,
    CROSS_TRACK,
    DISTANCE,
    HEADING,
    RAIN,
    TIME_OF_DAY,
    Feature,
    kinds_present,
)

_WIDTHS = {TIME_OF_DAY: 0.5, DISTANCE: 50.0, HEADING: 5.0, CROSS_TRACK: 1.0}
_BIN_WORDS = {TIME_OF_DAY: '30 minutes', DISTANCE: '50 m', HEADING: '5°', CROSS_TRACK: '1 m'}
_MARKS = ('o', 's', '^', 'v', 'D', 'P')


def rho_picture(campaigns: Sequence[CampaignRuns], feature: Feature, name: str) -> Picture:
    """Runs as dots over a feature, with medians; before and after where there are several networks.

    Args:
        campaigns: the one that is analysed, and those it is compared with.
        feature: numeric.
        name: of the file.
    """
    caption = f'A dot for each run; lines are medians of {_BIN_WORDS[feature]}. '
    caption += 'Runs in the shaded half violate the formula.'
    raining = any(_rain(runs).any() and not _rain(runs).all() for runs in campaigns)
    if len(campaigns) == 1 and raining:
        caption += ' The dashed line is the median of the runs without rain.'
    if any(runs.stopped for runs in campaigns):
        caption += ' Of a run that was stopped early, ρ is the bound known then.'

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        if len(campaigns) == 1:
            _one(axes, campaigns[0], feature, theme)
        else:
            _several(axes, campaigns, feature, theme)
        rho_axis(axes, all_rho(campaigns), theme)
        values = np.concatenate([runs.frame[feature.name].to_numpy() for runs in campaigns])
        feature_axis(axes, feature, values)
        plain(axes)

    return Picture(
        name=name, title=f'Robustness over {feature.title}', caption=caption, draw=draw,
    )


def clouds_picture(campaigns: Sequence[CampaignRuns]) -> Picture:
    """Medians over the time of day, for each kind of clouds; a panel for each network."""
    dry = any(not _rain(runs).all() for runs in campaigns)

    def draw(figure: Figure, theme: Theme) -> None:
        panels = figure.subplots(len(campaigns), 1, sharex=True, squeeze=False)[:, 0]
        for axes, runs in zip(panels, campaigns, strict=True):
            _clouds(axes, runs, theme, dry=dry)
            rho_axis(axes, all_rho(campaigns), theme)
            plain(axes)
            if len(campaigns) > 1:
                axes.set_title(runs.label, fontsize=10, loc='left')
        hours = np.concatenate([runs.frame[TIME_OF_DAY.name].to_numpy() for runs in campaigns])
        feature_axis(panels[-1], TIME_OF_DAY, hours)
        handles = {label: line for axes in panels
                   for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        kinds = [kind for kind in CLOUDS_KIND.kinds if kind in handles]
        figure.legend([handles[kind] for kind in kinds], kinds, loc='outside upper center',
                      ncols=6, frameon=False, fontsize=9, columnspacing=1.2, handlelength=1.6)

    among = 'without rain ' if dry else ''
    return Picture(
        name='rho_by_hour_and_clouds', title='Median robustness by kind of clouds',
        caption=f'Medians of the runs {among}in 30 minutes each. A line that falls where the '
        'others do not shows an hour that is hard under that sky only.',
        draw=draw, size_in=(7.0, 0.8 + 2.9 * len(campaigns)),
    )


def _one(axes: Axes, runs: CampaignRuns, feature: Feature, theme: Theme) -> None:
    x, rho = _values(runs, feature)
    failed, rain = runs.failed, _rain(runs)
    style = dot_style(len(x))
    for among, colour in ((~failed, theme.passed), (failed, theme.failed)):
        axes.scatter(x[among], rho[among], color=colour, **style)
    handles = [
        Line2D([], [], marker='o', linestyle='', markersize=5, color=theme.passed,
               label=f'satisfied ({int((~failed).sum()):,})'),
        Line2D([], [], marker='o', linestyle='', markersize=5, color=theme.failed,
               label=f'violated ({int(failed.sum()):,})'),
    ]
    handles += _median_line(axes, x, rho, feature, theme.ink, 'median', theme)
    if rain.any() and not rain.all():
        handles += _median_line(axes, x[~rain], rho[~rain], feature, theme.ink,
                                'median without rain', theme, dashed=True)
    _legend(axes, handles)


def _several(
    axes: Axes, campaigns: Sequence[CampaignRuns], feature: Feature, theme: Theme
) -> None:
    handles: list[Line2D] = []
    colours = network_colours(len(campaigns), theme)
    for runs, colour in reversed(list(zip(campaigns, colours, strict=True))):
        x, rho = _values(runs, feature)
        style = dot_style(len(x))
        axes.scatter(x, rho, color=colour, **{**style, 'alpha': 0.6 * style['alpha']})
        label = f'{runs.label} ({len(x):,} runs)'
        line = _median_line(axes, x, rho, feature, colour, label, theme)
        handles += line or [Line2D([], [], marker='o', linestyle='', color=colour, label=label)]
    _legend(axes, handles[::-1])


def _median_line(
    axes: Axes, x: Floats, rho: Floats, feature: Feature, colour: str, label: str, theme: Theme,
    *, dashed: bool = False,
) -> list[Line2D]:
    middles, values, _ = medians(x, rho, _WIDTHS[feature])
    if np.isfinite(values).sum() < 1 or len(x) < 4:
        return []
    style = (0, (3, 1.4)) if dashed else 'solid'
    # A rim in the paper's colour keeps the line apart from the dots below it.
    axes.plot(middles, values, color=theme.paper, linewidth=4.2, alpha=0.8, zorder=3,
              solid_capstyle='round')
    return axes.plot(middles, values, color=colour, linewidth=2.0, linestyle=style, label=label,
                     marker='o' if len(values) < 2 else '', markersize=4, zorder=4)


def _clouds(axes: Axes, runs: CampaignRuns, theme: Theme, *, dry: bool) -> None:
    colours = (theme.passed, *theme.others, theme.failed)
    frame = runs.frame[~_rain(runs)] if dry else runs.frame
    for kind in kinds_present(CLOUDS_KIND, frame):
        number = CLOUDS_KIND.kinds.index(kind) if kind in CLOUDS_KIND.kinds else 0
        some = frame[frame[CLOUDS_KIND.name] == kind]
        middles, values, _ = medians(
            some[TIME_OF_DAY.name].to_numpy(), some['rho'].to_numpy(), _WIDTHS[TIME_OF_DAY])
        axes.plot(middles, values, color=colours[number], marker=_MARKS[number], markersize=4,
                  linewidth=1.6, label=kind, zorder=3)


def _values(runs: CampaignRuns, feature: Feature) -> tuple[Floats, Floats]:
    return (runs.frame[feature.name].to_numpy(dtype=np.float64),
            runs.frame['rho'].to_numpy(dtype=np.float64))


def _rain(runs: CampaignRuns) -> np.ndarray:
    return runs.frame[RAIN.name].to_numpy() > 0


def _legend(axes: Axes, handles: list[Line2D]) -> None:
    axes.legend(handles=handles, loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=4,
                frameon=False, fontsize=9, columnspacing=1.4, handlelength=1.8)
