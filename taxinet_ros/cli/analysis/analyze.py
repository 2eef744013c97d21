"""``taxinet analyze``: find the causes of failures in a table of runs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from taxinet_ros.analysis.campaign.findings import Findings, analyse
from taxinet_ros.analysis.campaign.folder import PAGE_NAME, check_folder, json_text, write_analysis
from taxinet_ros.analysis.campaign.report import campaign_report
from taxinet_ros.analysis.causes.program import confirmation_command, why_no_program
from taxinet_ros.analysis.report.parts import Report
from taxinet_ros.analysis.runs.campaign import distinct_labels, read_runs
from taxinet_ros.cli.progress import Heartbeat
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.trials.record.table import PARQUET_NAME

_LOWEST_ALPHA, _HIGHEST_ALPHA = 0.002, 0.5


def run_analyze(
    campaign: Path, baselines: Sequence[Path], out: Path | None, *, spec: str | None, alpha: float,
    viewers: int, as_json: bool,
) -> int:
    """Analyse a campaign, write the analysis and print its summary.

    Args:
        campaign: folder or table.
        baselines: other campaigns to compare with.
        out: folder for the analysis; None: beside the table.
        spec: formula that decides which runs failed; None: the headline.
        alpha: significance level of the causes.
        viewers: maximum number of failed runs shown step by step on the page.
        as_json: print ``analysis.json`` in place of the summary.

    Returns:
        Exit code: 0, or 3 if the campaign yields no failure rate (its shares refer to the runs
        made, or decided).

    Raises:
        UsageError: bad input.
    """
    if not _LOWEST_ALPHA <= alpha <= _HIGHEST_ALPHA:
        raise UsageError(f'--alpha {alpha:g}: not within {_LOWEST_ALPHA:g}..{_HIGHEST_ALPHA:g}')
    folder = out or _beside(campaign)
    first = read_runs(campaign, spec)
    runs, *others = distinct_labels([first, *(read_runs(path, first.spec) for path in baselines)])
    check_folder(folder)
    console = Console(highlight=False)
    with _progress() as show:
        findings = analyse(runs, others, alpha=alpha, on_progress=show)
        report = campaign_report(findings, viewers=viewers)
        values = write_analysis(findings, report, folder, on_progress=show)
    if as_json:
        print(json_text(values), end='')
    else:
        _print(console, findings, report, folder)
        console.print(f'report: {folder / PAGE_NAME}', soft_wrap=True)
    return ExitCode.OK if runs.weighting.rated else ExitCode.INCOMPLETE


def _print(console: Console, findings: Findings, report: Report, folder: Path) -> None:
    """Print the summary, with the causes as a table instead of sentences."""
    in_table = {f'{cause.rank}. {cause.sentence()}.' for cause in findings.causes.found}
    for sentence in report.summary:
        if sentence not in in_table:
            console.print(sentence, soft_wrap=True, markup=False)
    if findings.causes.found:
        console.print(_causes(findings))
        # A region selected for its rate overestimates it; fresh scenes do not.
        for cause in findings.causes.found:
            if (command := confirmation_command(findings.runs, cause, folder)) is not None:
                console.print(f'test cause {cause.rank} on fresh scenes: {command}',
                              soft_wrap=True, markup=False)
        if why := why_no_program(findings.runs):
            console.print(f'no program to test the causes on fresh scenes: {why}',
                          soft_wrap=True, markup=False)


def _causes(findings: Findings) -> Table:
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
            cause.p_words().removeprefix('p ').lstrip('= '),
        )
    return table


def _beside(campaign: Path) -> Path:
    if campaign.is_dir() or campaign.suffix != '.parquet':
        return campaign / 'analysis'
    if campaign.name == PARQUET_NAME:
        return campaign.parent / 'analysis'
    return campaign.with_name(f'{campaign.stem}-analysis')


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Show the current step on one transient line; without a terminal, a line now and then."""
    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        tell = Heartbeat()
        yield lambda text: tell(text, 0, 0)
        return
    with console.status('reading') as status:
        yield lambda text: status.update(text)
