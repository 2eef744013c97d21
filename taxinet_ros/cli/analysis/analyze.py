"""``taxinet analyze``: find the causes of failures in a table of runs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from taxinet_ros.cli.options import ExaminedOption, JsonOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.analysis.campaign.findings import Findings
    from taxinet_ros.analysis.report.parts import Report

_LOWEST_ALPHA, _HIGHEST_ALPHA = 0.002, 0.5


def analyze(
    campaign: Annotated[
        Path, typer.Argument(metavar='CAMPAIGN', help="a campaign's folder, or a .parquet table")
    ],
    baseline: Annotated[
        list[Path] | None,
        typer.Option(metavar='CAMPAIGN', help='another campaign to compare with; repeatable'),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help='output folder (default CAMPAIGN/analysis)')
    ] = None,
    spec: ExaminedOption = None,
    alpha: Annotated[
        float, typer.Option(help='accepted probability of naming a false cause')
    ] = 0.05,
    as_json: JsonOption = False,
) -> int:
    """Find the causes of a campaign's failures, and write a report.

    Identifies hours, clouds, positions and poses (singly and in pairs) where runs fail
    significantly more often, plots robustness over each feature and compares networks. Exit code 3
    if a sampler chose all runs, so that the program's failure rate cannot be estimated.
    """
    from taxinet_ros.analysis.campaign.findings import analyse
    from taxinet_ros.analysis.campaign.folder import (
        PAGE_NAME,
        check_folder,
        json_text,
        write_analysis,
    )
    from taxinet_ros.analysis.campaign.report import campaign_report
    from taxinet_ros.analysis.runs.campaign import distinct_labels, read_examined, read_runs

    if not _LOWEST_ALPHA <= alpha <= _HIGHEST_ALPHA:
        raise UsageError(f'--alpha {alpha:g}: not within {_LOWEST_ALPHA:g}..{_HIGHEST_ALPHA:g}')
    folder = out or _beside(campaign)
    first = read_examined(campaign, spec)
    others = [read_runs(path, first.spec) for path in baseline or ()]
    runs, *others = distinct_labels([first, *others])
    check_folder(folder)
    with _progress() as show:
        findings = analyse(runs, others, alpha=alpha, on_progress=show)
        report = campaign_report(findings)
        values = write_analysis(findings, report, folder, on_progress=show)
    if as_json:
        print(json_text(values), end='')
    else:
        console = line_console()
        _print(console, findings, report, folder)
        console.print(f'report: {folder / PAGE_NAME}')
    return ExitCode.OK if runs.weighting.rated else ExitCode.INCOMPLETE


def _print(console: Console, findings: Findings, report: Report, folder: Path) -> None:
    """Print the summary, with the causes as a table instead of sentences."""
    from taxinet_ros.analysis.causes.program import confirmation_command, why_no_program

    in_table = tuple(f'{cause.rank}. ' for cause in findings.causes.found)
    for sentence in report.summary:
        if not sentence.startswith(in_table):
            console.print(sentence)
    if findings.causes.found:
        console.print(_causes(findings), soft_wrap=False)
        # A region selected for its rate overestimates it; fresh scenes do not.
        for cause in findings.causes.found:
            if (command := confirmation_command(findings.runs, cause, folder)) is not None:
                console.print(f'test cause {cause.rank} on fresh scenes: {command}')
        if why := why_no_program(findings.runs):
            console.print(f'no program to test the causes on fresh scenes: {why}')


def _causes(findings: Findings) -> Table:
    from taxinet_ros.analysis.report.text import p_words

    table = Table(box=None, padding=(0, 1), pad_edge=False)
    table.add_column('#', justify='right')
    table.add_column('cause')
    for title in ('runs', 'fail', 'elsewhere', 'contains', 'associated', 'p'):
        table.add_column(title, justify='right', no_wrap=True)
    for cause in findings.causes.found:
        inside = cause.inside
        known = f' ({100 * inside.low:.0f}–{100 * inside.high:.0f})' if inside.low >= 0 else ''
        table.add_row(
            str(cause.rank), cause.region.words(), f'{inside.runs:,}',
            f'{100 * inside.rate:.0f} %{known}', f'{100 * cause.outside.rate:.1f} %',
            f'{100 * cause.share:.0f} %', f'{100 * cause.associated[0]:.0f} %',
            p_words(cause.p).removeprefix('p ').lstrip('= '),
        )
    return table


def _beside(campaign: Path) -> Path:
    from taxinet_ros.trials.record.table import PARQUET_NAME

    if campaign.is_dir() or campaign.suffix != '.parquet':
        return campaign / 'analysis'
    if campaign.name == PARQUET_NAME:
        return campaign.parent / 'analysis'
    return campaign.with_name(f'{campaign.stem}-analysis')


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Show the current step on one transient line; without a terminal, a line now and then."""
    from taxinet_ros.cli.progress import Heartbeat

    console = line_console(stderr=True)
    if not console.is_terminal:
        tell = Heartbeat()
        yield lambda text: tell(text, 0, 0)
        return
    with console.status('reading') as status:
        yield lambda text: status.update(text)
