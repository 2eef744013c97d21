"""A small campaign on disk, as `taxinet run` leaves one without bags."""

from __future__ import annotations

from pathlib import Path

import pytest

import taxinet_ros as tx
from taxinet_ros.campaign.record.ledger import Ledger
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult

CROSS_TRACKS_M = (0.5, 7.0, -1.0)
SPEC = 'phi_always'


def keep_run(ledger: Ledger, index: int, run: tx.Run) -> None:
    """Put a run down in a ledger."""
    request = RunRequest(
        run_id=f'run-{index}', index=index, program='light', seed=5, scenario=run.scenario,
        judging=Judging(specs=(SPEC,)), participants=(),
    )
    result = RunResult(
        outcome=run.outcome, last_seq=len(run.steps) - 1, statistics=run.statistics,
        robustness=run.rho, wall_s=1.0,
    )
    ledger.intent(index, request.run_id)
    ledger.result(RunRow.of_run(
        request, result, perception=run.perception, sim_s=run.scenario.duration_s,
    ))


@pytest.fixture
def campaign_folder(tmp_path: Path) -> Path:
    """Three runs on the truth, the second of which begins off the centreline and fails."""
    folder = tmp_path / 'campaign'
    folder.mkdir()
    with Ledger(folder / 'ledger.jsonl') as ledger:
        ledger.campaign({
            'program': 'light', 'seed': 5, 'runs': 3, 'perception': 'truth',
            'specs': {SPEC: tx.Spec.parse(SPEC).text},
        })
        for index, cross_track_m in enumerate(CROSS_TRACKS_M):
            scenario = tx.Scenario(cross_track_m=cross_track_m, duration_s=2.0)
            keep_run(ledger, index, tx.run(scenario, specs=SPEC))
    return folder
