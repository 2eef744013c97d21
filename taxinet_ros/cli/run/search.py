"""``taxinet falsify``, ``experiment`` and ``shrink``: runs on a pool of worker processes."""

from __future__ import annotations

import contextlib
import datetime
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Column
from rich.text import Text

from taxinet_ros.analysis.search.learned import write_learned
from taxinet_ros.cli.progress import print_rows_if_lost
from taxinet_ros.cli.run.campaign import run_on_workers
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import ExitCode, InfraError, UsageError, plain_line
from taxinet_ros.files.atomic import write_parquet
from taxinet_ros.files.sealed_json import write_sealed
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.nodes.running.domain import check_workers
from taxinet_ros.trials.campaign import exit_code
from taxinet_ros.trials.cluster.pool import ClusterPool, campaign_cluster
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.experiment import (
    JSON_NAME,
    PAGE_NAME,
    PAIRS_NAME,
    Experiment,
    arm_rows,
    arm_searches,
    check_paired,
)
from taxinet_ros.trials.options import AUDIT, GRAPH, CampaignOptions
from taxinet_ros.trials.rates import failure_rate
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.search import Search
from taxinet_ros.trials.search_summary import heading_lines, search_summary
from taxinet_ros.trials.shrink.algorithm import End
from taxinet_ros.trials.shrink.report import (
    Report,
    finding_lines,
    make_report,
    parameter_table,
    result_lines,
    run_command,
    shrink_heading,
)
from taxinet_ros.trials.shrink.shrinking import Shrinking
from taxinet_ros.trials.summary import (
    Summary,
    requirement_lines,
    row_line,
    scene_words,
    summary_json,
)

_REFRESH_PER_S = 2.0


@contextlib.contextmanager
def search_view(console: Console, search: Engine[Any], *, shown: bool) -> Iterator[None]:
    """Context that shows the search live; with ``shown`` False, nothing."""
    columns = (
        BarColumn(bar_width=20), MofNCompleteColumn(), TimeElapsedColumn(), _Figures(search),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not shown,
        refresh_per_second=_REFRESH_PER_S,
    ) as progress:
        progress.add_task('', total=search.options.runs)
        yield


class _Figures(ProgressColumn):
    """Figures beside the bar: failures, pace, time left, lowest robustness, failure rate."""

    def __init__(self, search: Engine[Any]) -> None:
        super().__init__()
        self._search = search
        self._began = time.monotonic()
        self._before = len(search.rows)

    def render(self, task: Task) -> Text:
        """Render the current figures."""
        seen = self._search.summary
        task.completed = len(seen)
        worst = seen.worst
        least = math.nan if worst is None or worst.headline is None else worst.headline.upper
        minutes = (time.monotonic() - self._began) / 60
        pace = (len(seen) - self._before) / max(minutes, 1e-3)
        words = [f'{seen.outcomes[Outcome.FAIL]} failed', f'{pace:.1f}/min']
        if pace > 0:
            left = self._search.options.runs - len(seen)
            words.append(f'{datetime.timedelta(seconds=round(60 * left / pace))} left')
        if seen:
            words.append(f'lowest rho {least:+.2f}')
        # A viewer may stop at any time: use the interval that is valid at every look.
        planned = self._search.first_planned or range(0)
        found = failure_rate(seen.verdicts, range(planned.start, 0, planned.step)).rate
        if found is not None:
            words.append(f'failing {found.words()}')
        if self._search.interrupted:
            words.append('ending the current runs')
        return Text('  '.join(words))


def run_falsify(asked: Search, *, quiet: bool, as_json: bool = False) -> int:
    """Run the search and print the results.

    Args:
        asked: the search.
        quiet: print warnings and the summary only.
        as_json: print the summary as JSON; all else goes to standard error.

    Returns:
        Exit code: 0 all satisfied, 1 some violated, 4 infrastructure error, 130 interrupted.

    Raises:
        UsageError: bad input, or every scene was rejected.
    """
    check_workers(asked.campaign.workers)
    console = Console(highlight=False, stderr=as_json)
    with (
        _open_cluster(asked.campaign, console) as cluster,
        open_search(asked, console, quiet=quiet) as search,
    ):
        if search.book.warning:
            console.print(search.book.warning, soft_wrap=True, markup=False)
        if not quiet:
            lines = heading_lines(asked)
            console.print('\n'.join(lines), soft_wrap=True, markup=False)
        for line in requirement_lines(asked.check, quiet=quiet):
            console.print(line, soft_wrap=True)
        with search_view(console, search, shown=console.is_terminal and not quiet):
            run_on_workers(search, cluster)
        learned, planned = write_learned(search), search.first_planned
    lines = [*search_summary(search), *learned]
    console.print('\n'.join(lines), soft_wrap=True)
    if as_json:
        values = summary_json(search.summary, asked.campaign, planned)
        print(json.dumps({**values, 'sampler': asked.sampler}, allow_nan=False))
    if search.interrupted and len(search.rows) < search.options.runs:
        return ExitCode.INTERRUPTED
    return exit_code(search.summary)


