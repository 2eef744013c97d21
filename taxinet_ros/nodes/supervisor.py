"""The node that looks after a graph of processes: waits for it, watches it, mends or ends it."""

from __future__ import annotations

import enum
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future

from taxinet_ros.core.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.domain import another_graph, clock_keepers
from taxinet_ros.nodes.node_process import NodeProcess
from taxinet_ros.nodes.presence import End, ends_of, missing
from taxinet_ros.nodes.run_watch import RunWatch
from taxinet_ros.nodes.watched_node import Pulse, RestartLimit, State, WatchedNode, is_stopped

_TICK_S = 0.1
_KILL_AFTER = 3.0
"""A node that is silent so many times the allowed time is taken for dead."""

_END_OF_RUN_S, _END_HEARD_S = 5.0, 20.0
"""How long the end of a run is awaited: of a silent simulator, and of one that is heard still."""

_HEARD_S = 1.0


class Restart(enum.StrEnum):
    """What becomes of a node that ended without being asked to."""

    NEVER = 'never'
    ON_FAILURE = 'on-failure'


@dataclass(frozen=True, kw_only=True)
class Care:
    """How a graph is looked after.

    Attributes:
        restart: what becomes of a node that died.
        limit: most new starts of a node within ``window_s``.
        window_s: see ``limit`` [s].
        ready_s: longest time until the graph is whole [s].
        silent_s: silence after which a node is named [s]; after three times that it is killed,
            where dead nodes are started anew.
    """

    restart: Restart = Restart.ON_FAILURE
    limit: int = 3
    window_s: float = 60.0
    ready_s: float = 30.0
    silent_s: float = 10.0


class GraphLostError(Exception):
    """The graph cannot go on. The message is one line."""


