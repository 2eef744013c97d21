"""Two networks on the same scenes: what got better, what got worse, and in what kind of scene.

The causes of a change are those of its scenes: a scene that only the second network fails is taken
as a failure, and the search for causes looks for where these lie, with p values that account for
all regions compared. So no region is chosen by the failures of one network alone, of which the
other would then have fewer by chance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from taxinet_ros.analysis.campaign.findings import common_scenes, differing_settings
from taxinet_ros.analysis.campaign.folder import csv_text
from taxinet_ros.analysis.causes.causes import LEAST_FAILURES, Causes, find_causes
from taxinet_ros.analysis.experiment.pairs import (
    PairedRates,
    PairedShift,
    paired_rates,
    paired_shift,
)
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
from taxinet_ros.analysis.runs.campaign import CampaignRuns, runs_of
from taxinet_ros.analysis.runs.features import SCENE_COLUMNS
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.scenario_fields import clock_words
from taxinet_ros.core.verdict.outcome import OPEN
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically, write_parquet
from taxinet_ros.files.plain_values import json_text, plain
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.trials.options import DEFAULT_ROOT
from taxinet_ros.trials.past_runs.shared_scenes import SceneSet, SharedTrials

TEXT = Path(__file__).with_name('compared.j2')
JSON_NAME, PAGE_NAME, CSV_NAME = 'compare.json', 'compare.html', 'changed.csv'
BEFORE, AFTER = 'before.parquet', 'after.parquet'
_OURS = {JSON_NAME, PAGE_NAME, CSV_NAME, BEFORE, AFTER, 'compared.png', 'bisect.json'}
_SIGNIFICANT = 0.05
_SHOWN = ('time_of_day_h', 'clouds', 'rain_percent', 'cross_track_m', 'distance_m', 'heading_deg')
_MOST_SHOWN = 15.0


@dataclass(frozen=True, kw_only=True)
class Compared:
    """Comparison of two networks on the same scenes.

    Attributes:
        before, after: runs of the first and of the second network.
        scenes: one row per common scene: features, ``run_id`` of the second, ``rho_before``,
            ``rho_after``, ``failed_before``, ``failed_after``.
        satisfied: whether runs satisfy the formula, the first network's result first.
        rho: change of robustness.
        better, worse: causes of the scenes that only the second, only the first satisfies.
        tested: whether a test is valid: the scenes were chosen without regard to results, in a
            number fixed beforehand.
        differing: settings that differ beside the network, or are not recorded.
        uncounted: number of further common scenes that were not drawn by the program itself, or
            after the number fixed beforehand.
    """

    before: CampaignRuns
    after: CampaignRuns
    scenes: pd.DataFrame
    satisfied: PairedRates
    rho: PairedShift
    better: Causes
    worse: Causes
    tested: bool
    differing: tuple[str, ...]
    uncounted: int = 0

    @property
    def no_rate(self) -> str:
        """Why shares are of these scenes only, as a clause; '' if they are rates."""
        return self.before.no_rate or self.after.no_rate

    @property
    def unpaired(self) -> int:
        """Number of runs of either network without a counterpart."""
        common = len(self.scenes) + self.uncounted
        return len(self.before.frame) + len(self.after.frame) - 2 * common

    @property
    def unknown(self) -> int:
        """Greatest number of further common scenes of which a run has no verdict."""
        common = len(self.scenes) + self.uncounted
        (lost, alone), (lost_after, alone_after) = (
            (sum(some.others.get(outcome, 0) for outcome in OPEN), len(some.frame) - common)
            for some in (self.before, self.after)
        )
        return min(lost, alone_after + lost_after) + min(lost_after, alone + lost)

    @property
    def clear(self) -> bool:
        """Whether the satisfied shares differ significantly, whatever the unknown runs gave."""
        return self.tested and self.satisfied.p_at_most(self.unknown) < _SIGNIFICANT


def compared(before: CampaignRuns, after: CampaignRuns, *, alpha: float = 0.05) -> Compared:
    """Compare the runs of two networks in their common scenes.

    Args:
        before: runs of the first network.
        after: runs of the second one.
        alpha: probability of naming a cause of a change if there is none; half of it is for causes
            of what got better, half for those of what got worse.

    Raises:
        UsageError: they have no scene in common, or are judged by different formulas.
    """
    if before.spec != after.spec:
        raise UsageError(
            f'{before.path} is judged by {before.spec}, {after.path} by {after.spec}; compare '
            'runs of one requirement'
        )
    if before.formula and after.formula and before.formula != after.formula:
        raise UsageError(
            f'{before.path} is judged by {before.spec}={before.formula}, {after.path} by '
            f'{after.spec}={after.formula}; compare runs of one requirement'
        )
    both = common_scenes(after, before)
    if both.empty:
        values = [(name, before.scenes[name], after.scenes[name]) for name in SCENE_COLUMNS]
        apart = [
            name for name, one, other in values
            if one.nunique() == other.nunique() == 1 and one.iloc[0] != other.iloc[0]
        ]
        why = f', as {", ".join(apart)} differs' if apart else ''
        raise UsageError(
            f'{before.path} and {after.path}: no scene in common{why}; run both with the same '
            'program, seed and sampler, or name two networks and the scenes'
        )
    rows, there = both['row'].to_numpy(), both['row_there'].to_numpy()
    frame = after.frame.iloc[rows].reset_index(drop=True)
    was = before.frame.iloc[there].reset_index(drop=True)
    frame = frame.assign(
        failed_before=was['failed'], failed_after=frame['failed'], rho_before=was['rho'],
        rho_after=frame['rho'], run_before=was['run_id'],
    )
    fixed = not (before.anytime or after.anytime)
    rated = before.weighting.rated and after.weighting.rated
    better, worse = (
        _causes(after, frame, rows, (first & ~second).to_numpy(dtype=bool), alpha / 2)
        for first, second in (
            (frame['failed_before'], frame['failed_after']),
            (frame['failed_after'], frame['failed_before']),
        )
    )
    exact = (was['rho_exact'] & frame['rho_exact']).to_numpy(dtype=bool)
    return Compared(
        before=before, after=after, scenes=frame, tested=rated and fixed,
        satisfied=paired_rates(
            (~frame['failed_before']).tolist(), (~frame['failed_after']).tolist()),
        rho=paired_shift(
            np.where(exact, frame['rho_before'], math.nan).tolist(),
            np.where(exact, frame['rho_after'], math.nan).tolist(),
        ),
        better=better, worse=worse, differing=differing_settings(after, before),
        uncounted=len(common_scenes(after, before, all_runs=True)) - len(both),
    )


def _causes(
    runs: CampaignRuns, frame: pd.DataFrame, rows: np.ndarray, changed: np.ndarray, alpha: float
) -> Causes:
    """Causes of the scenes that changed in one direction."""
    return find_causes(replace(
        runs, frame=frame.assign(failed=changed),
        scenes=runs.scenes.iloc[rows].reset_index(drop=True),
    ), alpha)


def changed_table(found: Compared) -> Table:
    """Scenes with different verdicts, those that got worse first, the greatest change first."""
    frame = found.scenes
    changed = frame[frame['failed_before'] != frame['failed_after']]
    changed = changed.assign(
        change=changed['rho_after'] - changed['rho_before'],
        got=np.where(changed['failed_after'], 'worse', 'better'),
    ).sort_values(['failed_after', 'change'], ascending=[False, True], kind='stable')
    causes = {
        'worse': [cause.region for cause in found.worse.found],
        'better': [cause.region for cause in found.better.found],
    }
    rows: list[tuple[Cell, ...]] = []
    for place in range(len(changed)):
        line = changed.iloc[[place]]
        got = str(line['got'].iloc[0])
        words = next(
            (region.words() for region in causes[got] if region.mask(line).any()), '')
        rows.append((
            got, str(line['run_id'].iloc[0]), words,
            float(line['rho_before'].iloc[0]), float(line['rho_after'].iloc[0]),
            clock_words(line['time_of_day_h'].iloc[0]), *(line[name].iloc[0] for name in _SHOWN),
        ))
    return Table(
        name='changed', title='Scenes that changed',
        caption='Scenes that got worse first, the greatest change of ρ first.',
        columns=(
            Column(name='got', title='got'), Column(name='run_id', title='scene'),
            Column(name='cause', title='cause of the change'),
            Column(name='rho_before', title=f'ρ, {found.before.label}', decimals=2),
            Column(name='rho_after', title=f'ρ, {found.after.label}', decimals=2),
            Column(name='time_of_day', title='time'),
            Column(name='time_of_day_h', title='hour', decimals=2, on_page=False),
            Column(name='clouds', title='clouds'),
            Column(name='rain_percent', title='rain [%]', decimals=0),
            Column(name='cross_track_m', title='left of the line [m]', decimals=1),
            Column(name='distance_m', title='along the track [m]', decimals=0),
            Column(name='heading_deg', title='nose left [°]', decimals=0),
        ), rows=tuple(rows),
    )


def compared_report(found: Compared) -> Report:
    """The page."""
    return fill_report(
        TEXT, {'f': found, 'one': found.before.label, 'other': found.after.label,
               'least': LEAST_FAILURES},
        {'scenes': (_picture(found), changed_table(found))},
    )


def _picture(found: Compared) -> Picture:
    return Picture(
        name='compared', title='Robustness of each scene with both networks',
        caption='A dot is a scene. Right of the vertical and above the horizontal line it is '
        f'satisfied; beyond ±{_MOST_SHOWN:g} dots are drawn at the edge.',
        draw=partial(_draw, found), size_in=(5.6, 5.2),
    )


def _draw(found: Compared, figure: Figure, theme: Theme) -> None:
    axes = figure.subplots()
    frame = found.scenes
    first, second = (
        frame[name].clip(-_MOST_SHOWN, _MOST_SHOWN) for name in ('rho_before', 'rho_after'))
    worse = (frame['failed_after'] & ~frame['failed_before']).to_numpy(dtype=bool)
    better = (frame['failed_before'] & ~frame['failed_after']).to_numpy(dtype=bool)
    same = ~(worse | better)
    for mask, colour, words, marker in (
        (same, theme.ink, 'same verdict', 'o'), (better, theme.passed, 'got better', 'o'),
        (worse, theme.failed, 'got worse', 'X'),
    ):
        axes.plot(first[mask], second[mask], marker, color=colour, markersize=5, alpha=0.7,
                  markeredgewidth=0, label=f'{words}: {int(mask.sum()):,}', clip_on=False)
    axes.axhline(0, color=theme.ink, linewidth=0.8)
    axes.axvline(0, color=theme.ink, linewidth=0.8)
    axes.set(xlabel=f'ρ, {found.before.label}', ylabel=f'ρ, {found.after.label}')
    # Above the plot, as everywhere: below it, the layout leaves an empty strip before the legend.
    axes.legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=9)
    style_axes(axes)


def compared_json(found: Compared) -> dict[str, Any]:
    """Everything as plain values."""
    rates, gap = found.satisfied, found.satisfied.difference
    report = compared_report(found)
    (table,) = report.sections[0].tables
    names = [column.name for column in table.columns]
    return plain({
        'before': found.before.label, 'after': found.after.label, 'spec': found.after.spec,
        'scenes': rates.pairs, 'unpaired': found.unpaired,
        'uncounted': found.uncounted, 'unknown': found.unknown, 'tested': found.tested,
        'satisfied': {
            'before': rates.first, 'after': rates.second, 'better': rates.only_second,
            'worse': rates.only_first, 'both': rates.both, 'neither': rates.neither,
            'difference': gap.value, 'low': gap.low if found.tested else math.nan,
            'high': gap.high if found.tested else math.nan,
            'mcnemar_p': rates.p_value if found.tested else math.nan,
        },
        'rho': {'change': found.rho.change.value, 'more': found.rho.more, 'less': found.rho.less},
        'causes': {
            word: [
                {'words': one.region.words(), 'scenes': one.inside.runs,
                 'changed': one.inside.failures, 'p': one.p} for one in causes.found
            ] for word, causes in (('better', found.better), ('worse', found.worse))
        },
        'changed': [dict(zip(names, row, strict=True)) for row in table.rows],
        'differing': list(found.differing), 'sentences': list(report.summary),
        'made_on': dict(provenance()),
    })


def compare_folder(out: Path | None, words: Sequence[str]) -> Path:
    """The folder of a comparison.

    Args:
        out: as named; None for one below ``bags/``.
        words: what is compared.

    Raises:
        UsageError: it contains something else.
    """
    names = '-'.join(Path(word.rstrip('/')).stem.replace(':', '-') for word in words)
    out = out or DEFAULT_ROOT / f'compare-{names}'
    there = {path.name for path in out.iterdir()} if out.is_dir() else set()
    # Beside a record may be its journal, its lock and a damaged one.
    if {name for name in there if RECORD_NAME not in name} - _OURS:
        raise UsageError(f'out {out}: contains something else; choose another folder')
    return out


def driven_campaigns(
    scenes: SceneSet, networks: Sequence[str], out: Path, workers: int,
    on_trial: Callable[[], None], interrupted: Callable[[], bool],
) -> list[CampaignRuns]:
    """Drive two networks through the same scenes, and write their tables.

    Args:
        scenes: the scenes.
        networks: words or files.
        out: folder; finished runs in it are kept.
        workers: number of processes.
        on_trial: called after each run.
        interrupted: whether to start no more runs.

    Raises:
        KeyboardInterrupt: interrupted with runs left.
    """
    tables: list[CampaignRuns] = []
    with SharedTrials(scenes, out) as trials:
        for network, name in zip(networks, (BEFORE, AFTER), strict=True):
            trials.drive(network, workers=workers, on_trial=on_trial, interrupted=interrupted)
            frame = trials.table(network)
            write_parquet(out / name, frame)
            tables.append(runs_of(frame, out / name))
    return tables


def write_compared(found: Compared, out: Path) -> dict[str, Any]:
    """Write page, picture, table and JSON; return the values of the JSON."""
    report, values = compared_report(found), compared_json(found)
    for section in report.sections:
        for table in section.tables:
            write_atomically(out / CSV_NAME, csv_text(table))
    write_atomically(out / JSON_NAME, json_text(values) + '\n')
    write_report(report, out / PAGE_NAME)
    return values
