"""A study whose results were made up: four networks, what was learned, one experiment."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from planted_runs import planted_table
from recorded_runs import record_runs

from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.sealed_json import write_sealed
from taxinet_ros.samplers.space import Dimension
from taxinet_ros.scenes.search_space import Choice, Piece
from taxinet_ros.study.stages.config import StudyConfig, read_config, shipped_config
from taxinet_ros.study.stages.plan import LOCALIZE, PAPER_RULE, campaign_of, search_of
from taxinet_ros.study.stages.run import OPTIONS, STAGE, StageRecord, open_study
from taxinet_ros.trials.learned_result import Evidence, LearnedResult
from taxinet_ros.trials.record.row import RunRow

RUNS = 900
FAILING: dict[str, Callable[[pd.DataFrame], object]] = {
    'original': lambda table: np.where(
        at_crossing(table) | (table['time_of_day_h'] < 8), 0.95, 0.25),
    'generic': lambda table: np.where(at_crossing(table), 0.7, 0.05),
    'halton': lambda table: np.where(at_crossing(table), 0.7, 0.0),
    'specialised': lambda table: np.where(at_crossing(table), 0.1, 0.15),
}
"""How probably each network fails in a scene."""

PROBABILITIES = (0.05, 0.0, 0.0, 0.0, 0.01, 0.0, 0.15, 0.76, 0.02, 0.01)


def at_crossing(table: pd.DataFrame) -> pd.Series:
    return table['distance_m'].between(1200, 1600)


def made_up_study(out: Path) -> StudyConfig:
    """Write a study into ``out``, of which training and further training are missing."""
    config = dataclasses.replace(read_config(shipped_config()), runs=RUNS,
                                 experiments={'shadows': 12})
    for name, failing in FAILING.items():
        folder = out / campaign_of(name)
        folder.mkdir()
        made_up_table(name, failing).to_parquet(folder / 'runs.parquet', index=False)
    for number, seed in enumerate(config.learning_seeds):
        for sampler in config.samplers:
            less = 0.01 * number * (sampler == PAPER_RULE)
            _learned(out / search_of(sampler, seed), less, seed)
    _localized(out / LOCALIZE)
    _experiment(out / 'experiment-shadows')
    done = StageRecord().started('i', RUNS, resumed=False).done('k', {}, 3725.0, workers=2)
    with open_study(out, print) as record:
        record.put(OPTIONS, 'case-study', dataclasses.asdict(config))
        for name in ('falsify-original', 'evaluate-generic'):
            record.put(STAGE, name, dataclasses.asdict(done))
    return config


def made_up_table(name: str, failing: Callable[[pd.DataFrame], object]) -> pd.DataFrame:
    """The runs of a network; run 3 was broken by the bench."""
    table = planted_table(RUNS, 0, failing, perception=name, program='s_falsif')
    table.loc[3, 'outcome'] = 'INFRA_ERROR'
    table.loc[3, [name for name in table.columns if name.startswith('rho')]] = np.nan
    return table.assign(
        settle_time_s=np.where(table['outcome'] == 'PASS', 6.0, np.nan), crossing=True,
        cte_error_mean_abs_m=0.3, perception_fingerprint='f' * 64,
    )


def _learned(folder: Path, less: float, seed: int) -> None:
    """What a search came to, with so much less at 1,400-1,600 m and more at 1,200-1,400 m."""
    folder.mkdir()
    probabilities = list(PROBABILITIES)
    probabilities[6] += less
    probabilities[7] -= less
    choice = Choice(
        dimension=Dimension(name='ego.position.y', low=0, high=2000, buckets=10),
        feeds=frozenset({'distance_m'}), pieces=(Piece(start=0, end=1, low=0, high=2000),),
    )
    amounts = tuple(10.0 if number == 7 else 2.0 for number in range(10))
    result = LearnedResult(
        facts={'seed': seed, 'runs_made': 60}, choices=(choice,),
        probabilities={'ego.position.y': tuple(probabilities)},
        evidence={'ego.position.y': Evidence(
            amounts=amounts, squares=amounts, heaviest=1.0,
        )},
    )
    (folder / 'learned.json').write_text(result.to_json())


def _localized(folder: Path) -> None:
    folder.mkdir()
    share = {'substitution': 'truth', 'passed': 19, 'judged': 20, 'low': 0.75, 'high': 0.99}
    write_sealed(folder / 'localize.json', {
        'failed': 200, 'judged': RUNS, 'looked_into': 20, 'counted': 20,
        'substitutions': [share], 'sentences': ['19 of 20 pass on the true state.'],
    })


def _experiment(folder: Path) -> None:
    for arm in ('shadows', 'no_shadows'):
        record_runs(folder / arm, {}, [_row(index, arm) for index in range(12)])
    write_sealed(folder / 'experiment.json', {
        'comparisons': [{'pairs': 12}], 'sentences': ['Rho is greater.'],
    })
    hours = np.arange(6, 18, 0.2)
    pd.DataFrame({
        'time_of_day_h': hours, 'rho_shadows': 0.5,
        'rho_no_shadows': np.where(hours < 12, 0.5, 0.7),
    }).to_parquet(folder / 'pairs.parquet', index=False)


def _row(index: int, arm: str) -> RunRow:
    scene = Scenario(time_of_day_s=(6 + index) * 3600.0, shadows=arm == 'shadows')
    rho = 0.5 if arm == 'shadows' else 0.7
    return RunRow(
        run_id=f'r-{index}', index=index, program='halton_time_of_day', seed=0,
        perception='original', outcome=Outcome.PASS,
        robustness=exact_intervals({'phi_eventually': rho}),
        left_runway=False, max_cross_track_m=1.0, settle_time_s=3.0, **scene.to_human(),
    )
