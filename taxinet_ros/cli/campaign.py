"""Runs a campaign on the graph, and shows it: a progress bar, a line per run, a summary."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from taxinet_ros.campaign.campaign import Campaign, exit_code
from taxinet_ros.campaign.options import CampaignOptions
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.cli.lines import heading, row_line, summary
from taxinet_ros.nodes.graph import Graph, GraphOptions, composed_graph
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.nodes.processes import process_graph


def run_campaign(options: CampaignOptions) -> int:
    """Run it to its end and print what happened.

    Returns:
        Exit code: 0 all satisfied, 1 some violated, 2 nothing could be judged, 4 the bench broke,
        130 interrupted.
    """
    return exit_code(campaign_rows(options))


def campaign_rows(options: CampaignOptions) -> list[RunRow]:
    """Run a campaign and print it; the rows of its table."""
    console = Console(highlight=False)
    with _progress(console) as progress:
        bar = progress.add_task('', total=options.runs)

        def show(row: RunRow) -> None:
            progress.console.print(row_line(row), soft_wrap=True)
            progress.advance(bar)

        with Campaign(options, PARTICIPANTS, show) as campaign, _interrupts() as interrupts:
            progress.console.print(heading(options), soft_wrap=True)
            while campaign.unfinished and not interrupts.asked:
                with _graph(options) as graph:
                    interrupts.graph = graph
                    graph.run(campaign.requests(), campaign.take)
                    interrupts.graph = None
    console.print(summary(campaign.rows, options), soft_wrap=True)
    return campaign.rows


def _graph(options: CampaignOptions) -> contextlib.AbstractContextManager[Graph]:
    graph = GraphOptions(perception=options.perception, out=options.out, gains=options.gains)
    if options.processes:
        return process_graph(graph, options.out / 'logs')
    return composed_graph(graph)


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn('running'),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


class _Interrupts:
    """Ctrl-C and SIGTERM: once ends the run at hand in order, twice ends everything now."""

    def __init__(self) -> None:
        self.asked = False
        self.graph: Graph | None = None

    def __call__(self, number: int, frame: FrameType | None) -> Any:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        if self.graph is not None:
            self.graph.interrupt()


@contextlib.contextmanager
def _interrupts() -> Iterator[_Interrupts]:
    handler = _Interrupts()
    before = {number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield handler
    finally:
        for number, old in before.items():
            signal.signal(number, old)
