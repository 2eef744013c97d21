"""The lines that a case study prints: headings of stages, the list of them, how long it takes."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path

from taxinet_ros.study.config import StudyConfig
from taxinet_ros.study.progress import Records, State, state_of
from taxinet_ros.study.stage import Stage


def study_heading(config: StudyConfig, found: Sequence[Stage], out: Path) -> str:
    """What is about to be done."""
    size = '' if config.scale == 1 else f'scale {config.scale:g}, '
    return (
        f'case study in {len(found)} stages: {size}{config.images:,} images and {config.epochs} '
        f'epochs a network, {config.runs:,} runs each, {workers_words(config.workers)} -> {out}'
    )


def stage_line(number: int, found: Sequence[Stage], *, resume: bool = False) -> str:
    """Number, name and command of a stage."""
    stage = found[number - 1]
    command = shlex.join(['taxinet', *stage.command(resume=resume)])
    return f'[{number}/{len(found)}] {stage.name}: {command}'


def time_line(elapsed_s: float, left_s: float) -> str:
    """Time since the command was started, and about how much there is to come."""
    return f'{clock(elapsed_s)} gone, about {about(left_s)} to go'


def list_lines(found: Sequence[Stage], records: Records, out: Path) -> list[str]:
    """Every stage with how far it is, and its command."""
    width = max(len(stage.name) for stage in found)
    lines = []
    for number, stage in enumerate(found, 1):
        state = state_of(stage, records, out)
        words = f'{state.value:<5}'
        if state is State.DONE:
            words += f' in {clock(records[stage.name].wall_s)}'
        command = shlex.join(['taxinet', *stage.command()])
        lines.append(f'{number:2d}  {stage.name:<{width}}  {words:<17}  {command}')
    return lines


def workers_words(workers: int) -> str:
    """Such as ``2 workers``."""
    return '1 worker' if workers == 1 else f'{workers} workers'


def clock(seconds: float) -> str:
    """A time as ``1:02:03``."""
    whole = round(seconds)
    return f'{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}'


def about(seconds: float) -> str:
    """A time that is not known exactly, as ``3 h 20 min``."""
    minutes = math.ceil(seconds / 60)
    if minutes < 90:
        return f'{minutes} min'
    hours, minutes = divmod(10 * round(minutes / 10), 60)
    return f'{hours} h {minutes} min' if minutes else f'{hours} h'
