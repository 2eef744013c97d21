"""Picture of one run and its requirements: signals, bounds, and the interval of rho over time."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from taxinet_ros.analysis.report.parts import Theme, style_axes
from taxinet_ros.bag.check.judge import JudgedBag
from taxinet_ros.bag.run.judging import (
    BagVerdict,
    SpecVerdict,
    judge_spec,
    signals_of_specs,
)
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.samples import run_samples
from taxinet_ros.core.mtl import SIGNALS, Assumptions, Reading, ast, atoms, signal_names
from taxinet_ros.core.mtl.explain import Clause, Explanation
from taxinet_ros.core.mtl.margin import compile_margin
from taxinet_ros.core.types import NS_PER_S, time_words
from taxinet_ros.errors import UsageError

# Okabe-Ito colours, distinguishable with all common colour vision deficiencies.
_SIGNAL, _ALLOWED, _INTERVAL = '#0072B2', '#009E73', '#56B4E9'
_BROKEN, _OPEN = '#D55E00', '0.35'
_COLOURS = {BagVerdict.SATISFIED: _ALLOWED, BagVerdict.VIOLATED: _BROKEN,
            BagVerdict.MARGINAL: _BROKEN}
_HOLDS: dict[str, Any] = {'color': _ALLOWED, 'alpha': 0.13, 'linewidth': 0}
_STILL_POSSIBLE: dict[str, Any] = {'color': _INTERVAL, 'alpha': 0.35, 'linewidth': 0}
_THEME = Theme(
    ink='0.25', faint='0.92', paper='white', passed=_SIGNAL, failed=_BROKEN, others=(),
)
_MOMENT: dict[str, Any] = {'linewidth': 1.6, 'linestyle': (0, (4, 2))}
_PICTURE = '.png'
_MOST_ATOMS = 4
"""Maximum number of predicates drawn per formula; more would be too small to read."""
ROW_IN = 0.95
"""Height of one part of a requirement [inch]."""


@dataclass(frozen=True, kw_only=True)
class JudgedSpec:
    """A requirement to draw: its verdict, and the monitor's reading after each sample."""

    verdict: SpecVerdict
    readings: Sequence[Reading]


def robustness_picture(
    stamps_ns: Sequence[int], samples: Sequence[Mapping[str, float]],
    judged: Sequence[JudgedSpec], path: Path, *, title: str, end_s: float,
) -> None:
    """Draw one row per requirement: its signals with their bounds, and the interval of rho.

    Args:
        stamps_ns: stamps of the samples [ns].
        samples: signals by name.
        judged: the requirements.
        path: PNG file to write; the same values give the same bytes.
        title: title of the picture.
        end_s: planned end of the run [s].
    """
    t_s = np.array(stamps_ns) / NS_PER_S
    heights = [max(1, min(len(atoms(one.verdict.spec.formula)), _MOST_ATOMS)) for one in judged]
    ratios = [
        0.9 + 2.3 * height + _clauses_in(one) for height, one in zip(heights, judged, strict=True)
    ]
    figure = Figure(figsize=(12.5, 0.7 + sum(ratios)), dpi=110, layout='constrained')
    figure.suptitle(title, fontsize=12)
    rows = figure.subfigures(len(judged), 1, height_ratios=ratios, squeeze=False)
    for place, one in zip(rows[:, 0], judged, strict=True):
        _draw(place, one, t_s, samples, end_s)
    figure.legend(handles=_legend(), loc='outside lower center', ncols=5, frameon=False)
    figure.savefig(path, format='png', metadata={'Software': None})


def _draw(
    place: SubFigure, one: JudgedSpec, t_s: NDArray[np.float64],
    samples: Sequence[Mapping[str, float]], end_s: float,
) -> None:
    spec = one.verdict.spec
    shown = atoms(spec.formula)[:_MOST_ATOMS]
    place.suptitle(f'{spec.name}:  {_short(spec.text)}', fontsize=10, x=0.01, ha='left',
                   family='monospace')
    found = one.verdict.explanation
    if found is not None:
        part_in = 0.9 + 2.3 * len(shown)
        ratios = [part_in, _clauses_in(one)]
        place, below = place.subfigures(2, 1, height_ratios=ratios, squeeze=False)[:, 0]
        draw_clauses(below, found, _THEME, end_s)
    left, right = place.subfigures(1, 2, squeeze=False)[0]
    panels = left.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    panels[0].set_title(' ', fontsize=10)  # same height as its neighbour, which has a title
    for axes, atom in zip(panels, shown, strict=True):
        _draw_atom(axes, atom, t_s, samples)
        axes.set_xlim(0, max(end_s, float(t_s[-1])))
    panels[-1].set_xlabel('time [s]')
    axes = right.subplots()
    _draw_interval(axes, one, t_s)
    axes.set_xlim(0, max(end_s, float(t_s[-1])))
    for each in (*panels, axes):
        each.grid(visible=True, color='0.92', linewidth=0.6)
        each.set_axisbelow(True)
        if t_s[-1] < end_s:
            each.axvspan(float(t_s[-1]), end_s, facecolor='0.93', hatch='//', edgecolor='0.85',
                         linewidth=0, zorder=0)