@contextlib.contextmanager
def open_search(
    asked: Search, console: Console, *, quiet: bool
) -> Iterator[Engine[Search]]:
    """Context of an open search that prints its rows as they come, or all if its record is lost."""
    shown = not (quiet or console.is_terminal)
    show = partial(_print_row, console=console, quiet=quiet)
    search = Engine(asked, PARTICIPANTS, show)
    lost = print_rows_if_lost(console, search.summary, () if shown else search.rows.latest)
    with lost, search:
        yield search


def _print_row(row: RunRow, console: Console, *, quiet: bool) -> None:
    # On a terminal the bar covers normal results.
    if not quiet and not (console.is_terminal and row.outcome.judged):
        console.print(row_line(row), soft_wrap=True)


def _open_cluster(
    options: CampaignOptions, console: Console
) -> contextlib.AbstractContextManager[ClusterPool | None]:
    """Context of the connected cluster of a campaign, or of None."""
    if not options.cluster:
        return contextlib.nullcontext()

    def tell(line: str) -> None:
        console.print(plain_line(line), soft_wrap=True, markup=False)

    return campaign_cluster(options, options.cluster, tell=tell)


def run_experiment(
    experiment: Experiment, out: Path, *, workers: int, resume: bool, as_json: bool,
    engine: str = GRAPH, audit: str | None = None, cluster: str | None = None,
) -> int:
    """Run every arm, compare them, and print the result.

    Returns:
        Exit code: 0 done, 4 infrastructure error in some run, 130 interrupted; ``--resume``
            continues. The comparison is written only after every arm has all its runs.

    Raises:
        UsageError: bad input, or arms whose scenes are not the same.
    """
    console = Console(highlight=False, stderr=as_json)
    check_workers(workers)
    searches = arm_searches(
        experiment, out, workers=workers, resume=resume, engine=engine, audit=audit,
        cluster=cluster,
    )
    for number, (name, arm) in enumerate(searches.items(), 1):
        console.print(
            f'arm {number} of {len(searches)}: {name}, {experiment.runs} scenes -> '
            f'{arm.campaign.out}', soft_wrap=True,
        )
        search = _run_arm(arm, console, first=number == 1)
        if search.interrupted and len(search.rows) < arm.campaign.runs:
            console.print('interrupted; continue with --resume')
            return ExitCode.INTERRUPTED
        if search.stopped and not search.exhausted:
            console.print(f'ended: {search.stopped}; continue with --resume', soft_wrap=True)
            return ExitCode.INFRA
    rows = arm_rows(experiment, out)
    check_paired(experiment, rows)
    known = [row for arm in rows.values() for row in arm]
    with print_rows_if_lost(console, Summary(known)):
        _report(experiment, rows, out, console, as_json=as_json)
    broken = any(row.outcome is Outcome.INFRA_ERROR for row in known)
    return ExitCode.INFRA if broken else ExitCode.OK


def _run_arm(arm: Search, console: Console, *, first: bool) -> Engine[Search]:
    """Run one arm until it is complete, interrupted, or ended by an infrastructure error.

    The first arm prints how the requirements are parsed; they are the same in all arms.
    """
    with (
        _open_cluster(arm.campaign, console) as cluster,
        open_search(arm, console, quiet=False) as search,
    ):
        for line in requirement_lines(arm.check, quiet=not first):
            console.print(line, soft_wrap=True)
        for note in (*arm.notes, *filter(None, [search.book.warning])):
            console.print(note, soft_wrap=True, markup=False)
        with search_view(console, search, shown=console.is_terminal):
            run_on_workers(search, cluster)
    return search


