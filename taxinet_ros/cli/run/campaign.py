"""Runs a campaign on the graph, and shows it: a progress bar, a line per run, a summary."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from taxinet_ros.campaign.campaign import Campaign, exit_code
from taxinet_ros.campaign.options import CampaignOptions
from taxinet_ros.campaign.record.facts import recorded_world
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.summary import (
    campaign_heading,
    campaign_summary,
    requirement_lines,
    row_line,
)
from taxinet_ros.cli.progress import print_rows_if_lost
from taxinet_ros.core.camera import camera
from taxinet_ros.core.controller import check_controller
from taxinet_ros.core.perception.perception import GroundTruth
from taxinet_ros.core.topics import PARTICIPANTS
from taxinet_ros.core.user_code import command_of
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.processes.interrupts import interrupts

if TYPE_CHECKING:
    from taxinet_ros.nodes.graph.runner import Graph


def run_campaign(options: CampaignOptions, foxglove: int | None = None) -> int:
    """Run it to its end and print what happened.

    Args:
        options: what to run.
        foxglove: port of 127.0.0.1 where the Foxglove app can watch it.

    Returns:
        Exit code: 0 all satisfied, 1 some violated, 2 nothing could be judged, 4 the bench broke,
        130 interrupted.
    """
    if foxglove is not None:
        from taxinet_ros.nodes.graph.foxglove_view import check_port

        check_port(foxglove)
    return exit_code(campaign_rows(options, foxglove))


def campaign_rows(options: CampaignOptions, foxglove: int | None = None) -> list[RunRow]:
    """Run a campaign and print it; the rows of its table.

    Raises:
        KeyboardInterrupt: after an interrupt, where runs are left.
    """
    console = Console(highlight=False)
    with _progress(console) as progress:
        bar = progress.add_task('', total=options.runs)

        def show(row: RunRow) -> None:
            progress.console.print(row_line(row), soft_wrap=True)
            progress.advance(bar)

        at_hand = _Interruption()
        graphs = _Graphs(options)
        campaign = Campaign(options, PARTICIPANTS, show, graphs.make_ahead)
        with (
            print_rows_if_lost(progress.console, campaign.rows, shown=True),
            graphs, campaign, interrupts(at_hand.interrupt, at_hand.abort),
        ):
            graphs.check(campaign.book.facts)
            lines = [campaign_heading(options), *campaign.notes]
            progress.console.print('\n'.join(lines), soft_wrap=True, markup=False)
            for line in requirement_lines(campaign.check):
                progress.console.print(line, soft_wrap=True)
            if foxglove is not None:
                progress.console.print(f'live at ws://127.0.0.1:{foxglove}', soft_wrap=True)
            while campaign.unfinished and not at_hand.interrupted:
                with graphs.next() as graph, _view(foxglove, graph):
                    at_hand.take(graph)
                    graph.run(campaign.requests(), campaign.take)
                    at_hand.graph = None
    console.print(campaign_summary(campaign.rows, options), soft_wrap=True)
    if at_hand.interrupted and len(campaign.rows) < options.runs:
        raise KeyboardInterrupt
    return campaign.rows


def _view(port: int | None, graph: Graph) -> contextlib.AbstractContextManager[None]:
    if port is None:
        return contextlib.nullcontext()
    from taxinet_ros.nodes.graph.foxglove_view import foxglove_view

    return foxglove_view(port, graph.domain)


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


class _Graphs:
    """The graphs of a campaign, one after the other: a new one where the last one broke."""

    def __init__(self, options: CampaignOptions) -> None:
        self._options = options
        self._ahead = contextlib.ExitStack()
        self._made: Graph | None = None
        self._sha256 = {
            'controller': check_controller(options.controller, options.gains, graph=True),
            'world': find_world(options.world).fingerprint,
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._ahead.close()

    def make_ahead(self) -> None:
        """Do what this process can while Scenic's starts: the first graph, and what it draws on.

        ROS is imported here too, and not before: that takes as long as a third of Scenic's start.

        Raises:
            UsageError: the ROS domain set by hand is none; so no folder is made in vain.
        """
        from taxinet_ros.nodes.running.domain import domain_by_hand

        domain_by_hand()
        options = self._options
        commands = [options.perception, options.controller]
        if options.processes or any(map(command_of, commands)):
            return  # It would leave its logs in a folder that is not there yet.
        if options.perception != GroundTruth.word or options.images == 'all':
            camera.prepare()
        self._made = self._ahead.enter_context(self._new())

    def check(self, facts: Mapping[str, Any]) -> None:
        """See that controller and world are those that are on record.

        Raises:
            UsageError: a file of them has changed between.
        """
        recorded = {
            'controller': facts['controller_sha256'], 'world': recorded_world(facts)[1],
        }
        for role, sha256 in recorded.items():
            if sha256 != self._sha256[role]:
                word = getattr(self._options, role)
                raise UsageError(f'{role} {word} has changed while the campaign began')

    @contextlib.contextmanager
    def next(self) -> Iterator[Graph]:
        """A graph for the ``with``."""
        if self._made is None:
            with self._new() as graph:
                yield graph
        else:
            graph, self._made = self._made, None
            with self._ahead.pop_all():
                yield graph

    def _new(self) -> contextlib.AbstractContextManager[Graph]:
        from taxinet_ros.nodes.graph.runner import campaign_graph, composed_graph, process_graph

        options = self._options
        graph = campaign_graph(options, self._sha256['controller'], self._sha256['world'])
        if options.processes:
            return process_graph(graph, options.out / 'logs')
        return composed_graph(graph)


class _Interruption:
    """The graph that is to end its run in order when somebody interrupts."""

    def __init__(self) -> None:
        self.interrupted = False
        self.graph: Graph | None = None

    def interrupt(self) -> None:
        self.interrupted = True
        if self.graph is not None:
            self.graph.interrupt()

    def abort(self) -> bool:
        """End the run at hand at once, if there is one."""
        return self.graph is not None and self.graph.abort()

    def take(self, graph: Graph) -> None:
        """Have a graph that may have been asked for before somebody interrupted."""
        self.graph = graph
        if self.interrupted:
            graph.interrupt()
