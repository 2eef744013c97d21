"""What a fork shows: before and after as values, lines and picture, and robustness over a change.

The values are the command's JSON, of which ``fork.j2`` makes its lines.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from numpy.typing import NDArray

from taxinet_ros.analysis.report.parts import Picture, Theme
from taxinet_ros.analysis.report.pictures import LIGHT, write_png
from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.core.fork import MOVES, Fork
from taxinet_ros.core.motion.controller import SteeringGains, typed_gain
from taxinet_ros.core.mtl.interval import (
    LOWER,
    UPPER,
    RobustnessInterval,
    lower_column,
    upper_column,
)
from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.scenario_fields import BY_KEY, full_key
from taxinet_ros.core.trace import Column
from taxinet_ros.core.types import NS_PER_S, time_words
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import plain
from taxinet_ros.trials.options import read_settings
from taxinet_ros.trials.past_runs.repeated_run import controller_of, perception_of

_TEXT = Path(__file__).with_suffix('.j2')
_GAIN = 'steering.'
_SHORT_MOVES = {'cte': 'cte_m', 'heading': 'heading_deg', 'distance': 'distance_m',
                'speed': 'speed_mps'}
_MOST_POINTS = 1000
_ROBUSTNESS_SHOWN = 12.0


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
    times_ns = {
        int(seq): int(t_ns) for run in (before, after)
        for seq, t_ns in zip(run.columns['seq'], run.columns['t_ns'], strict=True)
    }
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
                axes.set_title(time_words(times_ns[seq] / NS_PER_S), fontsize=9)
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


def fork_text(kind: str, values: Mapping[str, Any], **files: Path) -> str:
    """What the command prints of a fork.

    Args:
        kind: ``forked``, ``rescue`` or ``swept``.
        values: its JSON.
        files: of a sweep, ``table`` and ``picture``.
    """
    return macro_text(_TEXT, kind, v=values, **files)


def asked_change(
    recording: Recording, texts: Sequence[str], moves: Sequence[str], perception: str | None,
    controller: str | None,
) -> dict[str, Any]:
    """The change as arguments of a fork, from what was typed.

    Args:
        recording: of the run.
        texts: ``KEY=VALUE`` of scenario values and gains.
        moves: ``OFFSET=VALUE``.
        perception: word or file, or None.
        controller: likewise.

    Raises:
        UsageError: one of them is wrong.
    """
    settings: dict[str, Any] = dict(read_settings(texts))
    for name, value in settings.items():
        if name.startswith(_GAIN):
            settings[name] = typed_gain(name.removeprefix(_GAIN), value)
    moved: dict[str, float] = {}
    for one in moves:
        name, _, value = one.partition('=')
        key = _SHORT_MOVES.get(name, name)
        if key not in MOVES or key in moved:
            raise UsageError(
                f'state {one}: expected an offset once, of {", ".join(MOVES)}, as in cte_m=+0.5'
            )
        moved[key] = _number(f'state {name}', value)
    word, _ = perception_of(recording.run, perception)
    return {
        'settings': settings, 'moved': moved, 'perception': perception and word,
        'controller': controller and controller_of(recording.run, controller),
    }


def change_words(recording: Recording, change: Mapping[str, Any], fork: Fork | None) -> str:
    """What changes at a fork, for people.

    Args:
        recording: of the run that is forked.
        change: settings, offsets, perception and controller, by the names of :func:`.fork`.
        fork: the fork, if there is one.
    """
    words = []
    before = recording.run.request.scenario.to_human()
    for name, value in change['settings'].items():
        if name in BY_KEY:
            field = BY_KEY[name]
            now = field.to_human(field.from_human(value))
            words.append(
                f'{field.label} {field.value_words(before.get(name))} -> {field.value_words(now)}'
            )
        else:
            words.append(f'{name}={value:g}')
    words += [f'{name} {value:+g}' for name, value in change['moved'].items()]
    words += [
        f'{role} {change[role]}' for role in ('perception', 'controller') if change[role]
    ]
    if fork is not None and fork.placed and not change['moved']:
        words.append('placed anew, rolling straight, as the model of windy air is another')
    return ', '.join(words) or 'nothing'


def forked_values(
    before: Recording, bag: Path, fork: Fork, change: str, out: Path
) -> dict[str, Any]:
    """Draw both runs; what was done, as values of JSON.

    Args:
        before: recording of the run that was forked.
        bag: the forked run's.
        fork: the fork.
        change: what changed, in words.
        out: folder of the picture.
    """
    runs = before, open_recording(bag)
    facts = [run.facts for run in runs]
    outcomes = [one.outcome if one else '' for one in facts]
    headline = runs[1].run.request.judging.headline
    rho = [one.judged[headline].interval if one and headline in one.judged else None
           for one in facts]
    steps = shown_steps(fork.step, max(len(run.columns['t_ns']) for run in runs) - 1)
    shown = [
        Shown(
            words=f'{when}: {macro_text(_TEXT, "outcome", word=outcome)}', columns=run.columns,
            frames={frame.seq: frame.image for frame in run.frames(steps.__contains__)},
        )
        for when, outcome, run in zip(('before', 'after'), outcomes, runs, strict=True)
    ]
    picture = write_png(
        fork_picture(
            *shown, at_s=fork.at_s, headline=headline,
            half_width_m=runs[1].scenario.line.half_width_m,
            title=f'{fork.run_id}, forked at {fork.at_s:g} s: {change}',
        ), out, LIGHT,
    )
    return plain({
        'run_id': fork.run_id, 'at_s': fork.at_s, 'steps_repeated': fork.step, 'change': change,
        **{
            when: {'outcome': outcome, 'rho': interval and [*interval]}
            for when, outcome, interval in zip(('before', 'after'), outcomes, rho, strict=True)
        },
        'headline': headline, 'bag': bag, 'picture': picture,
    })


def sweep_values(text: str) -> tuple[str, tuple[float, ...]]:
    """Key and values of ``KEY=LOW:HIGH:STEP``, ends included.

    Raises:
        UsageError: it has another form, the key is no number, or there are too many values.
    """
    name, _, span = text.partition('=')
    key = full_key(name)
    if key not in BY_KEY and not key.startswith(_GAIN):
        raise UsageError(f'sweep {text}: unknown key {name!r}')
    parts = span.split(':')
    if len(parts) != 3:
        raise UsageError(f'sweep {text}: expected KEY=LOW:HIGH:STEP, as in rain=0:100:5')
    low, high, step = (_number(f'sweep {name}', part) for part in parts)
    count = math.floor((high - low) / step + 1e-9) + 1 if step > 0 and high >= low else 0
    if not 2 <= count <= _MOST_POINTS:
        raise UsageError(
            f'sweep {text}: expected LOW < HIGH and a positive STEP that gives 2 to '
            f'{_MOST_POINTS} values'
        )
    return key, tuple(round(low + number * step, 9) for number in range(count))


def _number(what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f'{what}={text}: expected a number')
    return value


def value_before(recording: Recording, key: str) -> float | None:
    """The value of a key or gain in a recorded run; None if it is no number."""
    run = recording.run
    if key.startswith(_GAIN):
        return {**asdict(SteeringGains()), **run.gains}.get(key.removeprefix(_GAIN))
    value = run.request.scenario.to_human().get(key)
    return float(value) if isinstance(value, int | float) else None


def write_sweep(
    recording: Recording, at_s: float, points: Sequence[Mapping[str, Any]], headline: str,
    out: Path,
) -> dict[str, Path]:
    """Write the table and the picture of a sweep; return their paths.

    Args:
        recording: of the run that was forked.
        at_s: when it was forked [s].
        points: the value, by its key, outcome and ends of rho of each run.
        headline: name of the requirement.
        out: a new folder.
    """
    key = next(iter(points[0]))
    facts = recording.facts
    rho = math.nan
    if facts is not None and headline in facts.judged:
        rho = facts.judged[headline].interval.lower
    field = BY_KEY.get(key)
    out.mkdir(parents=True)
    table = out / 'sweep.csv'
    write_atomically(table, pd.DataFrame(points).to_csv(index=False))
    return {'table': table, 'picture': write_png(
        sweep_picture(
            [point[key] for point in points],
            [RobustnessInterval(point[LOWER], point[UPPER]) for point in points],
            label=key if field is None else (
                f'{field.title} [{field.unit}]' if field.unit else field.title),
            headline=headline, before=(value_before(recording, key), rho),
            title=f'{recording.run_id}, changed at {at_s:g} s',
        ), out, LIGHT,
    )}
