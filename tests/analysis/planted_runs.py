"""Campaigns whose causes of failure are known, because they were planted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from taxinet_ros.analysis.runs.campaign import CampaignRuns, read_runs
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.trials.record.facts import FACTS

CLOUDS = ('clear', 'cirrus', 'scattered', 'broken', 'overcast', 'stratus')


def planted_table(
    runs: int, seed: int, rate: Callable[[pd.DataFrame], object], **columns: object
) -> pd.DataFrame:
    """A campaign's table; scenes are drawn as by S_falsif.

    Args:
        runs: how many.
        seed: of scenes and outcomes.
        rate: probability of failing for each scene.
        columns: to put in place of others.
    """
    rng = np.random.default_rng(seed)
    clouds = rng.choice(CLOUDS, runs)
    rains = (rng.random(runs) < 0.5) & np.isin(clouds, CLOUDS[3:])
    table = pd.DataFrame({
        'run_id': [f'planted-s{seed}-{number:05d}' for number in range(runs)],
        'index': np.arange(runs), 'program': 'planted', 'seed': seed, 'sampler': 'random',
        'weight': 1.0, 'perception': 'network', 'cross_track_m': rng.uniform(-8, 8, runs),
        'distance_m': rng.uniform(0, 2000, runs), 'heading_deg': rng.uniform(-30, 30, runs),
        'clouds': clouds, 'rain_percent': np.where(rains, rng.uniform(25, 100, runs), 0.0),
        'time_of_day_h': rng.uniform(6, 18, runs), 'date': '2020-03-20', 'shadows': True,
        'aircraft': 'caravan', 'duration_s': 30.0,
    })
    table = table.assign(**columns)
    failed = rng.random(runs) < np.broadcast_to(np.asarray(rate(table), dtype=float), runs)
    size = rng.uniform(0.01, 1.0, runs)
    return table.assign(
        outcome=np.where(failed, 'FAIL', 'PASS'), rho=np.where(failed, -20 * size, 1.5 * size),
        rho_phi=np.where(failed, -20 * size, 1.5 * size), left_runway=failed & (size > 0.6),
        stopped_early=False, bag='',
    )


def planted_runs(table: pd.DataFrame, folder: Path, spec: str | None = None) -> CampaignRuns:
    """The table as that of a campaign of so many runs in ``folder``; ``rho`` is the headline's."""
    path = folder / 'runs.parquet'
    if {'rho', 'rho_phi'} <= set(table.columns):
        table = table.assign(rho=table['rho_phi'])
    table.to_parquet(path, index=False)
    record_facts(folder, runs=len(table))
    return read_runs(path, spec)


def record_facts(folder: Path, **facts: object) -> None:
    """Give a folder the record of a campaign with these facts, beside a table."""
    with Record(folder / RECORD_NAME) as record:
        record.put(FACTS, '', facts)
