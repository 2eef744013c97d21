"""Report on a confirmation experiment: pictures, sentences, tables, JSON."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from taxinet_ros.analysis.experiment.arms import ArmComparison, PairedArms, pairs_frame, rho_of
from taxinet_ros.analysis.experiment.pairs import PairedRates, PairedShift
from taxinet_ros.analysis.report.page import write_report
from taxinet_ros.analysis.report.parts import (
    Cell,
    Column,
    Picture,
    Report,
    Table,
    Theme,
    style_axes,
)
from taxinet_ros.analysis.report.text import fill_report
from taxinet_ros.analysis.runs.campaign import ConfidenceInterval
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.mtl import SIGNALS, parse_spec
from taxinet_ros.core.mtl.lint import rho_unit
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.scenario_fields import BY_KEY, TIME_OF_DAY, clock_words
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.atomic import write_parquet
from taxinet_ros.files.plain_values import plain
from taxinet_ros.files.sealed_json import write_sealed
from taxinet_ros.trials.experiment import JSON_NAME, PAGE_NAME, PAIRS_NAME, Experiment
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.summary import Summary

TEXT = Path(__file__).with_name('page.j2')
_HOURS = TIME_OF_DAY.key
_LOWEST_SHOWN = -6.0
"""Lower limit of rho in the picture; runs below it are shown at the lower edge."""
_MOST_CHANGE = 8.0
_FEW_PAIRS = 60
"""Up to so many pairs, dots are large."""
_BINS, LEAST_IN_BIN = 12, 3
"""Number of bins of the horizontal axis, and minimum number of runs for a bin's median."""


def title_of(key: str) -> str:
    """Display name of a scenario key, with its unit."""
    field = BY_KEY[key]
    return f'{field.title} [{field.unit}]' if field.unit and key != _HOURS else field.title


def range_words(key: str, low: float, high: float) -> str:
    """Display text of the range of a key."""
    field = BY_KEY[key]
    if key == _HOURS:
        return f'{field.title} {clock_words(low)} to {clock_words(high)}'
    digits = 0 if abs(high) >= 100 else 1
    return (
        f'{field.title} {_minus(f"{low:.{digits}f} to {high:.{digits}f}")}{field.unit_mark}'
    )


def _place_axis(axes: Axes, key: str) -> None:
    """Name the horizontal axis; times of day are clock times, as in the tables."""
    axes.set_xlabel(title_of(key))
    if key == _HOURS:
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: clock_words(value)))


def _minus(text: str) -> str:
    return text.replace('-', '−')


def arms_picture(found: PairedArms) -> Picture:
    """The runs of every arm, one colour per arm."""
    names = ' and '.join(found.rows)
    lines = (
        'neighbours are joined' if found.alone
        else 'lines are medians, and pairs with another verdict are joined'
    )
    return Picture(
        name='experiment', title=f'ρ with {names}',
        caption=f'A dot is a run; {lines}. Above 0 the formula is satisfied; what is below '
                f'{_minus(f"{_LOWEST_SHOWN:g}")} is a triangle at the edge.',
        draw=partial(_draw, found), size_in=(7.6, 4.0),
    )


