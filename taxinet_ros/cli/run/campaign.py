"""``taxinet run``: a campaign here or on workers, with a bar, one line per run, and a summary."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import functools
import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task
from rich.text import Text

from taxinet_ros.cli.progress import print_rows_if_lost
from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.camera import camera
from taxinet_ros.core.mtl.interval import rho_text
from taxinet_ros.core.perception.perception import GroundTruth
from taxinet_ros.core.system import System
from taxinet_ros.core.topics import PARTICIPANTS
from taxinet_ros.core.user_code import EXTERNAL, command_of
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes.graph.worker import audit_command, campaign_worker_command
from taxinet_ros.processes.interrupts import ToldInterrupt, interrupts
from taxinet_ros.samplers.sampler import MOST_LAG
from taxinet_ros.trials.campaign import ProgramOrder, exit_code
from taxinet_ros.trials.engine import Engine, run_search
from taxinet_ros.trials.options import GRAPH, LOOP, CampaignOptions
from taxinet_ros.trials.rates import failure_rate
from taxinet_ros.trials.record.facts import recorded_system
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.summary import (
    campaign_heading,
    campaign_summary,
    requirement_lines,
    row_headings,
    row_line,
    summary_json,
)
from taxinet_ros.trials.worker_pool import WorkerPool

_REFRESH_PER_S = 2.0

if TYPE_CHECKING:
    from threading import Thread

    from taxinet_ros.nodes.graph.runner import Graph
    from taxinet_ros.trials.audit import Auditor
    from taxinet_ros.trials.cluster.pool import ClusterPool
    from taxinet_ros.trials.loop_run import Loop


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
    engine = make_campaign(options, foxglove, quiet=quiet, as_json=as_json)
    return exit_code(engine.summary)


def with_run_workers(
    options: CampaignOptions, workers: int, foxglove: int | None
) -> CampaignOptions:
    """The options with the number of workers of ``taxinet run``.

    Raises:
        UsageError: out of range, without effect, or with something that there is only one of.
    """
    if not 1 <= workers <= MOST_LAG:
        raise UsageError(f'--workers {workers}: needs to be within 1..{MOST_LAG}')
    if workers == 1:
        return options
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
    return dataclasses.replace(options, workers=workers)


def make_campaign(
    options: CampaignOptions, foxglove: int | None = None, *, quiet: bool = False,
    as_json: bool = False,
) -> Engine[ProgramOrder]:
    """Run and print a campaign.

    Raises:
        KeyboardInterrupt: interrupted with runs left.
    """
    console = Console(emoji=False, highlight=False, stderr=as_json)

    def show(row: RunRow) -> None:
        if not quiet:
            console.print(row_line(row, scenes.check.shared), soft_wrap=True)

    here = None if _runs_elsewhere(options, foxglove) else _Graphs(options)
    scenes = ProgramOrder(options, here.make_ahead if here else lambda: None)
    engine = Engine(scenes, PARTICIPANTS, show)
    with (
        print_rows_if_lost(console, engine.summary, engine.rows.latest if quiet else ()),
        here or contextlib.nullcontext(), engine,
    ):
        if here:
            here.check(engine.book.facts)
        if not quiet:
            lines = [campaign_heading(options), *scenes.notes]
            if here is None and options.workers == 1:
                lines[0] = campaign_heading(options, 'one worker process')
                lines.append(f'your functions print to {options.out}/logs/worker-1.log')
            console.print('\n'.join(lines), soft_wrap=True, markup=False)
        live = [] if foxglove is None else [f'live at ws://127.0.0.1:{foxglove}']
        above = [] if quiet else row_headings(scenes.check, options.runs)
        for line in (*requirement_lines(scenes.check, quiet=quiet), *live, *above):
            console.print(line, soft_wrap=True)
        with search_view(console, engine, shown=console.is_terminal):
            if here:
                _run_here(engine, here, foxglove)
            else:
                run_on_workers(engine)
    found = engine.summary
    console.print(campaign_summary(found, options), soft_wrap=True)
    if as_json:
        print(json.dumps(summary_json(found, options, options.runs), allow_nan=False))
    if engine.interrupted and len(found) < options.runs:
        raise ToldInterrupt if found else KeyboardInterrupt
    return engine


def _runs_elsewhere(options: CampaignOptions, foxglove: int | None) -> bool:
    """Whether worker processes make the runs: several, or one that user code may crash or hang."""
    if options.workers > 1:
        return True
    alone = options.processes or options.timing.free or options.standing_graph or foxglove
    parts = options.perception, options.controller, options.world
    return not alone and EXTERNAL not in parts and any('.py:' in part for part in parts)


def _run_here(engine: Engine[ProgramOrder], graphs: _Graphs, foxglove: int | None) -> None:
    """Make the runs of an open campaign one by one."""
    running: list[Graph] = []

    def interrupt() -> None:
        engine.interrupt()
        for graph in running:
            graph.interrupt()

    with interrupts(interrupt):
        while not engine.ended:
            with graphs.next() as graph, _view(foxglove, graph):
                running.append(graph)
                graph.run(iter(engine.next, None), engine.take)
                running.clear()


def run_on_workers(engine: Engine[Any], cluster: ClusterPool | None = None) -> None:
    """Make the runs of an open campaign on its workers; Ctrl-C ends it in order."""
    with interrupts(engine.interrupt), _pool(engine, cluster) as pool:
        run_search(engine, pool)


def _pool(
    engine: Engine[Any], cluster: ClusterPool | None
) -> contextlib.AbstractContextManager[WorkerPool | ClusterPool]:
    options, facts = engine.options, engine.book.facts
    if cluster is None:
        command = campaign_worker_command(options, facts)
        return WorkerPool(command, options.workers, options.out / 'logs')
    from taxinet_ros.trials.cluster.machine import OUT

    elsewhere = dataclasses.replace(options, out=Path(OUT))
    command = campaign_worker_command(elsewhere, facts)
    return cluster.making(command, facts, engine.book.add_machine)


def _view(port: int | None, graph: Graph) -> contextlib.AbstractContextManager[None]:
    if port is None:
        return contextlib.nullcontext()
    from taxinet_ros.nodes.graph.foxglove_view import foxglove_view

    return foxglove_view(port, graph.domain)


@contextlib.contextmanager
def search_view(console: Console, search: Engine[Any], *, shown: bool) -> Iterator[None]:
    """Context that shows the search live; with ``shown`` False, nothing."""
    columns = BarColumn(bar_width=10), MofNCompleteColumn(), _Figures(search)
    with Progress(
        *columns, console=console, transient=True, disable=not shown,
        refresh_per_second=_REFRESH_PER_S,
    ) as progress:
        progress.add_task('', total=search.options.runs)
        yield


class _Figures(ProgressColumn):
    """Figures beside the bar: failures, pace, time left, lowest robustness, failure rate."""

    def __init__(self, search: Engine[Any]) -> None:
        super().__init__()
        self._search = search
        self._began = time.monotonic()
        self._before = len(search.rows)

    def render(self, task: Task) -> Text:
        """Render the current figures."""
        task.completed = len(self._search.summary)
        return Text('  '.join(self._words()), no_wrap=True, overflow='ellipsis')

    def _words(self) -> Iterator[str]:
        search, seen = self._search, self._search.summary
        minutes = max((time.monotonic() - self._began) / 60, 1e-3)
        pace = (len(seen) - self._before) / minutes
        yield f'{seen.outcomes[Outcome.FAIL]} failed'
        yield f'{pace:.3g}/min'
        if pace > 0:
            left = search.options.runs - len(seen)
            yield f'{datetime.timedelta(seconds=round(60 * left / pace))} left'
        if seen:
            worst = seen.worst
            least = math.nan if worst is None else worst.shown.upper
            yield f'lowest rho {rho_text(least)}'
        if len(seen) < search.options.runs:  # else it is about to vanish, and takes long once
            # A viewer may stop at any time: use the interval that is valid at every look.
            planned = search.first_planned or range(0)
            found = failure_rate(seen.verdicts, range(planned.start, 0, planned.step)).rate
            if found is not None:
                yield f'failing {found.rate:.0%} ({found.low:.0%}-{found.high:.0%})'
        if search.interrupted:
            yield 'ending the current runs'


class _Graphs:
    """The graphs of a campaign, one at a time: a new one after each infrastructure error."""

    def __init__(self, options: CampaignOptions) -> None:
        self._options = options
        self._ahead = contextlib.ExitStack()
        self._made: Graph | None = None
        self._shared: Thread | None = None
        self._system = options.alone(
            controller_sha256=check_controller(options.controller, options.gains, graph=True),
            world_sha256=find_world(options.world).fingerprint,
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
            self._shared = camera.prepare()
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
            if self._shared is not None:  # so that no run's speed is that of this
                self._shared.join()
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
    # Reading bags, which a graph does not do, takes 50 ms to import.
    from taxinet_ros.trials.audit import Auditor
    from taxinet_ros.trials.loop_run import Loop

    loop = Loop(system, options.bag_folder, options.images)
    command = functools.partial(audit_command, options, system)
    with Auditor(command, options.out, options.audit_percent) as auditor:
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
