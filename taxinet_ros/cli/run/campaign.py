"""Run a campaign and show progress bar, one line per run, and a summary."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from taxinet_ros.campaign.audit import Auditor
from taxinet_ros.campaign.campaign import Campaign, exit_code
from taxinet_ros.campaign.loop_run import Loop, campaign_loop
from taxinet_ros.campaign.options import GRAPH, LOOP, CampaignOptions
from taxinet_ros.campaign.record.facts import recorded_world
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.summary import (
    campaign_heading,
    campaign_summary,
    requirement_lines,
    row_line,
    summary_json,
)
from taxinet_ros.cli.progress import print_rows_if_lost
from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.camera import camera
from taxinet_ros.core.perception.perception import GroundTruth
from taxinet_ros.core.topics import PARTICIPANTS
from taxinet_ros.core.user_code import command_of
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.processes.interrupts import ToldInterrupt, interrupts

if TYPE_CHECKING:
    from taxinet_ros.nodes.graph.runner import Graph


def run_campaign(
    options: CampaignOptions, foxglove: int | None = None, *, quiet: bool = False,
    as_json: bool = False,
) -> int:
    """Run the campaign and print the results.

    Args:
        options: what to run.
        foxglove: port on 127.0.0.1 for the Foxglove app.
        quiet: print warnings and the summary only.
        as_json: print the summary as JSON; all else goes to standard error.

    Returns:
        Exit code: 0 all satisfied, 1 some violated, 2 nothing could be judged, 4 infrastructure
            error, 130 interrupted.
    """
    if foxglove is not None:
        from taxinet_ros.nodes.graph.foxglove_view import check_port

        check_port(foxglove)
    rows = campaign_rows(options, foxglove, quiet=quiet, as_json=as_json)
    return exit_code(rows)


def campaign_rows(
    options: CampaignOptions, foxglove: int | None = None, *, quiet: bool = False,
    as_json: bool = False,
) -> list[RunRow]:
    """Run and print a campaign; return the rows of its table.

    Raises:
        KeyboardInterrupt: interrupted with runs left.
    """
    console = Console(highlight=False, stderr=as_json)
    with _progress(console) as progress:
        bar = progress.add_task('', total=options.runs)

        def show(row: RunRow) -> None:
            if not quiet:
                progress.console.print(row_line(row), soft_wrap=True)
            progress.advance(bar)

        at_hand = _Interruption()
        graphs = _Graphs(options)
        campaign = Campaign(options, PARTICIPANTS, show, graphs.make_ahead)
        with (
            print_rows_if_lost(progress.console, campaign.rows, shown=not quiet),
            graphs, campaign, interrupts(at_hand.interrupt, at_hand.abort),
        ):
            graphs.check(campaign.book.facts)
            if not quiet:
                lines = [campaign_heading(options), *campaign.notes]
                progress.console.print('\n'.join(lines), soft_wrap=True, markup=False)
            for line in requirement_lines(campaign.check, quiet=quiet):
                progress.console.print(line, soft_wrap=True)
            if foxglove is not None:
                progress.console.print(f'live at ws://127.0.0.1:{foxglove}', soft_wrap=True)
            while campaign.unfinished and not at_hand.interrupted:
                with graphs.next() as graph, _view(foxglove, graph):
                    at_hand.take(graph)
                    graph.run(campaign.requests(), campaign.take)
                    at_hand.graph = None
    console.print(campaign_summary(campaign.rows, options), soft_wrap=True)
    if as_json:
        print(json.dumps(summary_json(campaign.rows, options, options.runs), allow_nan=False))
    if at_hand.interrupted and len(campaign.rows) < options.runs:
        raise ToldInterrupt if campaign.rows else KeyboardInterrupt
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
        TextColumn('left'),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


class _Graphs:
    """The graphs of a campaign, one at a time: a new one after each infrastructure error."""

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
        """Start the first graph while the Scenic process starts.

        ROS is imported here and not earlier: the import takes a third of Scenic's start-up time.

        Raises:
            UsageError: the ROS domain set by hand is invalid; raised before any folder is made.
        """
        options = self._options
        if options.engine == GRAPH:
            from taxinet_ros.nodes.running.domain import domain_by_hand

            domain_by_hand()
        commands = [options.perception, options.controller]
        if options.processes or any(map(command_of, commands)):
            return  # It would write its logs to a folder that does not exist yet.
        if options.perception != GroundTruth.word or options.images == 'all':
            camera.prepare()
        self._made = self._ahead.enter_context(self._new())

    def check(self, facts: Mapping[str, Any]) -> None:
        """Check that controller and world still are the recorded ones.

        Raises:
            UsageError: a file of them has changed.
        """
        recorded = {
            'controller': facts['controller_sha256'], 'world': recorded_world(facts)[1],
        }
        for role, sha256 in recorded.items():
            if sha256 != self._sha256[role]:
                word = getattr(self._options, role)
                raise UsageError(f'{role} {word} changed while the campaign was starting')

    @contextlib.contextmanager
    def next(self) -> Iterator[Graph]:
        """Context of one graph."""
        if self._made is None:
            with self._new() as graph:
                yield graph
        else:
            graph, self._made = self._made, None
            with self._ahead.pop_all():
                yield graph

    def _new(self) -> contextlib.AbstractContextManager[Graph]:
        options = self._options
        if options.engine == LOOP:
            return _loop(options, self._sha256['controller'], self._sha256['world'])
        from taxinet_ros.nodes.graph.runner import campaign_graph, composed_graph, process_graph

        graph = campaign_graph(options, self._sha256['controller'], self._sha256['world'])
        if options.processes:
            return process_graph(graph, options.out / 'logs')
        return composed_graph(graph)


@contextlib.contextmanager
def _loop(
    options: CampaignOptions, controller_sha256: str, world_sha256: str
) -> Iterator[Graph]:
    """The loop without ROS, used as a graph; it is this process that runs."""
    audits: list[str] = []
    if options.audit_percent:
        from taxinet_ros.nodes.graph.worker import audit_command

        audits = audit_command(options, controller_sha256, world_sha256)
    loop = Loop(campaign_loop(options, controller_sha256, world_sha256))
    with Auditor(audits, options.out, options.audit_percent) as auditor:
        yield _LoopGraph(loop, auditor)


class _LoopGraph:
    domain = -1

    def __init__(self, loop: Loop, auditor: Auditor) -> None:
        self._loop, self._auditor = loop, auditor

    def run(
        self, requests: Iterable[RunRequest], on_result: Callable[[RunRequest, RunResult], bool]
    ) -> None:
        for request in requests:
            result = self._auditor.audited(request, self._loop.run(request))
            if not on_result(request, result) or self._loop.interrupted:
                return

    def interrupt(self) -> None:
        self._loop.interrupted = True

    def abort(self) -> bool:
        return False  # Nothing waits here: the interrupt is raised at once.


class _Interruption:
    """The graph whose run is ended in order on an interrupt."""

    def __init__(self) -> None:
        self.interrupted = False
        self.graph: Graph | None = None

    def interrupt(self) -> None:
        self.interrupted = True
        if self.graph is not None:
            self.graph.interrupt()

    def abort(self) -> bool:
        """Abort the current run, if any."""
        return self.graph is not None and self.graph.abort()

    def take(self, graph: Graph) -> None:
        """Set the graph; abort at once if an interrupt came before."""
        self.graph = graph
        if self.interrupted:
            graph.interrupt()