def _draw(found: PairedArms, figure: Figure, theme: Theme) -> None:
    axes = figure.subplots()
    experiment = found.experiment
    places = {row.index: row.scene[found.over] for row in found.rows[experiment.compare_to]}
    if not found.alone:
        for one in found.comparisons:
            _join_flips(axes, one, places, theme)
    others = iter(theme.others * len(experiment.arms))
    for arm in experiment.arms:
        # The base arm in the colour of failure; two arms need no further colours.
        base = arm.name == experiment.compare_to
        colour = theme.failed if base else theme.passed if len(experiment.arms) == 2 \
            else next(others)
        _draw_arm(axes, found, arm.name, places, colour, above=not base)
    axes.axhline(0, color=theme.ink, linewidth=0.8)
    axes.set(
        ylabel=f'ρ of {experiment.specs[0].partition("=")[0]}{_axis_unit(experiment)}',
        ylim=(_lowest(found), None),
    )
    _place_axis(axes, found.over)
    # Vertical lines join pairs there and would be lost among vertical grid lines.
    style_axes(axes, grid='both' if found.alone else 'y')
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
    few = len(x) <= _FEW_PAIRS
    axes.plot(x[inside], rho[inside], 'o', color=colour,
              markersize=6 if few else 4 if found.alone else 3,
              alpha=1.0 if found.alone else 0.8 if few else 0.6, zorder=order, label=name,
              markeredgewidth=0)
    axes.plot(x[~inside], shown[~inside], 'v', color=colour, markersize=7 if few else 5,
              zorder=order, clip_on=False, markeredgewidth=0)
    if found.alone:
        axes.plot(x, shown, color=colour, linewidth=1.0, alpha=0.7, zorder=order - 2)
    elif len(x):
        axes.plot(*_medians(x, shown), color=colour, linewidth=2.0, zorder=order + 2)


def _join_flips(
    axes: Axes, one: ArmComparison, places: dict[int, float], theme: Theme
) -> None:
    for a, b in one.pairs:
        if a.outcome is not b.outcome and places.get(a.index) is not None:
            ends = [max(rho_of(row), _LOWEST_SHOWN) for row in (a, b)]
            axes.plot([places[a.index]] * 2, ends, color=theme.faint, linewidth=0.8, zorder=1)


def change_picture(found: PairedArms, one: ArmComparison) -> Picture:
    """Change of rho from the base arm."""
    return Picture(
        name=f'change_{one.arm}', title=f'Change of ρ from {one.base} to {one.arm}',
        caption='A dot is a scene: the difference of its ρ between the arms; the line is the '
        f'median. Beyond {_MOST_CHANGE:g}{_unit(found.experiment)} dots are drawn at the edge.',
        draw=partial(_draw_change, found, one), size_in=(7.6, 3.2),
    )


def _draw_change(found: PairedArms, one: ArmComparison, figure: Figure, theme: Theme) -> None:
    axes = figure.subplots()
    x, change = changes(found, one)
    shown = np.clip(change, -_MOST_CHANGE, _MOST_CHANGE)
    axes.axhline(0, color=theme.ink, linewidth=0.8)
    axes.plot(x, shown, 'o', color=theme.passed, markersize=6 if len(x) <= _FEW_PAIRS else 4,
              alpha=0.7, markeredgewidth=0, clip_on=False)
    if len(x):
        axes.plot(*_medians(x, shown), color=theme.failed, linewidth=2.0)
    axes.set_ylabel(f'change of ρ{_axis_unit(found.experiment)}')
    _place_axis(axes, found.over)
    style_axes(axes)


def changes(found: PairedArms, one: ArmComparison) -> tuple[np.ndarray, np.ndarray]:
    """Position of each pair, and the change of its rho."""
    known = [
        (float(a.scene[found.over]), rho_of(b) - rho_of(a)) for a, b in one.pairs
        if a.scene[found.over] is not None
    ]
    points = np.array(known, dtype=np.float64).reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    return points[:, 0], points[:, 1]


def bins(x: np.ndarray) -> list[tuple[float, float, np.ndarray]]:
    """Equal bins of the range: ends, and mask of the values within."""
    edges = np.linspace(x.min(), x.max(), _BINS + 1)
    part = np.clip(np.searchsorted(edges, x, side='right') - 1, 0, _BINS - 1)
    return [(float(edges[n]), float(edges[n + 1]), part == n) for n in range(_BINS)]


def _medians(x: np.ndarray, y: np.ndarray) -> tuple[list[float], list[float]]:
    """Medians in equal bins of the range, without bins that have too few runs."""
    full = [part for part in bins(x) if part[2].sum() >= LEAST_IN_BIN]
    return (
        [(low + high) / 2 for low, high, _ in full],
        [float(np.median(y[inside])) for _, _, inside in full],
    )


