"""A small campaign on disk, as `taxinet run` leaves one without bags."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from campaign_records import write_campaign

import taxinet_ros as tx
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.trials.record.row import RunRow

CROSS_TRACKS_M = (0.5, 7.0, -1.0)
SPEC = 'phi_always'


def row_of(index: int, run: tx.Run) -> RunRow:
    request = RunRequest(
        run_id=f'run-{index}', index=index, program='light', seed=5, scenario=run.scenario,
        judging=Judging(specs=(SPEC,)), participants=(),
    )
    result = RunResult(
        outcome=run.outcome, last_seq=len(run.steps) - 1, statistics=run.statistics,
        robustness=run.rho, wall_s=1.0,
    )
    return RunRow.of_run(
        request, result, perception=run.perception, sim_s=run.scenario.duration_s,
    )


@pytest.fixture
def campaign_folder(tmp_path: Path) -> Path:
    """Three runs on the truth, the second of which begins off the centreline and fails."""
    runs = [
        tx.run(tx.Scenario(cross_track_m=start, duration_s=2.0), specs=SPEC)
        for start in CROSS_TRACKS_M
    ]
    return write_campaign(tmp_path / 'campaign', itertools.starmap(row_of, enumerate(runs)), {
        'program': 'light', 'seed': 5, 'runs': 3, 'perception': 'truth',
        'specs': {SPEC: tx.Spec.parse(SPEC).text},
    })
