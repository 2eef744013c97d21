"""``taxinet up``: keep a graph of supervised node processes up, with a live status table."""

from __future__ import annotations

import contextlib
import datetime
import os
import shlex
import shutil
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.user_code import EXTERNAL
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.nodes.graph.launch_plan import absolute_namespace
from taxinet_ros.nodes.graph.runner import GraphOptions
from taxinet_ros.nodes.graph.standing import UpOptions, run_standing_graph
from taxinet_ros.nodes.graph.supervisor import (
    GraphLostError,
    Restart,
    State,
    SupervisionOptions,
    Supervisor,
    WatchedNode,
    memory_mb,
)
from taxinet_ros.nodes.running.domain import BY_HAND, DISCOVERY_RANGE, LOCALHOST, domain_number
from taxinet_ros.processes.interrupts import interrupts
from taxinet_ros.registry import KMWH
from taxinet_ros.trials.options import (
    DEFAULT_ROOT,
    IMAGES,
    check_new,
    check_not_free,
    check_timing,
    new_folder,
    recorded_images,
    split_settings,
)

_REFRESH_PER_S = 2.0
_STYLES = {
    State.STARTING: 'yellow', State.READY: 'green', State.SILENT: 'red', State.DEAD: 'red',
}


class UpView:
    """Terminal view of one graph."""

    def __init__(self, console: Console, options: UpOptions) -> None:
        """Show it on ``console``."""
        self._console, self._options = console, options
        self._supervisor: Supervisor | None = None

    def say(self, line: str) -> None:
        """Print a line."""
        self._console.print(line, soft_wrap=True, markup=False)

    def stop(self) -> None:
        """For a signal: have the graph end, or what starts it."""
        if self._supervisor is None:
            raise KeyboardInterrupt
        self._supervisor.stop()

    @contextlib.contextmanager
    def watching(self, supervisor: Supervisor, domain: int) -> Iterator[None]:
        """Print where the graph runs; on a terminal, show a live table."""
        self._supervisor = supervisor
        for line in self._heading(domain):
            self.say(line)
        if not self._console.is_terminal:
            yield
            return
        with Live(
            console=self._console, refresh_per_second=_REFRESH_PER_S, transient=True,
            get_renderable=lambda: self.picture(supervisor, time.monotonic()),
        ):
            yield

    def _heading(self, domain: int) -> list[str]:
        reach = os.environ[DISCOVERY_RANGE]
        where = 'this machine only' if reach == LOCALHOST else f'discovery range {reach}'
        what = 'bags and logs' if self._options.record else 'nothing recorded; logs'
        if self._options.remaps:
            where += f'; namespace {self._options.namespace}'
        graph = self._options.graph
        there = '' if graph.world == KMWH else f'; world {graph.world}'
        if again := find_world(graph.world).again_words:
            there += f' ({again}, so every frame is recorded)' if self._options.record else ''
        return [
            f'ROS domain {domain}, {where}; perception {graph.perception}{there}; '
            f'{what} in {self._options.graph.out}',
            *(
                f'start it yourself in ROS domain {domain}: a node named {name}'
                for name, word in self._options.graph.elsewhere.items() if word == EXTERNAL
            ),
            'to run scenes, in another terminal:',
            f'  {self._invitation(domain)}',
        ]

    def _invitation(self, domain: int) -> str:
        start = 'ros2 run taxinet_ros' if shutil.which('ros2') else 'taxinet node'
        # Two nodes on one machine may not discover each other if only one is limited to it.
        reach = f'{DISCOVERY_RANGE}={os.environ[DISCOVERY_RANGE]}'
        words = f'{reach} ROS_DOMAIN_ID={domain} {start} scenario_sampler --ros-args -p runs:=10'
        if not self._options.record:
            names = f'participants:=[{",".join(self._options.participants)}]'
            words += f' -p {shlex.quote(names)}'
        return ' '.join([words, *(f'-r {rule}' for rule in self._options.remaps)])

    def picture(self, supervisor: Supervisor, now_s: float) -> RenderableType:
        """Table of the nodes, and a status line of the runs."""
        table = Table(box=None, pad_edge=False, header_style='dim')
        table.add_column('node', min_width=20)
        table.add_column('state', min_width=10)
        for name in ('since', 'process', 'memory', 'restarts'):
            table.add_column(name, justify='right', min_width=9)
        for watched in supervisor.nodes:
            table.add_row(*_row(watched, now_s))
        return Padding(Group(table, Text(), _runs(supervisor), Text(
            'Ctrl-C ends the current run and the graph', style='dim',
        )), (1, 0, 0, 0))


