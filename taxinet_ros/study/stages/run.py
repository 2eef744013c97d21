"""Run the unfinished stages of a study one after the other."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from taxinet_ros.bag.errors import BagError
from taxinet_ros.errors import ExitCode, InfraError, UsageError
from taxinet_ros.files.record import Record
from taxinet_ros.processes.interrupts import interrupts_received
from taxinet_ros.study.stages.progress import (
    State,
    can_resume,
    clock,
    stage_line,
    state_of,
)
from taxinet_ros.study.stages.record import STAGE, StageRecord, read_stages
from taxinet_ros.study.stages.stage import Resume, Stage
from taxinet_ros.trials.options import AUDIT
from taxinet_ros.trials.record.table import PARQUET_NAME, read_table

Work = Callable[[Stage, bool], int]
"""Calls the function of a stage, to go on with it or not; its exit code."""
_INTERRUPTED = (ExitCode.INTERRUPTED, ExitCode.TERMINATED)


class StoppedError(Exception):
    """A stage is not done; ``code`` is the exit code of the command."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class StudyRun:
    """One sitting of a study.

    Attributes:
        refused: reason for each optional stage that was refused.
    """

    def __init__(
        self, out: Path, found: Sequence[Stage], *, record: Record, work: Work, workers: int,
        show: Callable[[str], None], folder: Path | None = None, logs: Path | None = None,
        again: str = '--resume', numbers: Iterator[int] | None = None,
        began: float | None = None,
    ) -> None:
        """Prepare the sitting; nothing is started yet.

        Args:
            out: folder of the study.
            found: the requested stages.
            record: the open record of the study.
            work: calls the function of a stage.
            workers: processes per stage, for the record.
            show: prints a line.
            folder: working directory of the stages; None: the study's folder.
            logs: existing folder for what the stages print; None: it is shown.
            again: what continues the study, for messages.
            numbers: numbers of the stages, where later ones depend on what is found; None: how
                many there are is known.
            began: when the command began, by the monotonic clock; None: now.
        """
        self.refused: dict[str, str] = {}
        self._folder = folder or out
        self._logs = logs
        self._again = again
        self._out = out
        self._stages = tuple(found)
        self._record = record
        self._work = work
        self._workers = workers
        self._show = show
        self._records = read_stages(out)
        self._numbers = numbers
        self._began = time.monotonic() if began is None else began

    def run(self) -> None:
        """Run the unfinished stages.

        Raises:
            StoppedError: a stage was interrupted, or has failed.
            UsageError: a stage cannot be started.
            RecordError: the study's folder was moved or deleted.
        """
        self._check_runs()
        for place, stage in enumerate(self._stages, 1):
            number = f'{place}/{len(self._stages)}' if self._numbers is None else (
                f'{next(self._numbers)}')
            state = state_of(stage, self._records, self._out)
            if state is State.DONE:
                took = clock(self._records[stage.name].wall_s)
                self._show(f'[{number}] {stage.name}: done, kept ({took})')
                continue
            if code := self._stage(number, stage, state):
                raise StoppedError(code)

    def _check_runs(self) -> None:
        """Check that no campaign would shrink; none is discarded."""
        for stage in self._stages:
            record = self._records.get(stage.name)
            if record is None or not stage.runs or record.runs <= stage.runs:
                continue
            if stage.ready(self._out) and record.identity == stage.identity(self._out):
                raise UsageError(
                    f'{self._out / stage.name}: was begun with {record.runs:,} runs, more than the '
                    f'{stage.runs:,} asked for now; ask for as many, or name another --out'
                )

    def _stage(self, number: str, stage: Stage, state: State) -> int:
        """Run one stage; return 0 if it is done."""
        self._record.check_in_place()
        resume = self._make_room(stage, state)
        self._show('')
        self._show(stage_line(number, stage, resume=resume))
        self._show(f'{clock(time.monotonic() - self._began)} elapsed')
        key = stage.key(self._out)
        record = self._records.get(stage.name, StageRecord()).started(
            stage.identity(self._out), stage.runs, resumed=resume)
        self._put(stage, record)
        if why := self._nothing_to_do(stage):
            self._show(why)
            self._put(stage, record.done(key, {}, 0.0, self._workers, why))
            return ExitCode.OK
        begun, before = time.monotonic(), interrupts_received()
        try:
            code = self._call(stage, resume=resume)
        except KeyboardInterrupt:
            code = ExitCode.INTERRUPTED
        except Exception as error:
            self._record.check_in_place()  # first, so that no missing file is reported instead
            self._put(stage, record.stopped(time.monotonic() - begun))
            if stage.optional and isinstance(error, (UsageError, InfraError, BagError)):
                return self._refuse(stage, str(error))
            self._show(f'stopped at {stage.name}; once it is fixed, {self._again} goes on')
            raise
        wall_s = time.monotonic() - begun
        interrupted = code in _INTERRUPTED or interrupts_received() > before
        self._record.check_in_place()
        if trouble := self._trouble(stage, code):
            self._put(stage, record.stopped(wall_s))
            if interrupted:
                self._show(f'interrupted in {stage.name}; {self._again} goes on')
                return ExitCode.INTERRUPTED
            if stage.optional:
                return self._refuse(stage, trouble)
            self._show(f'stopped at {stage.name}: {trouble}; once it is fixed, {self._again} '
                       'goes on')
            return ExitCode.INFRA if code in stage.accepts else code
        self._put(stage, record.done(key, stage.results(self._out), wall_s, self._workers))
        if interrupted:
            self._show(f'interrupted after {stage.name}; {self._again} goes on')
            return ExitCode.INTERRUPTED
        return ExitCode.OK

    def _call(self, stage: Stage, *, resume: bool) -> int:
        """Call the function of a stage; its output goes to its log, if there are logs."""
        with contextlib.ExitStack() as around:
            if self._logs is not None:
                log = around.enter_context((self._logs / f'{stage.name}.log').open('a'))
                around.enter_context(contextlib.redirect_stdout(log))
                around.enter_context(contextlib.redirect_stderr(log))
            around.enter_context(contextlib.chdir(self._folder))
            return self._work(stage, resume)

    def _put(self, stage: Stage, state: StageRecord) -> None:
        self._record.put(STAGE, stage.name, asdict(state))
        self._records[stage.name] = state

    def _refuse(self, stage: Stage, why: str) -> int:
        self.refused[stage.name] = why
        self._show(f'{stage.name}: not done: {why}')
        return ExitCode.OK

    def _make_room(self, stage: Stage, state: State) -> bool:
        """Move outdated results away; return whether the stage resumes."""
        folder = self._out / stage.name
        if state is State.BEGUN and stage.resume is Resume.OPTION and can_resume(folder):
            return True
        if state is State.BEGUN and stage.resume is Resume.SAME:
            return True
        if stage.resume is not Resume.REPLACE and folder.is_dir() and any(folder.iterdir()):
            aside = _unused_name(folder)
            folder.rename(aside)
            why = 'is of other inputs' if state is State.STALE else 'is not whole'
            self._show(f'{stage.name}: what was there {why}, kept as {aside.name}')
        folder.mkdir(exist_ok=True)
        return False

    def _nothing_to_do(self, stage: Stage) -> str:
        if stage.needs and not (self._out / stage.needs).is_file():
            return f'there is no {stage.needs}, for nothing was found: nothing to do'
        if not stage.needs_failures:
            return ''
        outcomes = read_table(self._out / stage.needs_failures / PARQUET_NAME)['outcome']
        if (outcomes == 'FAIL').any():
            return ''
        return f'none of the {len(outcomes)} runs of {stage.needs_failures} failed: nothing to do'

    def _trouble(self, stage: Stage, code: int) -> str:
        """Reason why a stage that has ended is not done; '' if it is done."""
        if code not in stage.accepts:
            return f'exit code {code}'
        missing = [name for name in stage.outputs if not (self._out / name).is_file()]
        if missing:
            return f'{missing[0]} is missing'
        table = f'{stage.name}/{PARQUET_NAME}'
        if table not in stage.outputs:
            return ''
        rows = read_table(self._out / table)
        if (rows['kind'] == AUDIT).any():
            return 'an audit found that loop and graph differ'
        if len(rows) < stage.runs:
            return f'{len(rows):,} of {stage.runs:,} runs were made'
        return ''


def _unused_name(folder: Path) -> Path:
    number = 1
    while (aside := folder.with_name(f'{folder.name}.before-{number}')).exists():
        number += 1
    return aside
