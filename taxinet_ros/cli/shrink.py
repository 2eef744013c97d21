"""``taxinet shrink``: from a failed run, the nearest to plain taxiing that still fails."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Column

from taxinet_ros.campaign.crew import Crew
from taxinet_ros.campaign.interrupts import interrupts
from taxinet_ros.campaign.lines import row_line, scene_words
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.search_loop import run_search
from taxinet_ros.campaign.shrink import End
from taxinet_ros.campaign.shrink_lines import (
    finding_lines,
    parameter_table,
    result_lines,
    run_command,
    shrink_heading,
)
from taxinet_ros.campaign.shrink_options import ShrinkOptions
from taxinet_ros.campaign.shrink_report import Report, report
from taxinet_ros.campaign.shrinking import Shrinking
from taxinet_ros.cli.progress import told_if_lost
from taxinet_ros.core.errors import InfraError, UsageError
from taxinet_ros.nodes.domain import check_workers
from taxinet_ros.nodes.graph import campaign_graph
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.nodes.worker import worker_command


def run_shrink(options: ShrinkOptions, *, quiet: bool) -> int:
    """Shrink it, write down what came of it, and print that.

    Args:
        options: what to do.
        quiet: print the outcome only.

    Returns:
        Exit code: 0 shrunk, 130 interrupted.

    Raises:
        UsageError: bad input, or the run does not fail again.
        InfraError: the bench broke.
        RecordError: the record cannot be kept.
    """
    check_workers(options.workers)
    console = Console(highlight=False)
    begun = time.monotonic()
    with _view(console, quiet=quiet) as show:
        shrinking = Shrinking(options, PARTICIPANTS, show)
        shown = not (quiet or console.is_terminal)
        with told_if_lost(console, shrinking.rows, shown=shown), shrinking:
            if shrinking.warning:
                console.print(shrinking.warning, soft_wrap=True, markup=False)
            if not quiet:
                console.print(shrink_heading(options), soft_wrap=True)
            with (
                interrupts(shrinking.interrupt),
                Crew(_command(shrinking), options.workers, options.campaign.out / 'logs') as crew,
            ):
                run_search(shrinking, crew)
    found = report(shrinking)
    _check_bench(shrinking)
    _check_reproduced(options, found)
    with told_if_lost(console, shrinking.rows, shown=True):
        _print(console, shrinking, found, time.monotonic() - begun)
    return 130 if found.state.end is End.NOT_YET else 0


def _print(console: Console, shrinking: Shrinking, found: Report, wall_s: float) -> None:
    options, runs = shrinking.options, len(shrinking.rows)
    lines = result_lines(found, options, runs, wall_s)
    if found.original is not None:
        from taxinet_ros.analysis.shrunk import PROGRAM_NAME, write_shrunk

        out = options.campaign.out
        names = write_shrunk(options, found, runs)
        console.print(parameter_table(found))
        console.print('\n'.join(finding_lines(found)), soft_wrap=True)
        lines.append(f'written: {out / names[0]}, {", ".join(names[1:])}')
        lines.append(f'run it: {run_command(options, str(out / PROGRAM_NAME))}')
    console.print('\n'.join(lines), soft_wrap=True)


def _check_bench(shrinking: Shrinking) -> None:
    if (row := shrinking.broken) is not None:
        detail = f'{row.detail or row.outcome} (twice in run {row.run_id}; --resume goes on)'
        raise InfraError(row.kind or 'broken', row.who or 'bench', row.steps - 1, detail)


def _check_reproduced(options: ShrinkOptions, found: Report) -> None:
    if found.state.end is not End.NOT_REPRODUCED:
        return
    assert found.original is not None
    name = options.headline
    before = f', it had {options.run.rho[name]:+.2f}' if name in options.run.rho else ''
    raise UsageError(
        f'{options.run.run_id}: not reproduced: run again, {name} has rho '
        f'{found.original.rho[name]:+.2f}{before}; recorded by another version, or with another '
        'perception or other gains?'
    )


def _command(shrinking: Shrinking) -> list[str]:
    campaign = shrinking.options.campaign
    return worker_command(campaign_graph(campaign, shrinking.controller_sha256))


@contextlib.contextmanager
def _view(console: Console, *, quiet: bool) -> Iterator[Callable[[RunRow], None]]:
    """What shows a run that has ended: a line of its own; in a terminal one line for them all."""
    live = console.is_terminal and not quiet
    with Progress(
        SpinnerColumn(), TextColumn('{task.completed} runs'), TimeElapsedColumn(),
        TextColumn('{task.description}', table_column=Column(no_wrap=True, ratio=1)),
        console=console, transient=True, expand=True, disable=not live,
    ) as progress:
        task = progress.add_task('', total=None)

        def show(row: RunRow) -> None:
            # A terminal has the bar for what goes as it should.
            if not quiet and (not live or not row.outcome.judged):
                progress.console.print(row_line(row), soft_wrap=True)
            progress.update(task, advance=1, description=f'{row.outcome} {scene_words(row)}')

        yield show