_MOST_FLIPS = 30


def experiment_report(found: PairedArms) -> Report:
    """Report on an experiment."""
    experiment = found.experiment
    name = experiment.specs[0].partition('=')[0]
    unjudged = {
        arm: [row for row in rows if not row.outcome.judged] for arm, rows in found.rows.items()
    }
    values = {
        'f': found, 'e': experiment, 'unit': _unit(experiment), 'steering': STEERING,
        'what': name if len(experiment.specs) == 1 else f'all {len(experiment.specs)} formulas',
        'greatest': {one.arm: _greatest_change(found, one) for one in found.comparisons},
        'unjudged': {arm: Summary(rows).count_words() for arm, rows in unjudged.items() if rows},
    }
    pairs: dict[str, Sequence[Picture | Table]] = {
        f'pairs-{one.arm}': (change_picture(found, one), *_flips_tables(found, one))
        for one in found.comparisons
    }
    return fill_report(TEXT, values, {
        'arms': (arms_picture(found), _arms_table(found)), **pairs,
    })


def experiment_json(found: PairedArms) -> dict[str, Any]:
    """The findings as plain values, without NaN."""
    experiment, report = found.experiment, experiment_report(found)
    return plain({
        'experiment': experiment.name, 'facts': dict(report.facts),
        'compare_to': experiment.compare_to, 'over': found.over,
        'made_on': dict(provenance()),
        'arms': {
            name: {
                outcome.value: sum(row.outcome is outcome for row in rows) for outcome in Outcome
            }
            for name, rows in found.rows.items()
        },
        'comparisons': [_comparison_json(one) for one in found.comparisons],
        'sentences': list(report.sentences),
    })


def write_experiment(found: PairedArms, out: Path) -> tuple[dict[str, Any], list[str]]:
    """Write page, pictures, pairs and JSON into the experiment's folder.

    Returns:
        The values of the JSON, and the lines of the terminal.
    """
    values, report = experiment_json(found), experiment_report(found)
    pairs = out / PAIRS_NAME
    write_parquet(pairs, pairs_frame(found))
    write_sealed(out / JSON_NAME, values, [pairs])
    pictures = write_report(report, out / PAGE_NAME)
    names = [*(path.name for path in pictures), PAIRS_NAME, JSON_NAME]
    return values, [*report.sentences, f'written: {out / PAGE_NAME}, {", ".join(names)}']


def _greatest_change(
    found: PairedArms, one: ArmComparison
) -> tuple[str, float, int] | None:
    """Where on the horizontal axis rho changes most, its median change there, and of how many."""
    x, change = changes(found, one)
    if len(x) < 2 * LEAST_IN_BIN or x.min() == x.max():
        return None
    parts = [part for part in bins(x) if part[2].sum() >= LEAST_IN_BIN]
    medians = [float(np.median(change[part[2]])) for part in parts]
    if not medians:
        return None
    greatest = int(np.argmax(np.abs(medians)))
    low, high, inside = parts[greatest]
    return range_words(found.over, low, high), medians[greatest], int(inside.sum())


def _unit(experiment: Experiment) -> str:
    """The unit of rho as it follows a number: ``' m'``; '' if it has none, or several."""
    unit = rho_unit(parse_spec(experiment.specs[0]).formula, SIGNALS)
    return f' {unit}' if unit else ''


def _axis_unit(experiment: Experiment) -> str:
    unit = _unit(experiment)
    return f' [{unit.strip()}]' if unit else ''


