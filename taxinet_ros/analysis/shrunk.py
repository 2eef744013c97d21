"""Writes down what came of shrinking a failed run: as numbers, as a program, as a picture."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np

from taxinet_ros.analysis.shrink_picture import shrink_picture
from taxinet_ros.analysis.trajectories import Trajectory
from taxinet_ros.bag.layout import write_atomically
from taxinet_ros.bag.trace import read_trace
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.scenario_program import scenario_program
from taxinet_ros.campaign.shrink_lines import edge_words, off_nominal
from taxinet_ros.campaign.shrink_options import ShrinkOptions
from taxinet_ros.campaign.shrink_report import Report
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.types import NS_PER_S

JSON_NAME, PROGRAM_NAME, PICTURE_NAME = 'shrink.json', 'shrunk.scenic', 'shrink.png'


def write_shrunk(options: ShrinkOptions, found: Report, runs: int) -> list[str]:
    """Write ``shrink.json``, ``shrunk.scenic`` and, where there are bags, ``shrink.png``.

    Args:
        options: what was asked for.
        found: what came of it, by now.
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
        # A resumed shrinking rests on runs whose bags may have been deleted since.
        if not row.bag or not (options.campaign.out / row.bag).is_dir():
            continue
        trace = read_trace(options.campaign.out / row.bag)
        drawn.append(Trajectory(
            label=f'{name}, rho {row.rho[options.headline]:+.2f}',
            t_s=trace['t_ns'].astype(np.float64) / NS_PER_S,
            x_m=trace['x_m'].astype(np.float64), cte_m=trace['cte_m'].astype(np.float64),
            ok=row.outcome is Outcome.PASS,
        ))
    return drawn
