"""Progress bars of long commands (terminals only), and the rows known when a record is lost."""

from __future__ import annotations

import contextlib
import datetime
import itertools
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.atomic import disk_words
from taxinet_ros.processes.interrupts import ToldInterrupt, interrupts
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.summary import Summary, row_line

_PAGE_WIDTH = 100
HEARTBEAT = 'TAXINET_HEARTBEAT_S'
"""Environment variable: seconds between the lines that say how far a command is; 0 for none."""
_HEARTBEAT_S = 10.0


@contextlib.contextmanager
def print_rows_if_lost(
    console: Console, found: Summary, rows: Sequence[RunRow] = ()
) -> Iterator[None]:
    """Context in which a campaign is recorded; on a write error, print the rows known so far.

    Args:
        console: console to print to.
        found: summary of the campaign, as its rows come.
        rows: those that are not printed as they come.

    Raises:
        RecordError: for every operating system error during the campaign; it is not a usage error.
    """
    try:
        yield
    except (OSError, RecordError) as error:
        lines = map(row_line, rows)
        for line in [*lines, f'known until then: {found.count_words() or "nothing"}']:
            console.print(line, soft_wrap=True)
        if isinstance(error, RecordError):
            raise
        raise RecordError(f'{error.filename or "output"}: {disk_words(error)}') from error


@contextlib.contextmanager
def stage_bars(console: Console) -> Iterator[Callable[[str, int, int], None]]:
    """Return a callback of stage, done and total; each stage gets a bar when it starts.

    Without a terminal, a line on standard error says every ten seconds how far it is
    (``TAXINET_HEARTBEAT_S``).
    """
    if not console.is_terminal:
        yield Heartbeat()
        return
    bars: dict[str, TaskID] = {}
    with Progress(
        TextColumn('{task.description:<9}'), BarColumn(), MofNCompleteColumn(),
        TimeRemainingColumn(), console=console,
    ) as progress:

        def show(stage: str, done: int, total: int) -> None:
            if stage not in bars:
                bars[stage] = progress.add_task(stage, total=total)
            progress.update(bars[stage], completed=done)

        yield show


@contextlib.contextmanager
def count_bar(console: Console, stage: str, total: int) -> Iterator[Callable[[], None]]:
    """Return a function to call after each of a number of equal pieces of work."""
    done = itertools.count(1)
    with stage_bars(console) as show:
        def count() -> None:
            number = next(done)
            show(stage, number, max(total, number))

        yield count


@contextlib.contextmanager
def trial_bar(
    console: Console, stage: str, total: int
) -> Iterator[tuple[Callable[[], None], Callable[[], bool]]]:
    """Return a function to call after each trial, and whether Ctrl-C has asked to start no more.

    Raises:
        ToldInterrupt: trials are left, and it is told so.
    """
    asked: list[bool] = []
    try:
        with count_bar(console, stage, total) as count, interrupts(lambda: asked.append(True)):
            yield count, lambda: bool(asked)
    except KeyboardInterrupt:
        console.print('interrupted; the same command goes on')
        raise ToldInterrupt from None


class Heartbeat:
    """Says on standard error, now and then, how far a command is whose output is not a terminal."""

    def __init__(self) -> None:
        self._stage, self._first, self._open = '', 0, False
        self._began = self._told = time.monotonic()
        self._every_s = _heartbeat_s()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Tell of ``done`` of ``total`` in a stage, unless something was told just before."""
        now = time.monotonic()
        if stage != self._stage:
            self._stage, self._began, self._first, self._open = stage, now, done, False
        # The end of what was told of is told too, or it would seem to have stopped.
        if now - self._told < self._every_s and not (self._open and done == total):
            return
        self._told, self._open = now, done != total
        left = ''
        if self._first < done < total:
            seconds = round((now - self._began) * (total - done) / (done - self._first))
            left = f', about {datetime.timedelta(seconds=seconds)} left'
        how_far = f': {done} of {total}{left}' if total else ''
        print(f'{stage}{how_far}', file=sys.stderr, flush=True)


def _heartbeat_s() -> float:
    text = os.environ.get(HEARTBEAT) or str(_HEARTBEAT_S)
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not seconds >= 0:
        raise UsageError(f'{HEARTBEAT}={text}: expected seconds, 0 for no lines')
    return seconds or math.inf