def _arms_table(found: PairedArms) -> Table:
    return Table(
        name='arms', title='Outcomes of the scenes',
        caption='Over all judged runs of an arm. Every scene was run once in each; only the '
        'settings of the arm differ, so runs are compared in pairs.',
        columns=(
            Column(name='arm', title='arm'), Column(name='judged', title='judged'),
            Column(name='satisfied', title='satisfied'),
            Column(name='satisfied_percent', title='satisfied [%]', decimals=1),
            Column(name='off_runway', title='off the runway'),
            Column(name='median_rho', title='median ρ', decimals=2),
            Column(name='infra_errors', title='broken by the bench'),
        ),
        rows=tuple(_arm_line(name, rows) for name, rows in found.rows.items()),
    )


def _arm_line(name: str, rows: Sequence[RunRow]) -> tuple[Cell, ...]:
    judged = [row for row in rows if row.outcome.judged]
    passed = sum(row.outcome is Outcome.PASS for row in judged)
    return (
        name, len(judged), passed, 100 * passed / len(judged) if judged else None,
        None if any(row.left_runway is None for row in judged)
        else sum(bool(row.left_runway) for row in judged),
        float(np.median([rho_of(row) for row in judged])) if judged else None,
        sum(row.outcome is Outcome.INFRA_ERROR for row in rows),
    )


def _flips_tables(found: PairedArms, one: ArmComparison) -> tuple[Table, ...]:
    flips = [pair for pair in one.pairs if pair[0].outcome is not pair[1].outcome]
    if not flips:
        return ()
    flips.sort(key=lambda pair: -abs(rho_of(pair[1]) - rho_of(pair[0])))
    return (Table(
        name=f'flips_{one.arm}', title='Scenes with different verdicts',
        caption=f'{len(flips)} of {len(one.pairs)} pairs, the greatest change of ρ first'
                f'{f"; {_MOST_FLIPS} are shown" if len(flips) > _MOST_FLIPS else ""}.',
        columns=(
            Column(name='index', title='scene'),
            Column(name=found.over, title=title_of(found.over), decimals=2),
            Column(name=f'outcome_{one.base}', title=one.base),
            Column(name=f'outcome_{one.arm}', title=one.arm),
            Column(name=f'rho_{one.base}', title=f'ρ, {one.base}', decimals=2),
            Column(name=f'rho_{one.arm}', title=f'ρ, {one.arm}', decimals=2),
        ),
        rows=tuple(
            (a.index, _place_cell(a, found.over), a.outcome, b.outcome, rho_of(a), rho_of(b))
            for a, b in flips[:_MOST_FLIPS]
        ),
    ),)


def _place_cell(row: RunRow, key: str) -> Cell:
    value = row.scene[key]
    return clock_words(float(value)) if key == _HOURS and value is not None else value


# JSON --------------------------------------------------------------------------------------------


def _comparison_json(one: ArmComparison) -> dict[str, Any]:
    return {
        'arm': one.arm, 'base': one.base, 'pairs': len(one.pairs), 'unpaired': one.unpaired,
        'satisfied': {**_rates_json(one.satisfied), 'p_holm': one.satisfied_p},
        'off_runway': _rates_json(one.off_runway), 'settled': _rates_json(one.settled),
        'rho': {**_shift_json(one.rho), 'p_holm': one.rho_p},
        'max_cross_track_m': _shift_json(one.max_cross_track_m),
        'settle_time_s': _shift_json(one.settle_time_s),
    }


def _rates_json(rates: PairedRates) -> dict[str, Any]:
    return {
        'base': rates.first, 'arm': rates.second, 'both': rates.both,
        'base_only': rates.only_first, 'arm_only': rates.only_second, 'neither': rates.neither,
        'mcnemar_p': rates.p_value, **_interval_json('difference', rates.difference),
    }


def _shift_json(shift: PairedShift) -> dict[str, Any]:
    return {
        'pairs': shift.pairs, 'more': shift.more, 'less': shift.less, 'wilcoxon_p': shift.p_value,
        **_interval_json('change', shift.change),
    }


def _interval_json(name: str, interval: ConfidenceInterval) -> dict[str, Any]:
    return {name: interval[0], 'low': interval[1], 'high': interval[2]}
