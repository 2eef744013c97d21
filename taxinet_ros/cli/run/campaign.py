"""``taxinet run``: a campaign here or on workers, with a bar, one line per run, and a summary."""

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

from taxinet_ros.cli.progress import print_rows_if_lost
from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.camera import camera
from taxinet_ros.core.perception.perception import GroundTruth
from taxinet_ros.core.system import System
from taxinet_ros.core.topics import PARTICIPANTS
from taxinet_ros.core.user_code import EXTERNAL, command_of
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.processes.interrupts import ToldInterrupt, interrupts
from taxinet_ros.samplers.sampler import MOST_LAG
from taxinet_ros.trials.audit import Auditor
from taxinet_ros.trials.campaign import Campaign, exit_code
from taxinet_ros.trials.loop_run import Loop
from taxinet_ros.trials.options import GRAPH, LOOP, CampaignOptions
from taxinet_ros.trials.record.facts import recorded_system
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.summary import (
    campaign_heading,
    campaign_summary,
    requirement_lines,
    row_line,
    summary_json,
)
from taxinet_ros.trials.worker_pool import WorkerPool, run_search

if TYPE_CHECKING:
    from taxinet_ros.nodes.graph.runner import Graph


def run_campaign(
    options: CampaignOptions, foxglove: int | None = None, *, workers: int = 1,
    quiet: bool = False, as_json: bool = False,
) -> int:
    """Run the campaign and print the results.

    Args:
        options: what to run.
        foxglove: port on 127.0.0.1 for the Foxglove app.
        workers: number of runs at a time; result of :func:`check_run_workers`.
        quiet: print warnings and the summary only.
        as_json: print the summary as JSON; all else goes to standard error.

    Returns:
        Exit code: 0 all satisfied, 1 some violated, 2 nothing could be judged, 4 infrastructure
            error, 130 interrupted.
    """
    if foxglove is not None:
        from taxinet_ros.nodes.graph.foxglove_view import check_port

        check_port(foxglove)
    rows = campaign_rows(options, foxglove, workers=workers, quiet=quiet, as_json=as_json)
    return exit_code(rows)


def check_run_workers(workers: int, options: CampaignOptions, foxglove: int | None) -> int:
    """Check the number of workers of ``taxinet run``; return it.

    Raises:
        UsageError: out of range, without effect, or with something that there is only one of.
    """
    if not 1 <= workers <= MOST_LAG:
        raise UsageError(f'--workers {workers}: needs to be within 1..{MOST_LAG}')
    if workers == 1:
        return workers
    if options.runs == 1:
        raise UsageError(
            f'--workers {workers}: no effect on a single run; ask for more with --runs, or leave '
            '--workers out'
        )
    timing = options.timing
    alone = {
        '--free': (timing.free, 'whose timing runs beside it would change'),
        '--processes': (options.processes, 'which starts one graph of processes'),
        '--foxglove': (foxglove is not None, 'which shows one run at a time'),
    }
    for option, (given, why) in alone.items():
        if given:
            raise UsageError(f'--workers {workers}: not with {option}, {why}')
    for role in ('perception', 'controller'):
        if getattr(options, role) == EXTERNAL:
            raise UsageError(
                f'--workers {workers}: not with a {role} that you start yourself, which is in one '
                'graph only; give its command'
            )
    if options.engine == GRAPH:
        from taxinet_ros.nodes.running.domain import check_workers

        check_workers(workers)
    return workers


