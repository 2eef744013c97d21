"""Progress of a study: finished and outdated stages, and their display text."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from enum import Enum
from pathlib import Path

from taxinet_ros.study.stages.config import StudyConfig
from taxinet_ros.study.stages.record import StageRecord, Stages
from taxinet_ros.study.stages.stage import Stage
from taxinet_ros.training.data.unfinished import is_begun
from taxinet_ros.trials.record.facts import is_campaign


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
        is_campaign(place) or is_begun(place)
        for place in (folder, *folder.glob('*/'))
    )


def _is_not_empty(folder: Path) -> bool:
    return folder.is_dir() and any(folder.iterdir())


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
