"""Node that supervises a graph of processes: waits until ready, restarts dead nodes, or ends it."""

from __future__ import annotations

import collections
import enum
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import qos_profile_action_status_default
from rclpy.task import Future
from taxinet_msgs.msg import NodeStatus, RunStatus

from taxinet_ros.bag.run.message_values import stamp_of
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import InfraKind, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.node_process import NodeProcess
from taxinet_ros.nodes.lockstep.observer import AT_LEISURE
from taxinet_ros.nodes.messages.convert import death_notice, lost_run_status
from taxinet_ros.nodes.running.domain import missing_nodes, publisher_names

_TICK_S = 0.1
_END_OF_RUN_S = 20.0
"""Maximum wait [s] for the end of the current run when the graph ends."""
_CANCEL = interface.RUN_SCENARIO_TYPE.Impl.CancelGoalService


class Restart(enum.StrEnum):
    """What to do when a node ends unexpectedly."""

    NEVER = 'never'
    ON_FAILURE = 'on-failure'


class GraphLostError(Exception):
    """The graph cannot continue. The message is one line."""


class RestartLimit:
    """Limits the number of restarts within a time window."""

    def __init__(self, times: int, window_s: float) -> None:
        """Allow ``times`` restarts (0 for none) within any ``window_s`` [s]."""
        self.times, self.window_s = times, window_s
        self._starts: collections.deque[float] = collections.deque()

    def spend(self, now_s: float) -> int:
        """Request a restart at a time of the monotonic clock [s].

        Returns:
            Its number within the limit, from 1; 0 if the limit is reached.
        """
        while self._starts and now_s - self._starts[0] > self.window_s:
            self._starts.popleft()
        if len(self._starts) >= self.times:
            return 0
        self._starts.append(now_s)
        return len(self._starts)


@dataclass(kw_only=True)
class WatchedNode:
    """A supervised node and its process.

    Attributes:
        process: the node's process.
        limit: its restart limit.
        since_s: time of its last start, monotonic clock [s].
        restarts: number of restarts so far.
    """

    process: NodeProcess
    limit: RestartLimit
    since_s: float
    restarts: int = 0

    @property
    def name(self) -> str:
        """The node's name."""
        return self.process.name


class RunWatch:
    """Follows the runs of a graph, reports deaths to them, and can end the current one.

    Subscribes only to latched topics and to those of the action, which no node counts.

    Attributes:
        run_id: the current run, or ''.
        running: whether it has started.
        seq: its latest control step.
        asked: whether the simulator is at work on a run; it is until the run's bag is closed.
        outcomes: number of runs by outcome.
    """

    def __init__(
        self, node: Node, say: Callable[[str], None], on_silent: Callable[[str], None]
    ) -> None:
        """Communicate through ``node``.

        Args:
            node: the supervisor.
            say: called with a line when a run has ended.
            on_silent: called with the name of a node whose silence ended a run.
        """
        self._node, self._say, self._on_silent = node, say, on_silent
        self.run_id = ''
        self.running = self.asked = False
        self.seq = self._now_ns = 0
        self.outcomes: collections.Counter[str] = collections.Counter()
        action, messages = interface.RUN_SCENARIO, interface.RUN_SCENARIO_TYPE.Impl
        runs, deaths = interface.RUN_STATUS, interface.OBITUARY
        node.create_subscription(RunStatus, runs.name, self._on_run, runs.qos)
        node.create_subscription(
            messages.FeedbackMessage, f'{action}/_action/feedback', self._on_feedback, AT_LEISURE
        )
        node.create_subscription(
            messages.GoalStatusMessage, f'{action}/_action/status', self._on_goals,
            qos_profile_action_status_default,
        )
        node.create_subscription(NodeStatus, deaths.name, self._on_death_notice, deaths.qos)
        self._death_notices = node.create_publisher(NodeStatus, deaths.name, deaths.qos)
        self._cancel = node.create_client(_CANCEL, f'{action}/_action/cancel_goal')

    def report_death(self, name: str, detail: str) -> None:
        """Report a dead node process: the current run ends at once with this reason."""
        if name == interface.SIMULATOR:
            self.asked = False
        if self.run_id:
            self._death_notices.publish(death_notice(
                self.run_id, name, detail, seq=self.seq, stamp_ns=self._now_ns
            ))

    def interrupt(self) -> bool:
        """End the current run as INTERRUPTED, whoever requested it; False if there is none.

        An empty request cancels all goals (definition of action_msgs/srv/CancelGoal).
        """
        if not self.asked or not self._cancel.service_is_ready():
            return False
        self._cancel.call_async(_CANCEL.Request())
        return True

    def _on_run(self, status: RunStatus) -> None:
        if status.state == RunStatus.ENDED:
            self._end(status)
        # rclpy does not say who sent it: beside a player it is a run that is played back.
        elif set(publisher_names(self._node, interface.RUN_STATUS)) <= {interface.SIMULATOR}:
            self.run_id, self.seq = status.run_id, status.seq
            self._now_ns = stamp_of(status)
            self.running = status.state == RunStatus.RUNNING

    def _end(self, status: RunStatus) -> None:
        if not self.run_id or status.run_id != self.run_id:
            return
        self.run_id, self.running = '', False
        self.outcomes[str(status.outcome)] += 1
        words = [str(status.outcome), status.kind, status.who, status.detail]
        self._say(f'run {status.run_id}: {" ".join(word for word in words if word)}')
        if status.kind == InfraKind.TIMEOUT:
            self._on_silent(status.who)

    def _on_death_notice(self, notice: NodeStatus) -> None:
        if notice.node == interface.SIMULATOR:
            self._end(lost_run_status(notice))

    def _on_goals(self, goals: Any) -> None:
        # Accepted, executing or canceling; those that have ended have higher numbers.
        last = GoalStatus.STATUS_CANCELING
        self.asked = any(one.status <= last for one in goals.status_list)

    def _on_feedback(self, message: Any) -> None:
        if self.run_id:
            self.seq = message.feedback.seq
            self._now_ns = round(message.feedback.elapsed * NS_PER_S)