def campaign_rows(
    options: CampaignOptions, foxglove: int | None = None, *, workers: int = 1,
    quiet: bool = False, as_json: bool = False,
) -> list[RunRow]:
    """Run and print a campaign; return the rows of its table, by the numbers of their runs.

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

        here = _Graphs(options) if workers == 1 else None
        campaign = Campaign(options, PARTICIPANTS, show, here.make_ahead if here else _nothing)
        at_hand = _Interruption()
        with (
            print_rows_if_lost(progress.console, campaign.rows, shown=not quiet),
            here or contextlib.nullcontext(), campaign,
        ):
            if here:
                here.check(campaign.book.facts)
            if not quiet:
                lines = [campaign_heading(options, workers), *campaign.notes]
                progress.console.print('\n'.join(lines), soft_wrap=True, markup=False)
            for line in requirement_lines(campaign.check, quiet=quiet):
                progress.console.print(line, soft_wrap=True)
            if foxglove is not None:
                progress.console.print(f'live at ws://127.0.0.1:{foxglove}', soft_wrap=True)
            if here:
                _run_here(campaign, here, at_hand, foxglove)
            else:
                _run_on_workers(campaign, workers, at_hand)
        campaign.rows.sort(key=lambda row: row.index)
    console.print(campaign_summary(campaign.rows, options), soft_wrap=True)
    if as_json:
        print(json.dumps(summary_json(campaign.rows, options, options.runs), allow_nan=False))
    if at_hand.interrupted and len(campaign.rows) < options.runs:
        raise ToldInterrupt if campaign.rows else KeyboardInterrupt
    return campaign.rows


def _nothing() -> None:
    """Nothing to do while the program's process starts."""


def _run_here(
    campaign: Campaign, graphs: _Graphs, at_hand: _Interruption, foxglove: int | None
) -> None:
    """Make the runs of an open campaign one by one."""
    with interrupts(at_hand.interrupt):
        while campaign.unfinished and not at_hand.interrupted:
            with graphs.next() as graph, _view(foxglove, graph):
                at_hand.take(graph)
                graph.run(campaign.requests(), campaign.take)
                at_hand.graph = None


def _run_on_workers(campaign: Campaign, workers: int, at_hand: _Interruption) -> None:
    """Make the runs of an open campaign on worker processes, as a search does."""
    from taxinet_ros.nodes.graph.worker import campaign_worker_command

    options = campaign.options
    command = campaign_worker_command(options, campaign.book.facts)
    with (
        interrupts(at_hand.interrupt),
        WorkerPool(command, workers, options.out / 'logs') as pool,
    ):
        run_search(_Scenes(campaign, at_hand), pool)


class _Scenes:
    """The scenes of a campaign in their order, as what a pool of workers runs."""

    def __init__(self, campaign: Campaign, at_hand: _Interruption) -> None:
        self._campaign, self._at_hand = campaign, at_hand
        self._requests = campaign.requests()

    @property
    def interrupted(self) -> bool:
        return self._at_hand.interrupted

    def next(self) -> RunRequest | None:
        more = self._campaign.unfinished and not self.interrupted
        return next(self._requests, None) if more else None

    def take(self, request: RunRequest, result: RunResult) -> None:
        self._campaign.take(request, result)


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
        self._system = options.system(
            check_controller(options.controller, options.gains, graph=True),
            find_world(options.world).fingerprint,
        )

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
        recorded = recorded_system(self._options, facts)
        for role in ('controller', 'world'):
            if getattr(recorded, f'{role}_sha256') != getattr(self._system, f'{role}_sha256'):
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
            return _loop(options, self._system)
        from taxinet_ros.nodes.graph.runner import campaign_graph, composed_graph, process_graph

        graph = campaign_graph(options, self._system)
        if options.processes:
            return process_graph(graph, options.out / 'logs')
        return composed_graph(graph)


@contextlib.contextmanager
def _loop(options: CampaignOptions, system: System) -> Iterator[Graph]:
    """The loop without ROS, used as a graph; it is this process that runs."""
    def audit() -> list[str]:
        from taxinet_ros.nodes.graph.worker import audit_command

        return audit_command(options, system)

    loop = Loop(system, options.bag_folder, options.images)
    with Auditor(audit, options.out, options.audit_percent) as auditor:
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
        self._loop.interrupt()


class _Interruption:
    """The graph whose run is ended in order on an interrupt."""

    def __init__(self) -> None:
        self.interrupted = False
        self.graph: Graph | None = None

    def interrupt(self) -> None:
        self.interrupted = True
        if self.graph is not None:
            self.graph.interrupt()

    def take(self, graph: Graph) -> None:
        """Set the graph; end its run if an interrupt came before."""
        self.graph = graph
        if self.interrupted:
            graph.interrupt()
