"""Run the unfinished stages of a study one after the other, and record the state of each."""

from __future__ import annotations

import contextlib
import datetime
import math
import os
import shlex
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any, Self

from taxinet_ros.bag.errors import BagError
from taxinet_ros.core.provenance import Provenance, begun_elsewhere, provenance
from taxinet_ros.errors import ExitCode, InfraError, UsageError
from taxinet_ros.files.plain_values import typed
from taxinet_ros.files.record import (
    RECORD_NAME,
    Entries,
    Record,
    read_record,
    repair_record,
    repaired,
)
from taxinet_ros.processes.interrupts import interrupts_received
from taxinet_ros.study.stages.config import StudyConfig
from taxinet_ros.study.stages.stage import Resume, Stage
from taxinet_ros.training.data.unfinished import is_begun
from taxinet_ros.trials.options import AUDIT
from taxinet_ros.trials.record.facts import is_campaign
from taxinet_ros.trials.record.table import PARQUET_NAME, read_table
from taxinet_ros.version import __version__

STAGE, OPTIONS = 'stage', 'options'
"""Kinds of entries: a stage by its name, and the options by the study's command."""


@dataclass(frozen=True, kw_only=True)
class StageRecord:
    """Recorded state of one stage.

    Attributes:
        identity: identity of the last start (:meth:`.stage.Stage.identity`), '' if never started.
        key, outputs: those of the last completion; '' and empty if it is not done.
        runs: number of runs requested by the last start.
        wall_s: wall time of all sittings since it was last started afresh [s].
        sittings: number of these sittings. A killed one has left no time.
        killed: whether one was killed.
        begun: whether a sitting has begun and not ended.
        facts: facts of its last end: date, cores, workers, version.
        stacks: machine, libraries and code of each sitting; empty if not recorded.
        skipped: reason why there was nothing to do, or ''.
    """

    identity: str = ''
    key: str = ''
    outputs: Mapping[str, str] = field(default_factory=dict)
    runs: int = 0
    wall_s: float = 0.0
    sittings: int = 0
    killed: bool = False
    begun: bool = False
    facts: Mapping[str, Any] = field(default_factory=dict)
    skipped: str = ''
    stacks: tuple[Provenance, ...] = ()

    def started(self, identity: str, runs: int, *, resumed: bool) -> Self:
        """The state at the start of a sitting."""
        before = self if resumed else type(self)()
        return replace(
            before, identity=identity, runs=runs, killed=before.killed or before.begun,
            key='', outputs={}, skipped='', begun=True, stacks=(*before.stacks, provenance()),
        )

    def stopped(self, wall_s: float) -> Self:
        """The state at the end of a sitting that did not complete it."""
        return replace(
            self, wall_s=self.wall_s + wall_s, sittings=self.sittings + 1, begun=False)

    def done(
        self, key: str, outputs: Mapping[str, str], wall_s: float, workers: int, skipped: str = ''
    ) -> Self:
        """The state at its completion."""
        return replace(self.stopped(wall_s), key=key, outputs=outputs, skipped=skipped, facts={
            'date': datetime.datetime.now(datetime.UTC).isoformat(timespec='seconds'),
            'cores': len(os.sched_getaffinity(0)), 'workers': workers, 'version': __version__,
        })


Stages = Mapping[str, StageRecord]
"""Recorded states by name of the stage."""


@contextlib.contextmanager
def open_study(out: Path, show: Callable[[str], None]) -> Iterator[Record]:
    """Context of the open record of a study, for one command at a time.

    Of a damaged one the intact entries are kept; the stages that it lacks are made again. If stages
    were made on another machine or version, a line says so.

    Args:
        out: folder of the study.
        show: prints a line.

    Raises:
        UsageError: another command has it open, or it cannot be read.
    """
    path = out / RECORD_NAME
    if line := repair_record(path):
        show(line)
    with Record(path) as record:
        if record.entries.keys() & {STAGE, OPTIONS}:
            repaired(record)
            if warning := stack_warning(_stages_of(record.entries)):
                show(warning)
        yield record


def stack_warning(records: Stages) -> str:
    """Warning if a stage was started on another machine or version than this; else ''."""
    before = [stack for record in records.values() for stack in record.stacks]
    return begun_elsewhere(before, provenance(), 'all the stages so far')


def read_stages(out: Path) -> dict[str, StageRecord]:
    """Read the state of each stage by name; also possible while the study is running.

    Raises:
        UsageError: the record is damaged.
    """
    path = out / RECORD_NAME
    return _stages_of(read_record(path)) if path.exists() else {}


