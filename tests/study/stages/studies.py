"""Small studies for tests, whose stages leave behind what theirs would, in no time.

What was asked goes to ``asked.txt``. ``fail.txt`` names a folder at which a stage is refused;
``wait.txt`` one at which it waits for Ctrl-C, with half of its record written; ``flawless.txt`` a
campaign without failures.
"""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path

import pandas as pd

from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.processes.interrupts import interrupts
from taxinet_ros.study.stages.config import StudyConfig, read_config, scaled, shipped_config
from taxinet_ros.study.stages.plan import stages
from taxinet_ros.study.stages.run import StoppedError, StudyRun, open_study, read_stages
from taxinet_ros.study.stages.stage import Stage


def smoke_config() -> StudyConfig:
    """The shipped study at its smallest."""
    return scaled(read_config(shipped_config()), 0.005)


def run_study(
    out: Path, config: StudyConfig | None = None, work=None, lines: list[str] | None = None
) -> tuple[int, list[str]]:
    """Run a study; its exit code and the lines that it printed."""
    config, lines = config or smoke_config(), [] if lines is None else lines
    out.mkdir(exist_ok=True)
    for runs in {config.runs, config.learning_runs}:
        failed = {'flawless': ['PASS'] * runs, 'half': ['PASS', 'FAIL'] * (runs // 2)}
        for kind, outcome in failed.items():
            table = pd.DataFrame({'index': range(runs), 'outcome': outcome, 'kind': ''})
            table.to_parquet(out / f'{kind}-{runs}.parquet')
    with open_study(out, lines.append) as record:
        run = StudyRun(
            out, stages(config), record=record, work=work or stand_in, workers=2,
            show=lines.append,
        )
        try:
            run.run()
        except StoppedError as stopped:
            return stopped.code, lines
    return 0, lines


def asked(out: Path) -> list[str]:
    """Commands of the stages that were called since this was asked last."""
    path = out / 'asked.txt'
    lines = path.read_text().splitlines() if path.exists() else []
    path.unlink(missing_ok=True)
    return lines


def sittings_of(out: Path, stage: str) -> int:
    """How often a stage was at work, as the record has it."""
    return read_stages(out)[stage].sittings


def stand_in(stage: Stage, resume: bool) -> int:
    """Do as if, in the current folder."""
    with Path('asked.txt').open('a') as file:
        file.write(' '.join(stage.words(resume=resume)) + '\n')
    folder = Path(stage.name)
    if named('fail.txt') == stage.name:
        raise UsageError(f'{stage.name}: out of luck')
    if stage.command in ('falsify', 'experiment'):
        assert (folder / RECORD_NAME).exists() == resume
        with Record(folder / RECORD_NAME) as record:
            record.put('facts', '', {})
    if named('wait.txt') == stage.name:
        ended: list[bool] = []
        with interrupts(lambda: ended.append(True)):
            print('waiting', flush=True)
            while not ended:
                signal.pause()
        return 130
    if stage.command == 'falsify':
        kind = 'flawless' if named('flawless.txt') == stage.name else 'half'
        shutil.copy(f'{kind}-{stage.runs}.parquet', folder / 'runs.parquet')
        for name in ('learned.json', 'learned.scenic') if kind == 'half' else ():
            (folder / name).write_text('model runway_world\n')
        return 1
    for name in stage.outputs:
        Path(name).write_text(json.dumps({'asked': stage.words()}))
    return 0


def named(file: str) -> str:
    """What a file in this folder names, '' where there is none."""
    path = Path(file)
    return path.read_text() if path.exists() else ''
