"""``taxinet experiment``: the same scenes with and without a suspected cause."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from taxinet_ros.cli.completion import complete_experiment, complete_perception
from taxinet_ros.cli.options import AuditOption, ClusterOption, EngineOption, JsonOption
from taxinet_ros.cli.progress import print_rows_if_lost
from taxinet_ros.cli.show import print_json
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.trials.options import DEFAULT_ROOT, GRAPH, new_folder

if TYPE_CHECKING:
    from taxinet_ros.trials.engine import Engine
    from taxinet_ros.trials.experiment import Experiment
    from taxinet_ros.trials.search import Search


def experiment(
    file: Annotated[
        str,
        typer.Argument(
            metavar='FILE', help='shipped experiment (shadows, shadows_afternoon, crossing, '
            'light) or a YAML file', autocompletion=complete_experiment,
        ),
    ],
    out: Annotated[Path | None, typer.Option(help='folder for the arms; must be new')] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help="number of scenes (default: the file's)")
    ] = None,
    perception: Annotated[
        str | None,
        typer.Option(
            metavar='WORD|FILE', help="network (default: the file's)",
            autocompletion=complete_perception,
        ),
    ] = None,
    workers: Annotated[int, typer.Option(help='graphs run in parallel; same results')] = 1,
    cluster: ClusterOption = None,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue an interrupted command in --out')
    ] = False,
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    as_json: JsonOption = False,
) -> None:
    """Confirm a cause by running the same scenes with and without it.

    Each arm of the experiment is a separate campaign; runs of the same scene are compared in pairs.
    """
    from taxinet_ros.trials.experiment import find_experiment, read_experiment, with_network
    from taxinet_ros.trials.record.facts import missing_packages_named

    if resume and out is None:
        raise UsageError('--resume: name the experiment to continue with --out')
    with missing_packages_named(out if resume else None):
        asked = read_experiment(find_experiment(file))
    if runs is not None:
        asked = dataclasses.replace(asked, runs=runs)
    if perception is not None:
        asked = with_network(asked, perception)
    raise typer.Exit(
        run_experiment(
            asked, out or new_folder(DEFAULT_ROOT / f'experiment-{asked.name}'),
            workers=workers, resume=resume, as_json=as_json, engine=engine, audit=audit,
            cluster=cluster,
        )
    )


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
    from taxinet_ros.analysis.experiment.arms import paired_arms
    from taxinet_ros.analysis.experiment.report import write_experiment
    from taxinet_ros.trials.experiment import arm_rows, arm_searches, check_paired
    from taxinet_ros.trials.summary import Summary

    console = Console(emoji=False, highlight=False, stderr=as_json)
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
        values, lines = write_experiment(paired_arms(experiment, rows), out)
        if as_json:
            print_json(values)
        else:
            console.print('\n'.join(lines), soft_wrap=True, markup=False)
    broken = any(row.outcome is Outcome.INFRA_ERROR for row in known)
    return ExitCode.INFRA if broken else ExitCode.OK


def _run_arm(arm: Search, console: Console, *, first: bool) -> Engine[Search]:
    """Run one arm until it is complete, interrupted, or ended by an infrastructure error.

    The first arm prints how the requirements are parsed; they are the same in all arms.
    """
    from taxinet_ros.cli.run.campaign import run_on_workers, search_view
    from taxinet_ros.cli.run.search import open_cluster, open_search
    from taxinet_ros.trials.summary import requirement_lines, row_headings

    with (
        open_cluster(arm.campaign, console) as cluster,
        open_search(arm, console, quiet=False) as search,
    ):
        above = row_headings(arm.check, arm.campaign.runs, columns=not console.is_terminal)
        for line in (*requirement_lines(arm.check, quiet=not first), *above):
            console.print(line, soft_wrap=True)
        for note in (*arm.notes, *filter(None, [search.book.warning])):
            console.print(note, soft_wrap=True, markup=False)
        with search_view(console, search, shown=console.is_terminal):
            run_on_workers(search, cluster)
    return search
