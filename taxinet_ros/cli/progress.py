"""Bars for the stages of a long command; only a terminal gets to see them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)


@contextlib.contextmanager
def stage_bars(console: Console) -> Iterator[Callable[[str, int, int], None]]:
    """A function to call with stage, done and total; each stage gets a bar when it begins."""
    bars: dict[str, TaskID] = {}
    with Progress(
        TextColumn('{task.description:<9}'), BarColumn(), MofNCompleteColumn(),
        TimeRemainingColumn(), console=console, disable=not console.is_terminal,
    ) as progress:

        def show(stage: str, done: int, total: int) -> None:
            if stage not in bars:
                bars[stage] = progress.add_task(stage, total=total)
            progress.update(bars[stage], completed=done)

        yield show
