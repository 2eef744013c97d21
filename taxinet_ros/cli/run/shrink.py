"""``taxinet shrink``: the nearest scenario to nominal taxiing that still fails."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import typer
from rich.console import Console

from taxinet_ros.cli.options import (
    AuditOption,
    ClusterOption,
    EngineOption,
    FailedRunArgument,
    ImagesOption,
    NeededRunsOption,
    NominalOption,
    OutOption,
    OwnControllerOption,
    OwnPerceptionOption,
    OwnSpecOption,
    QuietOption,
    ResumeOption,
    WorkersOption,
)
from taxinet_ros.cli.progress import print_rows_if_lost
from taxinet_ros.core.topics import PARTICIPANTS
from taxinet_ros.errors import ExitCode

if TYPE_CHECKING:
    from taxinet_ros.trials.shrink.shrinking import Report, Shrinking


def shrink(
    run: FailedRunArgument,
    nominal: NominalOption = None,
    runs: NeededRunsOption = 100,
    workers: WorkersOption = 1,
    cluster: ClusterOption = None,
    out: OutOption = None,
    resume: ResumeOption = False,
    perception: OwnPerceptionOption = None,
    controller: OwnControllerOption = None,
    spec: OwnSpecOption = None,
    images: ImagesOption = 'none',
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    quiet: QuietOption = False,
) -> None:
    """Shrink a failed run to the nearest scenario that still fails.

    Moves its parameters to nominal taxiing one by one, and reports which of them matter.
    """
    from taxinet_ros.trials.record.facts import missing_packages_named
    from taxinet_ros.trials.shrink.shrinking import make_shrinking

    with missing_packages_named(run.parent):
        shrinking = make_shrinking(
            run, perception=perception, specs=spec or (), nominal=nominal or (), runs=runs,
            workers=workers, out=out, resume=resume, images=images, controller=controller,
            engine=engine, audit=audit, cluster=cluster,
        )
    raise typer.Exit(_run_shrink(shrinking, quiet=quiet))


def _run_shrink(shrinking: Shrinking, *, quiet: bool) -> int:
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
    from taxinet_ros.cli.run.campaign import run_on_workers, search_view
    from taxinet_ros.cli.run.search import open_cluster, print_row
    from taxinet_ros.nodes.running.domain import check_workers
    from taxinet_ros.trials.engine import Engine
    from taxinet_ros.trials.shrink.algorithm import End
    from taxinet_ros.trials.shrink.shrinking import check_run, make_report, shrink_heading

    check_workers(shrinking.campaign.workers)
    console = Console(emoji=False, highlight=False)
    begun = time.monotonic()
    engine = Engine(
        shrinking, PARTICIPANTS, lambda row: print_row(row, console, quiet=quiet))
    shown = not (quiet or console.is_terminal)
    with (
        open_cluster(engine.options, console) as cluster,
        print_rows_if_lost(console, engine.summary, () if shown else engine.rows.latest), engine,
    ):
        if engine.book.warning:
            console.print(engine.book.warning, soft_wrap=True, markup=False)
        if not quiet:
            console.print('\n'.join([*shrinking.told, shrink_heading(shrinking)]), soft_wrap=True)
        with search_view(console, engine, shown=console.is_terminal and not quiet):
            run_on_workers(engine, cluster)
    found = make_report(shrinking)
    check_run(engine, found)
    with print_rows_if_lost(console, engine.summary):
        _print_shrunk(console, shrinking, found, time.monotonic() - begun)
    return ExitCode.INTERRUPTED if found.state.end is End.NOT_YET else ExitCode.OK


def _print_shrunk(console: Console, shrinking: Shrinking, found: Report, wall_s: float) -> None:
    from taxinet_ros.analysis.search.shrinking import PROGRAM_NAME, write_shrunk
    from taxinet_ros.trials.shrink import shrinking as shrunk

    lines = shrunk.result_lines(found, shrinking, wall_s)
    if found.original is not None:
        out = shrinking.campaign.out
        names = write_shrunk(shrinking, found)
        console.print(shrunk.parameter_table(found))
        console.print('\n'.join(shrunk.finding_lines(found)), soft_wrap=True)
        lines.append(f'written: {out / names[0]}, {", ".join(names[1:])}')
        lines.append(f'run it: {shrunk.run_command(shrinking, str(out / PROGRAM_NAME))}')
    console.print('\n'.join(lines), soft_wrap=True)