def _stages_of(entries: Entries) -> dict[str, StageRecord]:
    return {
        name: typed(StageRecord, values) for name, values in entries.get(STAGE, {}).items()
    }


def read_options(out: Path, command: str, option: str) -> dict[str, Any]:
    """Read the options of the study in ``out``.

    Args:
        out: folder of the study.
        command: its command.
        option: option that needs them, for the error message.

    Raises:
        UsageError: it has no such study, or the record is damaged.
    """
    path = out / RECORD_NAME
    found = read_record(path).get(OPTIONS, {}) if path.is_file() else {}
    if command not in found:
        raise UsageError(
            f'{option}: {out}: no study of taxinet {command}; name the folder of one as out'
        )
    return dict(found[command])


def claim_study(record: Record, command: str, about: Mapping[str, Any]) -> None:
    """Note what a new record is about, or check that it is about this.

    Args:
        record: the open record.
        command: the study's command.
        about: its subject, as options.

    Raises:
        UsageError: it is about something else.
    """
    before = record.entries.get(OPTIONS, {})
    if before.get(command, about) != about or (not before and record.entries.keys() - {STAGE}):
        raise UsageError(
            f'out {record.path.parent}: is about something else; choose another folder')
    record.put(OPTIONS, command, about)


class State(Enum):
    """State of a stage."""

    DONE = 'done'
    BEGUN = 'begun'
    STALE = 'other'
    """Its folder contains results of another command, other inputs or another version."""
    OPEN = 'to do'


def state_of(stage: Stage, records: Stages, out: Path) -> State:
    """State of a stage, from its current dependencies and the contents of its folder.

    Raises:
        UsageError: a program, an experiment or a network cannot be read.
    """
    record = records.get(stage.name, StageRecord())
    folder = out / stage.name
    there = folder.is_dir() and any(folder.iterdir())
    if not stage.ready(out):
        return State.STALE if there else State.OPEN
    if record.key and record.key == stage.key(out) and stage.results(out) == record.outputs:
        return State.DONE
    if not there:
        return State.OPEN
    return State.BEGUN if record.identity == stage.identity(out) else State.STALE


def can_resume(folder: Path) -> bool:
    """Whether there is a campaign, an arm of an experiment, or an unfinished training."""
    return any(
        is_campaign(place) or is_begun(place)
        for place in (folder, *folder.glob('*/'))
    )


def study_heading(config: StudyConfig, found: Sequence[Stage], out: Path) -> str:
    """Display text of the planned work."""
    size = '' if config.scale == 1 else f'scale {config.scale:g}, '
    return (
        f'case study in {len(found)} stages: {size}{config.images:,} images and {config.epochs} '
        f'epochs a network, {config.runs:,} runs each, {workers_words(config.workers)} -> {out}'
    )


def stage_line(number: str, stage: Stage, *, resume: bool = False) -> str:
    """Display text with number, name and command of a stage."""
    command = shlex.join(['taxinet', *stage.words(resume=resume)])
    return f'[{number}] {stage.name}: {command}'


def list_lines(found: Sequence[Stage], records: Stages, out: Path) -> list[str]:
    """One line per stage with its state and command."""
    width = max(len(stage.name) for stage in found)
    lines = []
    for number, stage in enumerate(found, 1):
        state = state_of(stage, records, out)
        words = f'{state.value:<5}'
        if state is State.DONE:
            words += f' in {clock(records[stage.name].wall_s)}'
        command = shlex.join(['taxinet', *stage.words()])
        lines.append(f'{number:2d}  {stage.name:<{width}}  {words:<17}  {command}')
    return lines


def workers_words(workers: int) -> str:
    """Display text such as ``2 workers``."""
    return '1 worker' if workers == 1 else f'{workers} workers'


def clock(seconds: float) -> str:
    """Display text of a duration, such as ``1:02:03``."""
    whole = round(seconds)
    return f'{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}'


def rough_duration(seconds: float) -> str:
    """Display text of an approximate duration, such as ``3 h 20 min``."""
    minutes = math.ceil(seconds / 60)
    if minutes < 90:
        return f'{minutes} min'
    hours, minutes = divmod(10 * round(minutes / 10), 60)
    return f'{hours} h {minutes} min' if minutes else f'{hours} h'


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
        again: str = 'resuming', numbers: Iterator[int] | None = None,
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
                    f'{stage.runs:,} asked for now; ask for as many, or name another folder'
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