def _row(watched: WatchedNode, now_s: float) -> list[RenderableType]:
    pid = watched.process.pid
    memory = memory_mb(pid)
    return [
        watched.name,
        Text(watched.state, style=_STYLES[watched.state]),
        _span(now_s - watched.since_s),
        str(pid),
        '' if memory is None else f'{memory:.0f} MB',
        str(watched.restarts) if watched.restarts else '',
    ]


def _runs(supervisor: Supervisor) -> Text:
    runs = supervisor.runs
    if runs.running:
        words = [f'run {runs.run_id}: step {runs.seq}']
    elif runs.run_id:
        words = [f'run {runs.run_id}: starting']
    else:
        words = ['idle' if supervisor.ready else 'waiting for the nodes']
    words += [f'{number} {outcome}' for outcome, number in sorted(dict(runs.outcomes).items())]
    return Text('   '.join(words))


def _span(seconds: float) -> str:
    return str(datetime.timedelta(seconds=int(max(seconds, 0.0))))


_INFRA = 4


def make_up_options(
    *, perception: str, controller: str, out: Path | None, record: bool, images: str,
    settings: Iterable[str], restart: str, domain: int | None, silent_s: float,
    latency: Iterable[str] = (), free: bool = False, real_time_factor: str | None = None,
    namespace: str = '', world: str = KMWH,
) -> UpOptions:
    """Validate the options of ``taxinet up``, as its command line has them.

    Raises:
        UsageError: an option is invalid.
    """
    check_perception(perception, graph=True)
    if images not in IMAGES:
        raise UsageError(f'--images {images}: unknown; known: {", ".join(IMAGES)}')
    if restart not in list(Restart):
        raise UsageError(f'--restart {restart}: unknown; known: {", ".join(Restart)}')
    overrides, gains = split_settings(settings)
    if overrides:
        raise UsageError(
            f'--set {next(iter(overrides))}: scenario values are set by the sampler; use '
            'steering.<gain>=value'
        )
    check_controller(controller, gains, graph=True)
    timing = check_timing(latency, free=free, factor=real_time_factor)
    check_not_free(timing, controller)
    chosen = find_world(world)
    if domain is None and not os.environ.get(BY_HAND) and os.environ.get('ROS_DOMAIN_ID'):
        domain = domain_number(os.environ['ROS_DOMAIN_ID'], 'ROS_DOMAIN_ID')
    out = out or new_folder(DEFAULT_ROOT / 'up')
    check_new(out)
    return UpOptions(
        graph=GraphOptions(
            perception=perception,
            out=out,
            images=recorded_images(chosen, images),
            gains=gains,
            controller=controller,
            timing=timing,
            world=chosen.name,
        ),
        record=record,
        domain=domain,
        namespace=absolute_namespace(namespace, '--namespace '),
        care=SupervisionOptions(restart=Restart(restart), silent_s=silent_s),
    )


def run_up(options: UpOptions) -> int:
    """Keep the graph up until it is stopped.

    Returns:
        Exit code: that of the interrupt that stopped it; 4 if it could not be kept up.
    """
    view = UpView(Console(highlight=False), options)
    with interrupts(view.stop):
        try:
            run_standing_graph(options, view.say, view.watching)
            view.say('ended')
        except KeyboardInterrupt:
            view.say('killed')
        except GraphLostError as error:
            print(f'taxinet: error: {error}', file=sys.stderr)
            return _INFRA
    return ExitCode.INTERRUPTED
