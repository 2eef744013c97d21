"""``taxinet falsify``: a sampler looks for scenes in which the specification is violated."""

from __future__ import annotations

from rich.console import Console

from taxinet_ros.analysis.learned import write_learned
from taxinet_ros.campaign.campaign import exit_code
from taxinet_ros.campaign.crew import Crew
from taxinet_ros.campaign.interrupts import interrupts
from taxinet_ros.campaign.lines import check_lines, row_line
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.search import Search
from taxinet_ros.campaign.search_lines import search_heading, search_summary, space_lines
from taxinet_ros.campaign.search_loop import run_search
from taxinet_ros.campaign.search_options import SearchOptions
from taxinet_ros.cli.progress import told_if_lost
from taxinet_ros.cli.search_view import search_view
from taxinet_ros.nodes.domain import check_workers
from taxinet_ros.nodes.graph import campaign_graph
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.nodes.worker import worker_command


def run_falsify(options: SearchOptions, *, quiet: bool) -> int:
    """Search, and print what happened.

    Args:
        options: what to do.
        quiet: print warnings and the summary only.

    Returns:
        Exit code: 0 all satisfied, 1 some violated, 4 the bench broke, 130 interrupted.

    Raises:
        UsageError: bad input, or every scene was rejected.
    """
    check_workers(options.workers)
    console = Console(highlight=False)
    live = console.is_terminal and not quiet

    def show(row: RunRow) -> None:
        # A terminal has the bar for what goes as it should.
        if not quiet and (not live or not row.outcome.judged):
            console.print(row_line(row), soft_wrap=True)

    search = Search(options, PARTICIPANTS, show)
    with told_if_lost(console, search.rows, shown=not (quiet or live)), search:
        if search.warning:
            console.print(search.warning, soft_wrap=True, markup=False)
        if not quiet:
            lines = [search_heading(search.options), *space_lines(search.space), *search.notes]
            console.print('\n'.join(lines), soft_wrap=True, markup=False)
        for line in check_lines(search.check, quiet=quiet):
            console.print(line, soft_wrap=True)
        with (
            interrupts(search.interrupt),
            search_view(console, search, shown=live),
            Crew(_command(search), options.workers, options.campaign.out / 'logs') as crew,
        ):
            run_search(search, crew)
        learned = write_learned(search)
    lines = [*search_summary(search), *learned]
    console.print('\n'.join(lines), soft_wrap=True)
    if search.interrupted and len(search.rows) < options.campaign.runs:
        return 130
    return exit_code(search.rows)


def _command(search: Search) -> list[str]:
    campaign = search.options.campaign
    return worker_command(campaign_graph(campaign, search.facts['controller_sha256']))