class Supervisor(Node):
    """Supervises the processes of one graph.

    Attributes:
        nodes: state of each node.
        runs: observed runs.
        ready: whether the graph was complete once.
        ended: done when there is nothing left to supervise; raises :class:`GraphLostError`, or
            :class:`UsageError` for invalid input.
    """

    def __init__(
        self, processes: list[NodeProcess], say: Callable[[str], None], *,
        restart: Restart = Restart.ON_FAILURE, limit: int = 3, window_s: float = 60.0,
        ready_s: float = 30.0, **node: Any,
    ) -> None:
        """Start supervision of processes just started.

        Args:
            processes: the processes of the graph.
            say: called with a line per event.
            restart: what to do when a node dies, or its silence ends a run.
            limit: maximum number of restarts of a node within ``window_s``.
            window_s: see ``limit`` [s].
            ready_s: timeout until the graph is complete for the first time [s].
            node: goes to :class:`rclpy.node.Node`.
        """
        super().__init__(interface.SUPERVISOR, start_parameter_services=False, **node)
        self._restart, self._limit, self._window_s = restart, limit, window_s
        self._ready_s, self._say = ready_s, say
        times = limit if restart is Restart.ON_FAILURE else 0
        now_s = time.monotonic()
        self.nodes = [
            WatchedNode(process=process, limit=RestartLimit(times, window_s), since_s=now_s)
            for process in processes
        ]
        self._names = [watched.name for watched in self.nodes]
        self.runs = RunWatch(self, say, self._kill_silent)
        self.ready = False
        self.ended = Future()
        self._end_by_s: float | None = None
        self._stopped = False
        self.create_timer(_TICK_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    # Signal handlers call this. The code that they interrupt may hold locks of rclpy.

    def stop(self) -> None:
        """Soon end the current run in order, if any; then ``ended`` is done."""
        self._stopped = True

    def close(self) -> None:
        """Release the node."""

    def _tick(self) -> None:
        if self.ended.done():
            return
        now_s = time.monotonic()
        if self._stopped and self._end_by_s is None:
            self._end_by_s = now_s + (_END_OF_RUN_S if self.runs.interrupt() else 0.0)
        if self._end_by_s is not None:
            if not self.runs.asked or now_s >= self._end_by_s:
                self.ended.set_result(None)  # the simulator waits until its answer is sent
            return
        try:
            for watched in self.nodes:
                if watched.process.dead:
                    self._handle_death(watched, now_s)
            if not self.ready:
                self._wait(now_s)
        except (GraphLostError, UsageError) as error:
            self.ended.set_exception(error)

    def _wait(self, now_s: float) -> None:
        """Check whether the graph is complete for the first time; a run waits for it later."""
        why = missing_nodes(self, self._names)
        late = [w for w in self.nodes if w.name in why and now_s - w.since_s > self._ready_s]
        if late:
            words = '; '.join(f'{watched.name} {why[watched.name]}' for watched in late)
            limit = f'not ready within {self._ready_s:g} s'
            raise GraphLostError(f'{limit}: {words}; {_logs(late)}')
        if not why:
            self.ready = True
            self._say(f'ready: {", ".join(self._names)}')

    def _handle_death(self, watched: WatchedNode, now_s: float) -> None:
        """Report a dead node, end its run, and restart it if allowed."""
        detail = watched.process.how_it_ended()
        if watched.process.refused:
            raise UsageError(watched.process.refused)
        self.runs.report_death(watched.name, detail)
        number = watched.limit.spend(now_s)
        if not number:
            words = f'{watched.name} died: {detail}'
            if self._restart is Restart.ON_FAILURE:
                words += f'; it has died {self._limit + 1} times in {self._window_s:g} s'
            raise GraphLostError(f'{words}; {_logs([watched])}')
        self._say(
            f'{watched.name} died: {detail}; restarted ({number} of {self._limit} in '
            f'{self._window_s:g} s)'
        )
        watched.process.start()
        watched.restarts += 1
        watched.since_s = now_s

    def _kill_silent(self, name: str) -> None:
        """Have a node that hangs started again."""
        for watched in self.nodes:
            if watched.name == name and self._restart is Restart.ON_FAILURE:
                self._say(f'{name} is killed: its silence ended the run')
                watched.process.kill()


def _logs(nodes: list[WatchedNode]) -> str:
    return f'see {", ".join(str(watched.process.log) for watched in nodes)}'
