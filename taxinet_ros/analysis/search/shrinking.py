"""The results of shrinking a failed run, written as JSON, as a Scenic program and as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from taxinet_ros.analysis.one_run.trajectories import BAND_M, Trajectory
from taxinet_ros.analysis.report.page import write_report
from taxinet_ros.analysis.report.parts import Column, Picture, Table, Theme
from taxinet_ros.analysis.report.parts import Report as PageReport
from taxinet_ros.analysis.report.text import fill_report
from taxinet_ros.analysis.report.values import signs
from taxinet_ros.analysis.report.viewer import Deciding, further_signals
from taxinet_ros.analysis.report.worst import draw_limit
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.mtl.interval import rho_text
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.scenario_fields import BY_KEY
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import json_text, plain
from taxinet_ros.scenes.programs import scenario_program
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.shrink.shrinking import (
    Report,
    Shrinking,
    edge_words,
    off_nominal,
    run_command,
)

TEXT = Path(__file__).with_name('shrink.j2')
_LEAST_M, _BEYOND_EDGE_M = 2.5, 4.0


def _styles(theme: Theme) -> tuple[dict[str, Any], ...]:
    """Distinguishable with all common colour vision deficiencies; dashes for grey."""
    return (
        {'color': theme.failed, 'linestyle': (0, (5, 1.5)), 'linewidth': 1.6},
        {'color': theme.ink, 'linestyle': '-', 'linewidth': 2.2},
        {'color': theme.passed, 'linestyle': (0, (1, 1)), 'linewidth': 2.0},
    )


def shrink_picture(runs: Sequence[Trajectory], title: str) -> Picture:
    """Up to three runs in one plot.

    Args:
        runs: the original, the shrunk and the nominal run, as far as available; their labels are
            shown.
        title: title of the picture.
    """
    return Picture(
        name=Path(PICTURE_NAME).stem, title=title, size_in=(8.0, 4.4),
        caption='True distance from the line over time, left is up.',
        draw=lambda figure, theme: _draw(runs, figure, theme),
    )


def _signal_picture(
    runs: Sequence[Trajectory], values: Sequence[Mapping[str, NDArray[Any]]], deciding: Deciding,
    title: str,
) -> Picture:
    """As :func:`shrink_picture`, of the signal that decides."""
    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        draw_limit(deciding, axes, theme)
        for run, signals, style in zip(runs, values, _styles(theme), strict=False):
            axes.plot(run.t_s, signals[deciding.signal], label=run.label, **style)
        axes.margins(x=0.01)
        axes.grid(visible=True, linewidth=0.6, zorder=0)
        figure.legend(loc='outside lower center', ncols=4, frameon=False, fontsize=9)

    return Picture(
        name=Path(PICTURE_NAME).stem, title=title, size_in=(8.0, 4.4), draw=draw,
        caption=f'{deciding.signal} over time.',
    )


def _draw(runs: Sequence[Trajectory], figure: Figure, theme: Theme) -> None:
    axes = figure.subplots()
    _background(axes, _limit(runs), runs[0].half_width_m, theme)
    for order, (run, style) in enumerate(zip(runs, _styles(theme), strict=False)):
        axes.plot(run.t_s, run.cte_m, label=run.label, zorder=3 + order, **style)
        axes.plot(run.t_s[:1], run.cte_m[:1], marker='o', markersize=4, color=style['color'])
    axes.set_xlabel('time [s]')
    axes.set_ylabel('cross-track error [m], left is up')
    band, *lines = axes.get_legend_handles_labels()[0]
    figure.legend(
        handles=[*lines, band], loc='outside lower center', ncols=4, frameon=False, fontsize=9
    )


def _limit(runs: Sequence[Trajectory]) -> float:
    """Half the height shown [m]: all of the runs, but little more grass than runway."""
    farthest = max(float(np.abs(run.cte_m).max()) for run in runs)
    return float(np.clip(1.1 * farthest, _LEAST_M, runs[0].half_width_m + _BEYOND_EDGE_M))


def _background(axes: Axes, limit: float, edge: float, theme: Theme) -> None:
    axes.axhspan(-BAND_M, BAND_M, color='#009E73', alpha=0.18, linewidth=0, zorder=1,
                 label=f'within {BAND_M:g} m of the centreline')
    if limit > edge:
        for side in (-1, 1):
            axes.axhspan(side * edge, side * limit, color=theme.faint, alpha=0.5, zorder=0)
            axes.axhline(side * edge, color=theme.ink, linewidth=1.4, zorder=2)
        axes.text(0.01, 0.985, 'off the runway', transform=axes.transAxes, va='top', fontsize=8,
                  color=theme.ink)
    axes.set_ylim(-limit, limit)
    axes.margins(x=0.01)
    axes.grid(visible=True, linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)


JSON_NAME, PROGRAM_NAME, PICTURE_NAME = 'shrink.json', 'shrunk.scenic', 'shrink.png'
PAGE_NAME = 'shrink.html'


def write_shrunk(shrinking: Shrinking, found: Report) -> list[str]:
    """Write page, ``shrunk.scenic``, ``shrink.json`` and, if there are bags, ``shrink.png``.

    Args:
        shrinking: the shrinking.
        found: the result so far.

    Returns:
        The names of the files.
    """
    out = shrinking.campaign.out
    about = (
        f'The nearest to plain taxiing at which {shrinking.campaign.perception} still violates '
        f'{shrinking.headline}.\n\nShrunk from run {shrinking.run.run_id} by taxinet shrink.'
    )
    remarks = {
        one.key: f'matters: {edge_words(one)}'
        for one in found.findings if one.matters and one.rho_passes_at is not None
    }
    write_atomically(out / PROGRAM_NAME, scenario_program(found.scenario, about, remarks))
    write_atomically(out / JSON_NAME, json_text(_as_json(shrinking, found)) + '\n')
    report = shrink_report(shrinking, found)
    write_report(report, out / PAGE_NAME)
    pictures = [PICTURE_NAME] if report.sections[0].pictures else []
    return [PAGE_NAME, PROGRAM_NAME, JSON_NAME, *pictures]


def shrink_report(shrinking: Shrinking, found: Report) -> PageReport:
    """The page on a shrinking: what is left of the failed run, and what matters in it.

    Args:
        shrinking: the shrinking.
        found: the result so far.
    """
    name = shrinking.headline
    three = _three(found)
    drawn, unread = _trajectories(shrinking, three)
    bags = {
        row.run_id: shrinking.campaign.out / row.bag
        for key, row in sorted(three.items(), key=lambda item: item[1].rho[name]) if key in drawn
    }
    shrunk = three.get('shrunk')
    title = f'Fails with {off_nominal(found)}'
    pictures = [_picture(shrinking, three, drawn, title)] if drawn else []
    return fill_report(
        TEXT, {
            'values': _as_json(shrinking, found), 'fields': BY_KEY,
            'network': Path(shrinking.campaign.perception).name,
            'command': run_command(shrinking, PROGRAM_NAME), 'unread': unread,
        },
        {'parameters': (*pictures, _parameters(found))},
        runs=bags, worst='' if shrunk is None else shrunk.run_id, worst_words='The shrunk run',
        rho={row.run_id: row.rho[name] for row in three.values()},
    )


def _picture(
    shrinking: Shrinking, rows: Mapping[str, RunRow], drawn: Mapping[str, Trajectory], title: str
) -> Picture:
    read = [
        further_signals(open_recording(shrinking.campaign.out / rows[name].bag), run.t_s)
        for name, run in drawn.items()
    ]
    deciding = next((one for _, one in read if one is not None), None)
    runs = [*drawn.values()]
    if deciding is None:
        return shrink_picture(runs, title)
    return _signal_picture(runs, [signals for signals, _ in read], deciding, title)


def _parameters(found: Report) -> Table:
    return Table(
        name='parameters', title='Every parameter', caption='ρ with this one parameter nominal.',
        columns=(
            Column(name='parameter', title='parameter'), Column(name='original', title='original'),
            Column(name='nominal', title='nominal'), Column(name='shrunk', title='shrunk'),
            Column(name='rho_in_original', title='ρ in the original', decimals=2),
            Column(name='rho_in_shrunk', title='ρ in the shrunk run', decimals=2),
            Column(name='matters', title='matters'),
        ),
        rows=tuple(
            (one.key, *(signs(one.words(value))
                        for value in (one.original, one.nominal, one.shrunk)),
             one.rho_in_original, one.rho_in_shrunk,
             'nominal already' if one.original == one.nominal else one.matters)
            for one in found.findings
        ),
    )


def _as_json(shrinking: Shrinking, found: Report) -> dict[str, Any]:
    return {
        'run': shrinking.run.run_id,
        'perception': shrinking.campaign.perception,
        'spec': shrinking.headline,
        **({'told': list(shrinking.told)} if shrinking.told else {}),
        'end': found.state.end.value or 'interrupted',
        'runs': len(shrinking.judged),
        'made_on': dict(provenance()),
        'parameters': {
            one.key: {
                **{name: value for name, value in plain(one).items() if name != 'key'},
                'matters': one.matters,
            }
            for one in found.findings
        },
        **{
            name: {'run': row.run_id, 'rho': row.rho[shrinking.headline]}
            for name, row in _three(found).items()
        },
        'scenario': found.scenario.to_human(),
    }


def _three(found: Report) -> dict[str, RunRow]:
    rows = {'original': found.original, 'shrunk': found.shrunk, 'nominal': found.nominal}
    return {name: row for name, row in rows.items() if row is not None}


def _trajectories(
    shrinking: Shrinking, rows: Mapping[str, RunRow]
) -> tuple[dict[str, Trajectory], list[str]]:
    """Trajectories of the runs whose bags were not deleted, and what is wrong with damaged ones."""
    drawn: dict[str, Trajectory] = {}
    unread = []
    for name, row in rows.items():
        if row.bag and (shrinking.campaign.out / row.bag).is_dir():
            try:
                drawn[name] = _trajectory(name, row, shrinking)
            except BagError as error:
                unread.append(f'not shown: {error}')
    return drawn, unread


def _trajectory(name: str, row: RunRow, shrinking: Shrinking) -> Trajectory:
    recording = open_recording(shrinking.campaign.out / row.bag)
    trace = recording.columns
    return Trajectory(
        label=f'{name}, rho {rho_text(row.rho[shrinking.headline])}',
        t_s=trace['t_ns'].astype(np.float64) / NS_PER_S,
        x_m=trace['distance_m'].astype(np.float64), cte_m=trace['cte_m'].astype(np.float64),
        ok=row.outcome is Outcome.PASS,
        half_width_m=recording.scenario.line.half_width_m,
    )