def _clauses_in(one: JudgedSpec) -> float:
    """Height of the picture of a requirement's parts [inch]."""
    found = one.verdict.explanation
    return 0.0 if found is None else ROW_IN * len(found.clauses) + 0.3


def _draw_atom(
    axes: Axes, atom: ast.Compare, t_s: NDArray[np.float64],
    samples: Sequence[Mapping[str, float]],
) -> None:
    """Draw the varying side of a predicate, and the values that the other side allows."""
    value, low, high = _sides(atom, samples)
    name, unit = _label(value)
    curve = _curve(value, samples)
    fits = np.array([_margin(atom, sample) >= 0 for sample in samples])
    span = [curve, *(bound for bound in (low, high) if bound is not None)]
    known = [float(value) for each in span for value in np.ravel(each) if np.isfinite(value)]
    least, most = min(known, default=0.0), max(known, default=0.0)
    pad = 0.12 * (most - least) or 1.0
    floor, ceiling = least - pad, most + pad
    axes.fill_between(
        t_s, floor if low is None else low, ceiling if high is None else high,
        **_HOLDS,
    )
    for bound in (low, high):
        if bound is not None:
            axes.plot(t_s, bound, color=_ALLOWED, linewidth=1.2, linestyle='--')
    axes.plot(t_s, curve, color=_SIGNAL, linewidth=1.5)
    axes.plot(t_s, np.where(fits, np.nan, curve), color=_BROKEN, linewidth=1.9)
    axes.set_ylim(floor, ceiling)
    axes.set_ylabel(f'{name}{unit}', fontsize=9)


def _draw_interval(axes: Axes, one: JudgedSpec, t_s: NDArray[np.float64]) -> None:
    lower = np.array([reading.lower for reading in one.readings])
    upper = np.array([reading.upper for reading in one.readings])
    finite = np.concatenate([[0.0], lower[np.isfinite(lower)], upper[np.isfinite(upper)]])
    pad = 0.22 * float(np.ptp(finite)) or 1.0
    floor, ceiling = float(finite.min()) - pad, float(finite.max()) + pad
    axes.fill_between(
        t_s, np.clip(lower, floor, None), np.clip(upper, None, ceiling), step='post',
        **_STILL_POSSIBLE,
    )
    for ends in (lower, upper):
        axes.step(t_s, np.where(np.isfinite(ends), ends, np.nan), where='post', color=_SIGNAL,
                  linewidth=1.3)
    if not np.isfinite(lower[0]):
        axes.text(0.985, 0.03, 'no lower end before the run ends', transform=axes.transAxes,
                  fontsize=8, color=_OPEN, ha='right', zorder=4)
    axes.axhline(0, color='0.25', linewidth=1)
    axes.set_ylim(floor, ceiling)
    axes.set_ylabel('robustness', fontsize=9)
    axes.set_xlabel('time [s]')
    _mark(axes, one.verdict, float(t_s[-1]))


def _mark(axes: Axes, verdict: SpecVerdict, last_s: float) -> None:
    """Mark the time and the result of the decision."""
    colour = _COLOURS.get(verdict.verdict, _OPEN)
    if verdict.decided_s is not None:
        axes.axvline(verdict.decided_s, color=colour, clip_on=False, **_MOMENT)
    if verdict.interval.exact:
        axes.plot([last_s], [verdict.interval.upper], marker='o', color=colour, markersize=6,
                  clip_on=False, zorder=5)
    axes.set_title(_words(verdict), fontsize=10, color=colour, loc='right', weight='bold')


def _words(verdict: SpecVerdict) -> str:
    when = '' if verdict.decided_s is None else f', decided at {time_words(verdict.decided_s)}'
    return f'{verdict.verdict}, {verdict.interval.words()}{when}'


def _legend() -> list[Artist]:
    return [
        Patch(label='the predicate holds', **_HOLDS),
        Line2D([], [], color=_SIGNAL, label='signal, where it does'),
        Line2D([], [], color=_BROKEN, label='signal, where it does not'),
        Patch(label='robustness that is still possible', **_STILL_POSSIBLE),
        Line2D([], [], color=_OPEN, label='moment of decision', **_MOMENT),
    ]


