"""A search on a pool of worker processes, shown live: of ``falsify``, and of other commands."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from rich.console import Console

from taxinet_ros.analysis.search.learned import write_learned
from taxinet_ros.cli.progress import print_rows_if_lost
from taxinet_ros.cli.run.campaign import run_on_workers, search_view
from taxinet_ros.core.topics import PARTICIPANTS
from taxinet_ros.errors import ExitCode, plain_line
from taxinet_ros.samplers.registry import SAMPLERS
from taxinet_ros.trials.campaign import exit_code
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.search import Search
from taxinet_ros.trials.search_summary import heading_lines, search_summary
from taxinet_ros.trials.stress import likeliest_failure
from taxinet_ros.trials.summary import (
    requirement_lines,
    row_headings,
    row_line,
    summary_json,
)

if TYPE_CHECKING:
    from taxinet_ros.trials.cluster.pool import ClusterPool


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
    console = Console(emoji=False, highlight=False, stderr=as_json)
    with (
        open_cluster(asked.campaign, console) as cluster,
        open_search(asked, console, quiet=quiet) as search,
    ):
        if search.book.warning:
            console.print(search.book.warning, soft_wrap=True, markup=False)
        if not quiet:
            lines = heading_lines(asked)
            console.print('\n'.join(lines), soft_wrap=True, markup=False)
        above = [] if quiet else row_headings(
            asked.check, asked.campaign.runs, columns=not console.is_terminal
        )
        for line in (*requirement_lines(asked.check, quiet=quiet), *above):
            console.print(line, soft_wrap=True)
        with search_view(console, search, shown=console.is_terminal and not quiet):
            run_on_workers(search, cluster)
        learned, planned = write_learned(search), search.first_planned
    likeliest = likeliest_failure(asked.sampler, search.rows)
    lines = [*search_summary(search, likeliest, resuming='--resume'), *learned]
    console.print('\n'.join(lines), soft_wrap=True)
    if as_json:
        values = summary_json(search.summary, asked.campaign, planned)
        if SAMPLERS[asked.sampler].by_likelihood:
            values['likeliest_failure'] = likeliest and likeliest.to_json()
        print(json.dumps({**values, 'sampler': asked.sampler}, allow_nan=False))
    if search.interrupted and len(search.rows) < search.options.runs:
        return ExitCode.INTERRUPTED
    return exit_code(search.summary)


@contextlib.contextmanager
def open_search(asked: Search, console: Console, *, quiet: bool) -> Iterator[Engine[Search]]:
    """Context of an open search that prints its rows as they come, or all if its record is lost."""
    if asked.campaign.runs_graphs:
        from taxinet_ros.nodes.running.domain import check_workers  # ROS takes time to import

        check_workers(asked.campaign.workers)
    shown = not (quiet or console.is_terminal)

    def show(row: RunRow) -> None:
        print_row(row, console=console, quiet=quiet, shared=asked.check.shared)

    search = Engine(asked, PARTICIPANTS, show)
    lost = print_rows_if_lost(console, search.summary, () if shown else search.rows.latest)
    with lost, search:
        yield search


def print_row(
    row: RunRow, console: Console, *, quiet: bool, shared: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Print a line of a run, if it is asked for and no bar covers it, as on a terminal."""
    if not quiet and not (console.is_terminal and row.outcome.judged):
        console.print(row_line(row, shared), soft_wrap=True)


def open_cluster(
    options: CampaignOptions, console: Console
) -> contextlib.AbstractContextManager[ClusterPool | None]:
    """Context of the connected cluster of a campaign, or of None."""
    if not options.cluster:
        return contextlib.nullcontext()
    from taxinet_ros.trials.cluster.pool import campaign_cluster  # which imports asyncio

    def tell(line: str) -> None:
        console.print(plain_line(line), soft_wrap=True, markup=False)

    return campaign_cluster(options, options.cluster, tell=tell)
