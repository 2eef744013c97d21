"""The results of shrinking a failed run, written as JSON, as a Scenic program and as a picture."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from taxinet_ros.analysis.one_run.trajectories import BAND_M, Trajectory
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.scenes.programs import scenario_program
from taxinet_ros.campaign.shrink.options import ShrinkOptions
from taxinet_ros.campaign.shrink.shrinking import Report, edge_words, off_nominal
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.atomic import write_atomically

# Okabe-Ito colours, distinguishable with all common colour vision deficiencies; dashes for grey.
_STYLES: tuple[dict[str, Any], ...] = (
    {'color': '#D55E00', 'linestyle': (0, (5, 1.5)), 'linewidth': 1.6},
    {'color': 'black', 'linestyle': '-', 'linewidth': 2.2},
    {'color': '#0072B2', 'linestyle': (0, (1, 1)), 'linewidth': 2.0},
)
_LEAST_M, _BEYOND_EDGE_M = 2.5, 4.0


def shrink_picture(runs: Sequence[Trajectory], path: Path, title: str) -> None:
    """Draw up to three runs in one plot. The same runs give the same bytes.

    Args:
        runs: the original, the shrunk and the nominal run, as far as available; their labels are
            shown.
        path: PNG file to write.
        title: title of the picture.

    Raises:
        ValueError: there is nothing to draw, or there are too many.
    """
    if not 0 < len(runs) <= len(_STYLES):
        raise ValueError(f'{len(runs)} runs to draw')
    figure = Figure(figsize=(8.0, 4.4), dpi=110, layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    _background(axes, _limit(runs), runs[0].half_width_m)
    for order, (run, style) in enumerate(zip(runs, _STYLES, strict=False)):
        axes.plot(run.t_s, run.cte_m, label=run.label, zorder=3 + order, **style)
        axes.plot(run.t_s[:1], run.cte_m[:1], marker='o', markersize=4, color=style['color'])
    axes.set_xlabel('time [s]')
    axes.set_ylabel('cross-track error [m], left is up')
    axes.set_title(title, fontsize=11)
    band, *lines = axes.get_legend_handles_labels()[0]
    figure.legend(
        handles=[*lines, band], loc='outside lower center', ncols=4, frameon=False, fontsize=9
    )
    figure.savefig(path, format='png', metadata={'Software': None})


def _limit(runs: Sequence[Trajectory]) -> float:
    """Half the height shown [m]: all of the runs, but little more grass than runway."""
    farthest = max(float(np.abs(run.cte_m).max()) for run in runs)
    return float(np.clip(1.1 * farthest, _LEAST_M, runs[0].half_width_m + _BEYOND_EDGE_M))


def _background(axes: Axes, limit: float, edge: float) -> None:
    axes.axhspan(-BAND_M, BAND_M, color='#009E73', alpha=0.18, linewidth=0, zorder=1,
                 label=f'within {BAND_M:g} m of the centreline')
    if limit > edge:
        for side in (-1, 1):
            axes.axhspan(side * edge, side * limit, color='0.88', zorder=0)
            axes.axhline(side * edge, color='0.25', linewidth=1.4, zorder=2)
        axes.text(0.01, 0.985, 'off the runway', transform=axes.transAxes, va='top', fontsize=8,
                  color='0.35')
    axes.set_ylim(-limit, limit)
    axes.margins(x=0.01)
    axes.grid(visible=True, color='0.9', linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)


JSON_NAME, PROGRAM_NAME, PICTURE_NAME = 'shrink.json', 'shrunk.scenic', 'shrink.png'


def write_shrunk(options: ShrinkOptions, found: Report, runs: int) -> list[str]:
    """Write ``shrink.json``, ``shrunk.scenic`` and, if there are bags, ``shrink.png``.

    Args:
        options: the options.
        found: the result so far.
        runs: number of runs.

    Returns:
        The names of the files.
    """
    out = options.campaign.out
    about = (
        f'The nearest to plain taxiing at which {options.campaign.perception} still violates '
        f'{options.headline}.\n\nShrunk from run {options.run.run_id} by taxinet shrink.'
    )
    remarks = {
        one.key: f'matters: {edge_words(one)}'
        for one in found.findings if one.matters and one.rho_passes_at is not None
    }
    write_atomically(out / PROGRAM_NAME, scenario_program(found.scenario, about, remarks))
    write_atomically(out / JSON_NAME, json.dumps(_as_json(options, found, runs), indent=2) + '\n')
    drawn = _trajectories(options, found)
    if not drawn:
        return [PROGRAM_NAME, JSON_NAME]
    title = f'{options.run.run_id}: fails with {off_nominal(found)}'
    shrink_picture(drawn, out / PICTURE_NAME, title)
    return [PROGRAM_NAME, JSON_NAME, PICTURE_NAME]


def _as_json(options: ShrinkOptions, found: Report, runs: int) -> dict[str, Any]:
    return {
        'run': options.run.run_id,
        'perception': options.campaign.perception,
        'spec': options.headline,
        'end': found.state.end.value or 'interrupted',
        'runs': runs,
        'made_on': dict(provenance()),
        'runs_needed': found.state.asked,
        'parameters': {
            one.key: {
                **{name: value for name, value in dataclasses.asdict(one).items() if name != 'key'},
                'matters': one.matters,
            }
            for one in found.findings
        },
        **{
            name: {'run': row.run_id, 'rho': row.rho[options.headline]}
            for name, row in _three(found).items()
        },
        'scenario': found.scenario.to_human(),
    }


def _three(found: Report) -> dict[str, RunRow]:
    rows = {'original': found.original, 'shrunk': found.shrunk, 'nominal': found.nominal}
    return {name: row for name, row in rows.items() if row is not None}


def _trajectories(options: ShrinkOptions, found: Report) -> list[Trajectory]:
    drawn = []
    for name, row in _three(found).items():
        # A resumed shrinking uses runs whose bags may have been deleted since.
        if not row.bag or not (options.campaign.out / row.bag).is_dir():
            continue
        recording = open_recording(options.campaign.out / row.bag)
        trace = recording.columns
        drawn.append(Trajectory(
            label=f'{name}, rho {row.rho[options.headline]:+.2f}',
            t_s=trace['t_ns'].astype(np.float64) / NS_PER_S,
            x_m=trace['distance_m'].astype(np.float64), cte_m=trace['cte_m'].astype(np.float64),
            ok=row.outcome is Outcome.PASS,
            half_width_m=recording.scenario.line.half_width_m,
        ))
    return drawn