def _sides(
    atom: ast.Compare, samples: Sequence[Mapping[str, float]]
) -> tuple[ast.Expr, NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """The varying side of a predicate, and the bounds within which it is satisfied."""
    small, large = (atom.left, atom.right) if atom.op in ('<=', '<') else (atom.right, atom.left)
    if not _names(small):
        return large, _curve(small, samples), None
    bound = _curve(large, samples)
    match small:
        case ast.Function('abs', (inner,)):
            return inner, -bound, bound
    return small, None, bound


def _names(expr: ast.Expr) -> tuple[str, ...]:
    return signal_names(_as_atom(expr))


def _as_atom(expr: ast.Expr) -> ast.Compare:
    """A predicate whose margin is the expression itself."""
    return ast.Compare('<=', ast.Number(0.0), expr)


def _curve(expr: ast.Expr, samples: Sequence[Mapping[str, float]]) -> NDArray[np.float64]:
    return np.array([_margin(_as_atom(expr), sample) for sample in samples])


def _margin(atom: ast.Compare, sample: Mapping[str, float]) -> float:
    names = signal_names(atom)
    margin = compile_margin(atom, names)([sample[name] for name in names])
    return margin if math.isfinite(margin) else math.nan


def _label(expr: ast.Expr) -> tuple[str, str]:
    match expr:
        case ast.Signal(name):
            return name, f' [{SIGNALS[name]}]'
    return _short(str(expr), 34), ''


def _short(text: str, most: int = 110) -> str:
    return text if len(text) <= most else f'{text[:most - 1]}…'


def check_plot(plot: Path, bags: Sequence[Path]) -> None:
    """Check that the pictures of bags can be written, and make their folder.

    Raises:
        UsageError: they cannot.
    """
    if plot.suffix == _PICTURE and len(bags) > 1:
        raise UsageError(f'plot {plot}: {len(bags)} bags given; name a folder')
    if plot.suffix not in ('', _PICTURE):
        raise UsageError(f'plot {plot}: write NAME.png, or name a folder')
    folder = plot.parent if plot.suffix else plot
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f'plot {plot}: cannot be written: {error.strerror}') from error


def check_one_run(plot: Path, judged: Sequence[JudgedBag]) -> None:
    """Check that a picture is not of several runs.

    Raises:
        UsageError: it is.
    """
    if plot.suffix == _PICTURE and len(judged) > 1:
        names = ', '.join(bag.run or bag.name for bag in judged)
        raise UsageError(f'plot {plot}: the bag holds {names}; name a folder, or a run')


def draw_bag(bag: JudgedBag, vouched: Assumptions | None, plot: Path) -> Path:
    """Draw the requirements of a run.

    Args:
        bag: the run.
        vouched: the assumptions; None for the recorded ones.
        plot: PNG file to write, or the folder for one.

    Raises:
        UsageError: it cannot be written.
    """
    specs = [one.spec for one in bag.verdicts]
    explained = any(one.explanation for one in bag.verdicts)
    runs = run_samples(open_recording(bag.path), signals_of_specs(specs))
    samples = next(one for one in runs if one.run == bag.run)
    judged = []
    for spec in specs:
        verdict, readings = judge_spec(samples, spec, vouched, explained=explained)
        # If a topic it reads is missing, nothing more is known.
        at = dict(zip(samples.seen_by(spec).stamps_ns, readings, strict=False))
        known = accumulate(
            (at.get(stamp) for stamp in samples.stamps_ns), lambda old, new: new or old,
            initial=readings[0],
        )
        judged.append(JudgedSpec(verdict=verdict, readings=[*known][1:]))
    path = plot if plot.suffix else plot / f'{_file_name(bag)}{_PICTURE}'
    try:
        robustness_picture(
            samples.stamps_ns, samples.samples, judged, path, title=_title(bag),
            end_s=bag.duration_s,
        )
    except OSError as error:
        raise UsageError(f'plot {path}: cannot be written: {error.strerror}') from error
    return path


def _file_name(bag: JudgedBag) -> str:
    return re.sub(r'[^A-Za-z0-9_.-]+', '_', bag.name)


def _title(bag: JudgedBag) -> str:
    if bag.end_s >= bag.duration_s:
        return bag.name
    why = 'stopped early' if bag.stopped_early else 'incomplete'
    return f'{bag.name}   ({why}: {bag.end_s:g} of {bag.duration_s:g} s)'


def draw_clauses(figure: FigureBase, found: Explanation, theme: Theme, end_s: float) -> None:
    """Draw each part over the samples that the requirement reads; the run ends at ``end_s``."""
    t_s = np.array(found.stamps_ns) / NS_PER_S
    rows = figure.subplots(len(found.clauses), 1, sharex=True, squeeze=False)[:, 0]
    for axes, one in zip(rows, found.clauses, strict=True):
        _draw_clause(axes, one, t_s, theme, one is found.witness)
        style_axes(axes)
        axes.tick_params(labelsize=7)
    rows[-1].set_xlim(0, max(end_s, float(t_s[-1])))
    rows[-1].set_xlabel('time [s]', fontsize=8)


def _draw_clause(axes: Axes, one: Clause, t_s: np.ndarray, theme: Theme, witness: bool) -> None:
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
