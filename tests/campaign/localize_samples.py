"""Campaigns of failed runs, made in this process, to be looked into."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from taxinet_ros.campaign.ledger import Ledger
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.trials import Bench, Task, Trial, make_trial
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.perception import check_perception, make_perception
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.substituted_perception import AS_RECORDED

SPEC = 'phi_eventually'
FORMULA = 'eventually[0:10](always(abs(cte) <= 1.5))'
WET = scenario_from_human({
    'cross_track': 5, 'heading': 20, 'distance': 600, 'clouds': 'stratus', 'rain': 90,
    'time_of_day': 8, 'duration': 12,
})
OFF = [
    scenario_from_human({'cross_track': 5, 'heading': heading, 'duration': 11})
    for heading in (10, 15, 20)
]
"""With a nose wheel that never turns they go on and on to the left."""

LOCKED = {'heading_gain': 0.0}


def row_of(trial: Trial, scene: Scenario, index: int, perception: str) -> RunRow:
    return RunRow(
        run_id=trial.run_id, index=index, program='s_falsif', seed=3, perception=perception,
        perception_fingerprint=check_perception(perception), sampler='random', weight=1.0,
        **scene.to_human(), outcome=Outcome.PASS if trial.passed else Outcome.FAIL,
        rho={SPEC: trial.rho_lower}, stopped_early=False, left_runway=trial.left_runway,
        max_cross_track_m=trial.max_cross_track_m, settle_time_s=trial.settle_time_s,
    )


def failed_campaign(
    folder: Path, scenes: Sequence[Scenario], *, perception: str = 'truth',
    gains: Mapping[str, float] = LOCKED, **changes: Any,
) -> list[RunRow]:
    """Run scenes as they are, and write down the ledger of a campaign of them."""
    bench = Bench(perception=perception, specs=(f'{SPEC}={FORMULA}',), gains=gains)
    network = make_perception(perception)
    rows = []
    for index, scene in enumerate(scenes):
        task = Task(run_id=f'run-{index}', scenario=scene, word=AS_RECORDED, seed=(3, index))
        row = row_of(make_trial(task, bench, network), scene, index, perception)
        rows.append(dataclasses.replace(row, **changes))
    folder.mkdir()
    with Ledger(folder / 'ledger.jsonl') as ledger:
        ledger.campaign({
            'program': 's_falsif.scenic', 'seed': 3, 'runs': len(rows), 'perception': perception,
            'specs': {SPEC: FORMULA}, 'gains': dict(gains), 'stop_on': 'never',
        })
        for row in rows:
            ledger.result(row)
    return rows
