"""Figures on a network failure: errors, counterfactual frames.

In frames a solid line is the true centreline, a dashed one the centreline by the estimate.
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from taxinet_ros.analysis.explain.explain import (
    Explanation,
    error_words,
    misled_words,
    moment_words,
)
from taxinet_ros.analysis.explain.track import Floats, Frame, Moment
from taxinet_ros.analysis.one_run.robustness import ROW_IN, draw_clauses
from taxinet_ros.analysis.report.parts import Picture, Theme, style_axes
from taxinet_ros.core.camera.camera import IMAGE_HEIGHT, IMAGE_WIDTH, project
from taxinet_ros.core.mtl.explain import Explanation as Clauses
from taxinet_ros.core.types import TrackingError, time_words

_TRUE, _BELIEVED = '#35d0ff', '#ff9d00'
"""Colours on frames, which look the same on dark and light pages."""

_SHOWN_AFTER_S = 2.0
_COLUMNS = 3


def error_picture(found: Explanation) -> Picture:
    """Both errors and their effect, over time."""
    return Picture(
        name='explain-errors', title='Estimates along the run',
        caption='Cross-track and heading error, true and estimated, left positive; and by how much '
        'the estimate misleads the steering law. Vertical lines: the examined moments.',
        draw=partial(_draw_errors, found), size_in=(8.0, 6.0),
    )


def clause_picture(clauses: Clauses) -> Picture:
    """Robustness of each part of the requirement over time."""
    return Picture(
        name='explain-clauses', title='The parts of the requirement',
        caption='Robustness of each part at the samples at which the requirement depends on it. '
        'Circles: the samples by which it is decided; filled: the predicate that decides.',
        draw=lambda figure, theme: draw_clauses(figure, clauses, theme, 0.0),
        size_in=(9.0, 0.3 + ROW_IN * len(clauses.clauses)),
    )


def factor_picture(found: Explanation) -> Picture:
    """Share of the error that each factor removes."""
    return Picture(
        name='explain-factors', title='Which change removes the error',
        caption='Share of the error over all examined moments removed by one change of the scene. '
        'Bars to the left: the error grows.',
        draw=partial(_draw_factors, found), size_in=(7.0, 0.9 + 0.34 * len(found.effects)),
    )


def scene_picture(found: Explanation, number: int) -> Picture:
    """The frame of one moment, as recorded and in changed scenes, if any."""
    moment = found.moments[number]
    rows = math.ceil((1 + len(found.effects)) / _COLUMNS)
    return Picture(
        name=f'explain-scenes-{moment.seq:04d}',
        title=f'{"In other scenes" if found.effects else "As recorded"}, at '
        f'{time_words(moment.t_s)}',
        caption=f'{moment_words(moment)}. Blue: true centreline; orange, dashed: centreline '
        "according to the network's estimate.",
        draw=partial(_draw_scenes, found, number), size_in=(9.0, 0.1 + 2.15 * rows),
    )


def _draw_errors(found: Explanation, figure: Figure, theme: Theme) -> None:
    track = found.track
    end = int(np.searchsorted(
        track.t_s, track.t_s[max(track.steps_on_runway - 1, 0)] + _SHOWN_AFTER_S, side='right'))
    shown = slice(0, max(end, 2))
    time = track.t_s[shown]
    pairs: list[tuple[str, Floats, Floats | None, Floats | None]] = [
        ('CTE [m]', track.cte_m, track.est_cte_m, track.rec_cte_m),
        ('HE [°]', np.degrees(track.he_rad), np.degrees(track.est_he_rad),
         np.degrees(track.rec_he_rad)),
        ('misled [°]', np.degrees(track.misled_rad), None, None),
    ]
    for axes, (label, first, seen, recorded) in zip(
        figure.subplots(3, 1, sharex=True), pairs, strict=True
    ):
        alone = seen is None
        axes.axhline(0, color=theme.ink, linewidth=0.6)
        axes.plot(time, first[shown], color=theme.failed if alone else theme.ink,
                  linewidth=1.4, label='' if alone else 'true')
        if seen is not None:
            axes.plot(time, seen[shown], color=theme.failed, linewidth=1.4, label='estimated')
        if recorded is not None and not found.own:
            axes.plot(time, recorded[shown], color=theme.passed, linewidth=1.0, linestyle=':',
                      label=f'estimated in the run ({found.run.perception or "not told"})')
        for moment in found.moments:
            axes.axvline(moment.t_s, color=theme.others[1], linewidth=0.9, linestyle='--')
        _shade_after(axes, track.steps_on_runway, track.t_s, shown, theme, words=alone)
        axes.set_ylabel(label)
        style_axes(axes)
        if not alone and label.startswith('CTE'):
            axes.legend(loc='best', fontsize=8)
    axes.set_xlabel('time [s]')
    axes.set_xlim(float(time[0]), float(time[-1]))


def _shade_after(
    axes: Axes, steps: int, t_s: Floats, shown: slice, theme: Theme, *, words: bool
) -> None:
    """Shade the time after the aircraft has left the runway, or turned away on it."""
    if steps < len(t_s):
        axes.axvspan(float(t_s[steps]), float(t_s[shown][-1]), color=theme.faint, alpha=0.6,
                     linewidth=0, zorder=0)
        if words:
            axes.text(float(t_s[steps]), 0.03, ' off the runway,\n or turned away', fontsize=7,
                      va='bottom', transform=axes.get_xaxis_transform())


def _draw_factors(found: Explanation, figure: Figure, theme: Theme) -> None:
    axes = figure.subplots()
    shares = [100 * effect.removed for effect in found.effects]
    places = np.arange(len(shares))[::-1]
    shown = np.clip(shares, -100, 100)
    colours = [
        theme.passed if effect is found.blamed else theme.faint for effect in found.effects
    ]
    axes.barh(places, shown, color=colours, height=0.7)
    for place, share, length in zip(places, shares, shown, strict=True):
        words = f'{round(share)} %'.replace('-', '−')  # round() knows no −0
        axes.text(max(float(length), 0.0) + 1.5, place, words, va='center', fontsize=9)
    axes.set_yticks(places, [effect.factor.words for effect in found.effects])
    axes.axvline(0, color=theme.ink, linewidth=0.9)
    axes.set_xlim(min(0.0, float(shown.min()) * 1.1), 112)
    axes.set_xlabel('error removed [%]')
    style_axes(axes, grid='x')


def _draw_scenes(found: Explanation, number: int, figure: Figure, theme: Theme) -> None:
    moment = found.moments[number]
    tiles: list[tuple[str, Frame, TrackingError, float]] = [
        ('as recorded', moment.image, moment.estimate, moment.misled_rad)]
    for effect in found.effects:
        outcome = effect.outcomes[number]
        words = effect.factor.words if outcome.changed else f'{effect.factor.words} (no change)'
        tiles.append((words, outcome.image, outcome.estimate, outcome.misled_rad))
    rows = math.ceil(len(tiles) / _COLUMNS)
    # Positions are known, so there is no layout step, which takes longer than drawing.
    figure.set_layout_engine('none')
    height = figure.get_figheight()
    grid = figure.add_gridspec(
        rows, _COLUMNS, left=0.005, right=0.995, wspace=0.03, top=1 - 0.23 / height,
        bottom=0.36 / height, hspace=0.37,
    )
    for place, (words, image, estimate, misled) in enumerate(tiles):
        axes = figure.add_subplot(grid[place // _COLUMNS, place % _COLUMNS])
        _show(axes, image)
        _lines(axes, moment, estimate)
        axes.set_title(words, fontsize=9, fontweight='bold', loc='left', pad=3)
        axes.set_xlabel(f'sees {error_words(estimate)}\n{misled_words(misled)}', fontsize=8,
                        labelpad=3)
        if place and found.blamed is found.effects[place - 1]:
            for spine in axes.spines.values():
                spine.set(visible=True, color=theme.passed, linewidth=2.5)


_EXTENT = (-0.5, IMAGE_WIDTH - 0.5, IMAGE_HEIGHT - 0.5, -0.5)


def _show(axes: Axes, image: Frame) -> None:
    axes.imshow(image, extent=_EXTENT)
    _frame_axes(axes)


def _frame_axes(axes: Axes) -> None:
    """Set the limits of the frame, without ticks, since pixels mean nothing to the reader."""
    axes.set(xlim=(-0.5, IMAGE_WIDTH - 0.5), ylim=(IMAGE_HEIGHT - 0.5, -0.5), xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_visible(False)


def _lines(axes: Axes, moment: Moment, estimate: TrackingError) -> None:
    """Draw the true centreline and the one by an estimate."""
    for error, colour, style in ((moment.truth, _TRUE, '-'), (estimate, _BELIEVED, '--')):
        if moment.state is not None and error.usable:
            pixels = _centreline(moment, error)
            axes.plot(pixels[:, 0], pixels[:, 1], color=colour, linestyle=style, linewidth=1.3)


def _centreline(moment: Moment, error: TrackingError) -> Floats:
    """Pixels of the centreline as seen from a pose with that tracking error."""
    if moment.state is None:
        raise ValueError('no state')
    x_m, y_m, yaw_rad = moment.line.pose(moment.x_m, error.cte_m, error.he_rad)
    state = dataclasses.replace(moment.state, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)
    ahead = np.geomspace(0.5, 600, 400)
    along = moment.x_m + np.concatenate([-ahead[:200][::-1], ahead])
    points = np.array([(*moment.line.pose(at)[:2], 0.0) for at in along.tolist()])
    camera = moment.camera
    pixels, depths = project(state, points, camera)
    # Frames of every size are shown in that of the usual ones.
    scale = np.array([IMAGE_WIDTH / camera.width_px, IMAGE_HEIGHT / camera.height_px])
    return np.asarray((pixels[depths > 0.3] + 0.5) * scale - 0.5, np.float64)