class Supervisor(Node):
    """Looks after processes that are nodes of one graph.

    Attributes:
        nodes: what is known of each node.
        runs: what is heard of the runs.
        ready: whether the whole graph has been there.
        ended: done when there is nothing left to look after; raises :class:`GraphLostError`, or
            :class:`UsageError` for a mistake of the user's.
    """

    def __init__(
        self, processes: list[NodeProcess], care: Care, say: Callable[[str], None], **node: Any
    ) -> None:
        """Begin to watch.

        Args:
            processes: that were started just now.
            care: how to look after them.
            say: takes a line about whatever happens.
            node: goes to :class:`rclpy.node.Node`.
        """
        super().__init__(interface.SUPERVISOR, start_parameter_services=False, **node)
        times = care.limit if care.restart is Restart.ON_FAILURE else 0
        self.nodes = [
            WatchedNode(
                process=process, pulse=Pulse(self, process.name),
                limit=RestartLimit(times, care.window_s),
            )
            for process in processes
        ]
        self._names = [watched.name for watched in self.nodes]
        self._care, self._say = care, say
        self.runs = RunWatch(self, say)
        self.ready = False
        self.ended = Future()
        self._end_by_s: float | None = None
        self._strangers: list[str] = []
        now_s = time.monotonic()
        for watched in self.nodes:
            watched.begin(now_s)
        self.create_timer(_TICK_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def stop(self) -> None:
        """End the run at hand in order, if there is one, and then ``ended`` is done."""
        self._end_by_s = time.monotonic() + (_END_OF_RUN_S if self.runs.interrupt() else 0.0)

    def close(self) -> None:
        """Nothing is lost with this node."""

    def _tick(self) -> None:
        if self.ended.done():
            return
        try:
            self._look(time.monotonic())
        except (GraphLostError, UsageError) as error:
            self.ended.set_exception(error)

    def _look(self, now_s: float) -> None:
        if self._end_by_s is not None:
            self._see_run_end(self._end_by_s, now_s)
            return
        for watched in self.nodes:
            if watched.process.dead:
                self._bury(watched, now_s)
            elif watched.state is not State.STARTING:
                self._feel(watched, now_s)
            else:
                watched.pulse.ask(now_s)
        self._look_for_strangers()
        if any(watched.state is State.STARTING for watched in self.nodes):
            self._wait(now_s)

    # Getting ready ---------------------------------------------------------------------------

    def _wait(self, now_s: float) -> None:
        """See which of the nodes that have been started are all there."""
        why = missing(self, self._names, self._gone())
        for watched in self.nodes:
            if watched.state is not State.STARTING:
                continue
            if watched.name not in why and watched.pulse.answered:
                watched.become(State.READY, now_s)
                if self.ready:
                    self._say(f'{watched.name} is ready again')
        late = [
            watched for watched in self.nodes
            if watched.state is State.STARTING and now_s - watched.started_s > self._care.ready_s
        ]
        if late:
            words = '; '.join(f'{w.name} {why.get(w.name, "does not answer")}' for w in late)
            limit = f'not ready within {self._care.ready_s:g} s'
            raise GraphLostError(f'{limit}: {words}; {_logs(late)}')
        if not self.ready and all(watched.state is State.READY for watched in self.nodes):
            self.ready = True
            self._say(f'ready: {", ".join(self._names)}')

    def _gone(self) -> set[End]:
        """Ends of all processes that died."""
        return {end for watched in self.nodes for end in watched.gone}

    def _look_for_strangers(self) -> None:
        """Somebody else's clock would drive every node that goes by simulated time."""
        keepers = clock_keepers(self)
        gone = self._gone()
        own = f'{self.get_namespace().rstrip("/")}/{interface.SIMULATOR}'
        strangers = [name for name in keepers if name != own]
        live = [
            end for end in self.get_publishers_info_by_topic(interface.CLOCK.name)
            if tuple(end.endpoint_gid) not in gone
        ]
        # What a simulator that died early leaves behind may be found later than its death.
        if not strangers and len(live) > 1 and not any(watched.restarts for watched in self.nodes):
            strangers = [f'another {own}']
        if strangers == self._strangers:
            return
        self._strangers = strangers
        if strangers and not self.ready:
            raise UsageError(another_graph(self.context.get_domain_id(), strangers))
        if strangers:
            self._say(f'{" and ".join(strangers)} publishes /clock too: runs may break')

    # Death and silence -----------------------------------------------------------------------

    def _bury(self, watched: WatchedNode, now_s: float) -> None:
        """Name the dead, have its run ended, and start it anew if that is allowed."""
        if watched.state is State.DEAD:
            return
        detail = watched.process.obituary()
        watched.become(State.DEAD, now_s)
        if watched.process.ours and watched.process.process.returncode == 2:
            raise UsageError(watched.process.complaint())
        self.runs.mourn(watched.name, detail)
        number = watched.limit.spend(now_s)
        if not number:
            raise GraphLostError(self._too_often(watched, detail))
        self._say(
            f'{watched.name} died: {detail}; started again '
            f'({number} of {self._care.limit} in {self._care.window_s:g} s)'
        )
        watched.gone |= ends_of(self, watched.name)
        watched.process.start()
        watched.restarts += 1
        watched.begin(now_s)

    def _too_often(self, watched: WatchedNode, detail: str) -> str:
        words = f'{watched.name} died: {detail}'
        if self._care.restart is Restart.ON_FAILURE:
            words += f'; it has died {self._care.limit + 1} times in {self._care.window_s:g} s'
        return f'{words}; {_logs([watched])}'

    def _feel(self, watched: WatchedNode, now_s: float) -> None:
        """Name a node that does not answer, and one that answers again."""
        watched.pulse.ask(now_s)
        silence_s = now_s - watched.pulse.heard_s
        if silence_s <= self._care.silent_s:
            if watched.state is State.SILENT:
                self._say(f'{watched.name} answers again')
                watched.become(State.READY, now_s)
        elif watched.state is not State.SILENT:
            watched.become(State.SILENT, now_s)
            self._say(f'{watched.name} is silent: {self._why_silent(watched)}')
        elif (
            self._care.restart is Restart.ON_FAILURE
            and silence_s > _KILL_AFTER * self._care.silent_s
        ):
            self._say(f'{watched.name} is killed: silent for {silence_s:.0f} s')
            watched.process.kill()

    def _why_silent(self, watched: WatchedNode) -> str:
        pid = watched.process.process.pid
        if is_stopped(pid):
            return f'its process is stopped; kill -CONT {pid} wakes it'
        return f'no answer for {self._care.silent_s:g} s'

    # The end ---------------------------------------------------------------------------------

    def _see_run_end(self, end_by_s: float, now_s: float) -> None:
        """Leave when the run at hand has ended, and its bag is closed."""
        over = bool(self.runs.last_run) and not self.runs.run_id
        if over and (self.runs.closed or interface.RECORDER not in self._names):
            self.ended.set_result(None)  # the simulator waits until its answer is out
            return
        # On a busy machine a step may take its time; a simulator that is heard has not forgotten.
        busy = bool(self.runs.run_id) and now_s - self.runs.heard_s < _HEARD_S
        if now_s >= end_by_s + (_END_HEARD_S - _END_OF_RUN_S if busy else 0.0):
            self.ended.set_result(None)


def _logs(nodes: list[WatchedNode]) -> str:
    return f'see {", ".join(str(watched.process.log) for watched in nodes)}'
