"""Run the unfinished stages of a study one after the other, each as a process."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from taxinet_ros.campaign.options import AUDIT
from taxinet_ros.campaign.record.table import PARQUET_NAME, read_table
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.atomic import STUDY_OUT
from taxinet_ros.processes.child import ChildProcess, exit_words, package_environment
from taxinet_ros.processes.interrupts import interrupts
from taxinet_ros.study.stages.log import StageLog, stack_warning
from taxinet_ros.study.stages.progress import (
    State,
    can_resume,
    clock,
    seconds_left,
    stage_line,
    state_of,
    time_line,
)
from taxinet_ros.study.stages.stage import Resume, Stage

_ERROR = 'taxinet: error: '
_REFUSED = (ExitCode.USAGE, ExitCode.INCOMPLETE, ExitCode.INFRA)
_GRACE_S = 20.0
"""Time [s] from a second request to end until a command is killed."""


def run_command(
    command: Sequence[str], out: Path, folder: Path, log: Path | None = None
) -> tuple[int, bool, str]:
    """Run a command to its end.

    It runs in its own process group, so that it receives Ctrl-C only through us, and only once: the
    first one ends it in order, the second one immediately.

    Args:
        command: the program with its arguments.
        out: folder of the study, which it does not make anew.
        folder: working directory.
        log: file to which its output is appended; None: it is shown.

    Returns:
        Its exit code, negative for the signal that killed it; whether we were interrupted; and the
        last line of its log, '' without one.
    """
    asked: list[bool] = []
    with ChildProcess(
        'stage', command, folder=folder, new_session=False, log=log,
        environment={**package_environment(), STUDY_OUT: str(out.absolute())},
    ) as child:

        def pass_on() -> None:
            asked.append(True)
            child.process.send_signal(signal.SIGINT)

        try:
            with interrupts(pass_on):
                child.wait()
        except KeyboardInterrupt:
            asked.append(True)
            child.process.send_signal(signal.SIGINT)
            child.wait(_GRACE_S)
    assert child.code is not None
    return child.code, bool(asked), child.last_line()


class StudyRun:
    """One sitting of a study.

    Attributes:
        refused: reason for each optional stage that was refused.
    """

    def __init__(
        self, out: Path, found: Sequence[Stage], *, log: StageLog, command: Sequence[str],
        workers: int, show: Callable[[str], None], folder: Path | None = None,
        logs: Path | None = None, again: str = '--resume',
    ) -> None:
        """Prepare the sitting; nothing is started yet.

        Args:
            out: folder of the study.
            found: the requested stages.
            log: log of the stages.
            command: program that accepts a stage's words.
            workers: processes per stage, to estimate the remaining time.
            show: prints a line.
            folder: working directory of the commands; None: the study's folder.
            logs: existing folder for what the commands print; None: it is shown.
            again: what continues the study, for messages.
        """
        self.refused: dict[str, str] = {}
        self._folder = folder or out
        self._logs = logs
        self._again = again
        self._out = out
        self._stages = tuple(found)
        self._log = log
        self._command = tuple(command)
        self._workers = workers
        self._show = show

    def run(self) -> int:
        """Run the unfinished stages.

        Returns:
            Exit code: 0 if all are done, 130 if interrupted, else that of the failed stage.

        Raises:
            UsageError: a stage cannot be started.
            RecordError: the study's folder was moved or deleted.
        """
        self._check_runs()
        if warning := stack_warning(self._log.records):
            self._show(warning)
        self._began = time.monotonic()
        for number, stage in enumerate(self._stages, 1):
            state = state_of(stage, self._log.records, self._out)
            if state is State.DONE:
                took = clock(self._log.records[stage.name].wall_s)
                self._show(f'[{number}/{len(self._stages)}] {stage.name}: done, kept ({took})')
                continue
            code = self._stage(number, stage, state)
            if code:
                return code
        return ExitCode.OK

    def _check_runs(self) -> None:
        """Check that no campaign would shrink; none is discarded."""
        for stage in self._stages:
            record = self._log.records.get(stage.name)
            if record is None or not stage.runs or record.runs <= stage.runs:
                continue
            if stage.ready(self._out) and record.identity == stage.identity(self._out):
                raise UsageError(
                    f'{self._out / stage.name}: was begun with {record.runs:,} runs, more than the '
                    f'{stage.runs:,} asked for now; ask for as many, or name another --out'
                )

    def _stage(self, number: int, stage: Stage, state: State) -> int:
        """Run one stage; return 0 if it is done."""
        self._log.check_in_place()
        resume = self._make_room(stage, state)
        rest = self._stages[number - 1:]
        left_s = seconds_left(rest, self._stages, self._log.records, self._workers)
        self._show('')
        self._show(stage_line(number, self._stages, resume=resume))
        self._show(time_line(time.monotonic() - self._began, left_s))
        key = stage.key(self._out)
        self._log.write('begin', stage.name, identity=stage.identity(self._out), runs=stage.runs,
                        resumed=resume)
        if why := self._nothing_to_do(stage):
            self._show(why)
            self._log.write('end', stage.name, key=key, outputs={}, wall_s=0.0, skipped=why)
            return ExitCode.OK
        words = stage.command(resume=resume)
        begun = time.monotonic()
        output = self._logs and self._logs / f'{stage.name}.log'
        code, interrupted, said = run_command(
            [*self._command, *words], self._out, self._folder, output
        )
        wall_s = time.monotonic() - begun
        self._log.check_in_place()  # first, so that no missing file is reported instead
        trouble = self._trouble(stage, code)
        if trouble:
            self._log.write('stopped', stage.name, wall_s=wall_s, code=code)
            if stage.optional and not interrupted and code in _REFUSED:
                self.refused[stage.name] = said.removeprefix(_ERROR) or trouble
                self._show(f'{stage.name}: not done: {self.refused[stage.name]}')
                return ExitCode.OK
            trouble = f'{trouble}: {said}' if said else trouble
            return self._stopped(stage, code, trouble, interrupted=interrupted)
        self._log.write('end', stage.name, key=key, outputs=stage.results(self._out),
                        wall_s=wall_s, code=code, command=list(words), workers=self._workers)
        if interrupted:
            self._show(f'interrupted after {stage.name}; {self._again} goes on')
            return ExitCode.INTERRUPTED
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
        outcomes = read_table(self._out / stage.needs_failures)['outcome']
        if (outcomes == 'FAIL').any():
            return ''
        return f'none of the {len(outcomes)} runs of {stage.needs_failures} failed: nothing to do'

    def _trouble(self, stage: Stage, code: int) -> str:
        """Reason why a stage that has ended is not done; '' if it is done."""
        if code not in stage.accepts:
            return exit_words(code)
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

    def _stopped(self, stage: Stage, code: int, trouble: str, *, interrupted: bool) -> int:
        if interrupted or code in (ExitCode.INTERRUPTED, ExitCode.TERMINATED):
            self._show(f'interrupted in {stage.name}; {self._again} goes on')
            return ExitCode.INTERRUPTED
        self._show(f'stopped at {stage.name}: {trouble}; once it is mended, {self._again} goes on')
        return code if code > 0 and code not in stage.accepts else ExitCode.INFRA


def _unused_name(folder: Path) -> Path:
    number = 1
    while (aside := folder.with_name(f'{folder.name}.before-{number}')).exists():
        number += 1
    return aside
