"""What ``taxinet up`` shows: a live status table of supervised node processes."""

from __future__ import annotations

import contextlib
import datetime
import os
import shlex
import shutil
import time
from collections.abc import Iterator

import psutil
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from taxinet_ros.core.user_code import EXTERNAL
from taxinet_ros.core.world import find_world
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions
from taxinet_ros.nodes.graph.standing import remaps_into
from taxinet_ros.nodes.graph.supervisor import Supervisor, WatchedNode
from taxinet_ros.nodes.running.domain import DISCOVERY_RANGE, LOCALHOST
from taxinet_ros.registry import KMWH

_REFRESH_PER_S = 2.0


class UpView:
    """Terminal view of one graph."""

    def __init__(
        self, console: Console, graph: GraphOptions, *, record: bool = True, namespace: str = '/'
    ) -> None:
        """Show it on ``console``; arguments as of :func:`.run_standing_graph`."""
        self._console, self._graph = console, graph
        self._record, self._namespace = record, namespace
        self._remaps = remaps_into(namespace)
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
        what = 'bags and logs' if self._record else 'nothing recorded; logs'
        if self._remaps:
            where += f'; namespace {self._namespace}'
        graph = self._graph
        there = '' if graph.world == KMWH else f'; world {graph.world}'
        if again := find_world(graph.world).again_words:
            there += f' ({again}, so every frame is recorded)' if self._record else ''
        return [
            f'ROS domain {domain}, {where}; perception {graph.perception}{there}; '
            f'{what} in {graph.out}',
            *(
                f'start it yourself in ROS domain {domain}: a node named {name}'
                for name, word in graph.elsewhere.items() if word == EXTERNAL
            ),
            'to run scenes, in another terminal:',
            f'  {self._invitation(domain)}',
        ]

    def _invitation(self, domain: int) -> str:
        start = 'ros2 run taxinet_ros' if shutil.which('ros2') else 'taxinet node'
        # Two nodes on one machine may not discover each other if only one is limited to it.
        reach = f'{DISCOVERY_RANGE}={os.environ[DISCOVERY_RANGE]}'
        words = f'{reach} ROS_DOMAIN_ID={domain} {start} scenario_sampler --ros-args -p runs:=10'
        if not self._record:
            names = [name for name in interface.PARTICIPANTS if name != interface.RECORDER]
            participants = f'participants:=[{",".join(names)}]'
            words += f' -p {shlex.quote(participants)}'
        return ' '.join([words, *(f'-r {rule}' for rule in self._remaps)])

    def picture(self, supervisor: Supervisor, now_s: float) -> RenderableType:
        """Table of the nodes, and a status line of the runs."""
        table = Table(box=None, pad_edge=False, header_style='dim')
        table.add_column('node', min_width=20)
        for name in ('since', 'process', 'memory', 'restarts'):
            table.add_column(name, justify='right', min_width=9)
        for watched in supervisor.nodes:
            table.add_row(*_row(watched, now_s))
        return Padding(Group(table, Text(), _runs(supervisor), Text(
            'Ctrl-C ends the current run and the graph', style='dim',
        )), (1, 0, 0, 0))


def _row(watched: WatchedNode, now_s: float) -> list[RenderableType]:
    pid = watched.process.pid
    memory = ''
    with contextlib.suppress(psutil.Error):
        memory = f'{psutil.Process(pid).memory_info().rss / 1e6:.0f} MB'
    return [
        watched.name,
        _span(now_s - watched.since_s),
        str(pid),
        memory,
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
