"""Small studies for tests, run with a stand-in for ``taxinet``."""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

from taxinet_ros.study.stages.config import StudyConfig, read_config, scaled, shipped_config
from taxinet_ros.study.stages.log import StageLog
from taxinet_ros.study.stages.plan import stages
from taxinet_ros.study.stages.run import StudyRun

STAND_IN = [sys.executable, '-S', str(Path(__file__).with_name('stand_in.py'))]


def smoke_config() -> StudyConfig:
    """The shipped study at its smallest."""
    return scaled(read_config(shipped_config()), 0.005)


def run_study(out: Path, config: StudyConfig | None = None) -> tuple[int, list[str]]:
    """Run a study; its exit code and the lines that it printed."""
    config, lines = config or smoke_config(), []
    out.mkdir(exist_ok=True)
    for runs in {config.runs, config.learning_runs}:
        failed = {'flawless': ['PASS'] * runs, 'half': ['PASS', 'FAIL'] * (runs // 2)}
        for kind, outcome in failed.items():
            table = pd.DataFrame({'index': range(runs), 'outcome': outcome, 'kind': ''})
            table.to_parquet(out / f'{kind}-{runs}.parquet')
    with StageLog(out) as log:
        run = StudyRun(
            out, stages(config), log=log, command=STAND_IN, workers=2, show=lines.append,
        )
        return run.run(), lines


def asked(out: Path) -> list[str]:
    """Commands that were run since this was asked last."""
    path = out / 'asked.txt'
    lines = path.read_text().splitlines() if path.exists() else []
    path.unlink(missing_ok=True)
    return lines


def sittings_of(out: Path, stage: str) -> int:
    """How often a stage was at work, as its log has it."""
    with StageLog(out) as log:
        return log.records[stage].sittings
