"""Progress of a study: finished and outdated stages, remaining time, and their display text."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Sequence
from enum import Enum
from pathlib import Path

from taxinet_ros.campaign.record.facts import is_campaign
from taxinet_ros.study.stages.config import StudyConfig
from taxinet_ros.study.stages.record import StageRecord, Stages
from taxinet_ros.study.stages.stage import Kind, Stage
from taxinet_ros.training.data.dataset_folder import REQUEST

_DEFAULT_SECONDS = {Kind.RUNS: 3.5, Kind.TRIALS: 2.0, Kind.LOOKS: 0.0025, Kind.REPORT: 60.0}
"""Default time per unit on one core of a small machine, until the study has measured it [s]."""
_START_S = 5.0
"""Time that every stage takes before its work begins [s]."""
_SHARED_AMONG_WORKERS = (Kind.RUNS, Kind.TRIALS)
"""Kinds of work that are divided among workers."""


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
    there = _is_not_empty(out / stage.name)
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
        is_campaign(place) or (place / REQUEST).is_file()
        for place in (folder, *folder.glob('*/'))
    )


def seconds_left(
    rest: Iterable[Stage], found: Sequence[Stage], records: Stages, workers: int
) -> float:
    """Estimated duration of some stages [s].

    Args:
        rest: these stages.
        found: all stages; those done show the speed of this machine.
        records: records of all stages.
        workers: number of concurrent processes.
    """
    pace = {
        kind: one_s / (workers if kind in _SHARED_AMONG_WORKERS else 1)
        for kind, one_s in _DEFAULT_SECONDS.items()
    }
    pace |= _measured(found, records)
    return sum(_START_S + stage.amount * pace[stage.kind] for stage in rest)


def _measured(found: Sequence[Stage], records: Stages) -> dict[Kind, float]:
    """Wall time per unit of each kind, measured on the finished stages."""
    sums: dict[Kind, tuple[float, float]] = {}
    for stage in found:
        record = records.get(stage.name, StageRecord())
        if record.key and not record.killed and not record.skipped:
            wall_s, amount = sums.get(stage.kind, (0.0, 0.0))
            work_s = max(record.wall_s - _START_S, 0.2 * record.wall_s)
            sums[stage.kind] = (wall_s + work_s, amount + stage.amount)
    return {kind: wall_s / amount for kind, (wall_s, amount) in sums.items()}


def _is_not_empty(folder: Path) -> bool:
    return folder.is_dir() and any(folder.iterdir())


def study_heading(config: StudyConfig, found: Sequence[Stage], out: Path) -> str:
    """Display text of the planned work."""
    size = '' if config.scale == 1 else f'scale {config.scale:g}, '
    return (
        f'case study in {len(found)} stages: {size}{config.images:,} images and {config.epochs} '
        f'epochs a network, {config.runs:,} runs each, {workers_words(config.workers)} -> {out}'
    )


def stage_line(number: int, found: Sequence[Stage], *, resume: bool = False) -> str:
    """Display text with number, name and command of a stage."""
    stage = found[number - 1]
    command = shlex.join(['taxinet', *stage.words(resume=resume)])
    return f'[{number}/{len(found)}] {stage.name}: {command}'


def time_line(elapsed_s: float, left_s: float) -> str:
    """Display text of the elapsed and the remaining time."""
    return f'{clock(elapsed_s)} elapsed, about {rough_duration(left_s)} left'


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