def _report(
    experiment: Experiment, rows: dict[str, Sequence[RunRow]], out: Path, console: Console, *,
    as_json: bool,
) -> None:
    from taxinet_ros.analysis.experiment.arms import paired_arms, pairs_frame
    from taxinet_ros.analysis.experiment.report import experiment_json, experiment_report
    from taxinet_ros.analysis.report.page import write_report_page
    from taxinet_ros.analysis.report.pictures import write_pictures

    found = paired_arms(experiment, rows)
    values, report, frame = experiment_json(found), experiment_report(found), pairs_frame(found)
    pairs = out / PAIRS_NAME
    write_parquet(pairs, frame)
    write_sealed(out / JSON_NAME, values, [pairs])
    pictures = write_pictures(report, out)
    write_report_page(report, out / PAGE_NAME)
    if as_json:
        print(json.dumps(values, indent=2))
        return
    names = [PAGE_NAME, *(path.name for path in pictures), PAIRS_NAME, JSON_NAME]
    lines = [*report.sentences, f'written: {out / names[0]}, {", ".join(names[1:])}']
    console.print('\n'.join(lines), soft_wrap=True, markup=False)


def run_shrink(shrinking: Shrinking, *, quiet: bool) -> int:
    """Shrink the run, write the result and print it.

    Args:
        shrinking: what to run.
        quiet: print the outcome only.

    Returns:
        Exit code: 0 shrunk, 130 interrupted.

    Raises:
        UsageError: bad input, or the run does not fail again.
        InfraError: the test bench failed.
        RecordError: the record cannot be written.
    """
    check_workers(shrinking.campaign.workers)
    console = Console(highlight=False)
    begun = time.monotonic()
    with _shrink_view(console, quiet=quiet) as show:
        engine = Engine(shrinking, PARTICIPANTS, show)
        shown = not (quiet or console.is_terminal)
        with (
            _open_cluster(engine.options, console) as cluster,
            print_rows_if_lost(console, engine.summary, () if shown else engine.rows.latest),
            engine,
        ):
            if engine.book.warning:
                console.print(engine.book.warning, soft_wrap=True, markup=False)
            if not quiet:
                console.print(shrink_heading(shrinking), soft_wrap=True)
            run_on_workers(engine, cluster)
    found = make_report(shrinking)
    _check_bench(engine)
    _check_reproduced(shrinking, found)
    with print_rows_if_lost(console, engine.summary):
        _print_shrunk(console, shrinking, found, time.monotonic() - begun)
    return ExitCode.INTERRUPTED if found.state.end is End.NOT_YET else ExitCode.OK


def _print_shrunk(console: Console, shrinking: Shrinking, found: Report, wall_s: float) -> None:
    lines = result_lines(found, shrinking, wall_s)
    if found.original is not None:
        from taxinet_ros.analysis.search.shrinking import PROGRAM_NAME, write_shrunk

        out = shrinking.campaign.out
        names = write_shrunk(shrinking, found)
        console.print(parameter_table(found))
        console.print('\n'.join(finding_lines(found)), soft_wrap=True)
        lines.append(f'written: {out / names[0]}, {", ".join(names[1:])}')
        lines.append(f'run it: {run_command(shrinking, str(out / PROGRAM_NAME))}')
    console.print('\n'.join(lines), soft_wrap=True)


def _check_bench(engine: Engine[Shrinking]) -> None:
    if (row := engine.broken) is not None:
        often = '' if row.kind == AUDIT else 'twice '
        detail = (
            f'{row.detail or row.outcome} ({often}in run {row.run_id}; continue with --resume)'
        )
        raise InfraError(row.kind or 'broken', row.who or 'bench', row.steps - 1, detail)


def _check_reproduced(shrinking: Shrinking, found: Report) -> None:
    if found.state.end is not End.NOT_REPRODUCED:
        return
    assert found.original is not None
    name = shrinking.headline
    interval = shrinking.run.robustness.get(name)
    before = f', recorded as {interval.bound_words().removeprefix("rho ")}' if interval else ''
    raise UsageError(
        f'{shrinking.run.run_id}: not reproduced: on rerun, {name} has rho '
        f'{found.original.rho[name]:+.2f}{before}; was it recorded with another version, '
        'perception or gains?'
    )


@contextlib.contextmanager
def _shrink_view(console: Console, *, quiet: bool) -> Iterator[Callable[[RunRow], None]]:
    """Context that shows finished runs: one line each; on a terminal, one updated line."""
    live = console.is_terminal and not quiet
    with Progress(
        SpinnerColumn(), TextColumn('{task.completed} runs'), TimeElapsedColumn(),
        TextColumn('{task.description}', table_column=Column(no_wrap=True, ratio=1)),
        console=console, transient=True, expand=True, disable=not live,
    ) as progress:
        task = progress.add_task('', total=None)

        def show(row: RunRow) -> None:
            _print_row(row, progress.console, quiet=quiet)
            progress.update(task, advance=1, description=f'{row.outcome} {scene_words(row)}')

        yield show
