"""Node that supervises a graph of processes: waits until ready, restarts nodes, or ends it.

Also here: the state of each supervised node, and the observed runs of the graph.
"""

from __future__ import annotations

import collections
import enum
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import psutil
from action_msgs.msg import GoalStatus
from rcl_interfaces.srv import GetParameters
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import qos_profile_action_status_default
from rclpy.task import Future
from taxinet_msgs.msg import NodeStatus, RunStatus

from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.node_process import NodeProcess
from taxinet_ros.nodes.lockstep.observer import AT_LEISURE
from taxinet_ros.nodes.messages.convert import death_notice, lost_run_status
from taxinet_ros.nodes.running.domain import End, ends_of, missing_nodes

_ASK_PERIOD_S = 1.0
_MOST_QUESTIONS = 60


class State(enum.StrEnum):
    """State of a node, also outside runs."""

    STARTING = 'starting'
    READY = 'ready'
    SILENT = 'silent'
    DEAD = 'dead'


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


class Pulse:
    """Liveness of a node, to detect one that hangs or is stopped, even outside runs.

    Sends an empty parameter request once a second, which the node's executor must answer.

    Attributes:
        heard_s: time of its last answer, monotonic clock [s].
        answered: whether it has answered since its process started.
    """

    def __init__(self, node: Node, name: str) -> None:
        """Query the node ``name`` from ``node``."""
        self._client = node.create_client(GetParameters, f'{name}/get_parameters')
        self._questions: collections.deque[Future] = collections.deque()
        self.heard_s = self._asked_s = 0.0
        self.answered = False

    def begin(self, now_s: float) -> None:
        """Reset at the start of its process: earlier requests will not be answered."""
        while self._questions:
            self._forget()
        self.answered = False
        self.heard_s = now_s

    def ask(self, now_s: float) -> None:
        """Send a request if one is due."""
        if now_s - self._asked_s < _ASK_PERIOD_S or not self._client.service_is_ready():
            return
        if len(self._questions) >= _MOST_QUESTIONS:
            self._forget()
        self._asked_s = now_s
        question = self._client.call_async(GetParameters.Request())
        question.add_done_callback(self._hear)
        self._questions.append(question)

    def _hear(self, question: Future) -> None:
        if not question.cancelled():
            self._questions.remove(question)
            self.heard_s, self.answered = time.monotonic(), True

    def _forget(self) -> None:
        self._client.remove_pending_request(self._questions.popleft())


@dataclass(kw_only=True)
class WatchedNode:
    """A supervised node, its process and its state.

    Attributes:
        process: the node's process.
        pulse: its liveness.
        limit: its restart limit.
        state: its state.
        since_s: time of entering the state, monotonic clock [s].
        started_s: time its process started, monotonic clock [s].
        restarts: number of restarts so far.
        gone: endpoints of its dead processes, which stay in the graph for a while.
    """

    process: NodeProcess
    pulse: Pulse
    limit: RestartLimit
    state: State = State.STARTING
    since_s: float = 0.0
    started_s: float = 0.0
    restarts: int = 0
    gone: set[End] = field(default_factory=set)

    @property
    def name(self) -> str:
        """The node's name."""
        return self.process.name

    def become(self, state: State, now_s: float) -> None:
        """Change its state."""
        self.state, self.since_s = state, now_s

    def begin(self, now_s: float) -> None:
        """Record that its process was started."""
        self.started_s = now_s
        self.pulse.begin(now_s)
        self.become(State.STARTING, now_s)


def is_stopped(pid: int) -> bool:
    """Whether a process is stopped by a signal or a debugger."""
    try:
        return psutil.Process(pid).status() in (psutil.STATUS_STOPPED, psutil.STATUS_TRACING_STOP)
    except psutil.Error:
        return False


def memory_mb(pid: int) -> float | None:
    """Resident memory (RSS) of a process [MB]; None if unknown."""
    try:
        return float(psutil.Process(pid).memory_info().rss / 1e6)
    except psutil.Error:
        return None


_CANCEL = interface.RUN_SCENARIO_TYPE.Impl.CancelGoalService


class RunWatch:
    """Follows the runs of a graph, reports deaths to it, and can end the current run.

    Subscribes only to latched topics and to those of the action, which no node counts. What is told
    of a run that the simulator was not asked for is a replay: rclpy does not say who sent it.

    Attributes:
        run_id: the current run, or ''.
        running: whether it has started.
        seq: its latest control step.
        heard_s: time of the simulator's last message, monotonic clock [s].
        last_run: the last finished run, or ''.
        outcomes: number of runs by outcome.
    """

    def __init__(self, node: Node, say: Callable[[str], None]) -> None:
        """Communicate through ``node``; call ``say`` with a line when a run has ended."""
        self._say = say
        self._node = node
        self._deaths: dict[str, tuple[str, set[End]]] = {}
        self._told: set[tuple[str, str]] = set()
        self.run_id = self.last_run = ''
        self.running = self.closed = False
        self.seq = 0
        self.heard_s = 0.0
        self._asked_for = False
        self.outcomes: collections.Counter[str] = collections.Counter()
        status, run_status = interface.NODE_STATUS, interface.RUN_STATUS
        node.create_subscription(RunStatus, run_status.name, self._on_run, run_status.qos)
        node.create_subscription(NodeStatus, status.name, self._on_status, status.qos)
        node.create_subscription(
            interface.RUN_SCENARIO_TYPE.Impl.FeedbackMessage,
            f'{interface.RUN_SCENARIO}/_action/feedback', self._on_feedback, AT_LEISURE,
        )
        obituaries = interface.OBITUARY
        node.create_subscription(NodeStatus, obituaries.name, self._on_death_notice, obituaries.qos)
        node.create_subscription(
            interface.RUN_SCENARIO_TYPE.Impl.GoalStatusMessage,
            f'{interface.RUN_SCENARIO}/_action/status', self._on_goals,
            qos_profile_action_status_default,
        )
        self._death_notices = node.create_publisher(NodeStatus, obituaries.name, obituaries.qos)
        self._cancel = node.create_client(_CANCEL, f'{interface.RUN_SCENARIO}/_action/cancel_goal')

    def report_death(self, name: str, detail: str) -> None:
        """Report a dead node process: the current run ends at once with this reason.

        A run counts as soon as it is started, even if it becomes known only after the death.
        """
        self._deaths[name] = detail, self._in_graph()
        if self.run_id:
            self._tell(name, detail)

    def _tell(self, name: str, detail: str) -> None:
        if (self.run_id, name) not in self._told:
            self._told.add((self.run_id, name))
            self._death_notices.publish(death_notice(self.run_id, name, detail, seq=self.seq))

    def interrupt(self) -> bool:
        """End the current run as INTERRUPTED, whoever requested it; False if there is none.

        An empty request cancels all goals (definition of action_msgs/srv/CancelGoal).
        """
        if not self.run_id or not self._cancel.service_is_ready():
            return False
        self._cancel.call_async(_CANCEL.Request())
        return True

    def _follow(self, run_id: str, *, running: bool) -> None:
        """Report earlier deaths that concern a run that has become known.

        If no node has joined since a death, the run belongs to the dead simulator, or started when
        the dead node was ready.
        """
        self.run_id = run_id
        for name, (detail, others) in self._deaths.items():
            if (running or name == interface.SIMULATOR) and self._in_graph() <= others:
                self._tell(name, detail)

    def _in_graph(self) -> set[End]:
        """Endpoints through which the simulator and lockstep nodes report runs."""
        return {
            tuple(end.endpoint_gid) for topic in (interface.RUN_STATUS, interface.NODE_STATUS)
            for end in self._node.get_publishers_info_by_topic(topic.name)
        }

    def _on_goals(self, goals: Any) -> None:
        # Accepted, executing or canceling; those that have ended have higher numbers.
        last = GoalStatus.STATUS_CANCELING
        self._asked_for = any(one.status <= last for one in goals.status_list)

    def _is_replay(self) -> bool:
        """Whether another node than those of a graph tells of runs, and none is under way."""
        return not self._asked_for and any(
            end.node_name not in topic.publishers
            for topic in (interface.RUN_STATUS, interface.NODE_STATUS)
            for end in self._node.get_publishers_info_by_topic(topic.name)
        )

    def _on_run(self, status: RunStatus) -> None:
        if status.state != RunStatus.ENDED:
            if self._is_replay():
                return
            self.running = status.state == RunStatus.RUNNING
            self.seq, self.closed = status.seq, False
            self._follow(status.run_id, running=self.running)
        else:
            self._end(status)

    def _end(self, status: RunStatus) -> None:
        if status.run_id == self.run_id:
            self.run_id, self.last_run, self.running = '', status.run_id, False
            self.outcomes[str(status.outcome)] += 1
            words = [str(status.outcome), status.kind, status.who, status.detail]
            self._say(f'run {status.run_id}: {" ".join(word for word in words if word)}')

    def _on_death_notice(self, notice: NodeStatus) -> None:
        if notice.node == interface.SIMULATOR:
            self._end(lost_run_status(notice))

    def _on_status(self, status: NodeStatus) -> None:
        # The simulator's messages about the run may be lost with it, but other nodes are ready for
        # it.
        new = not self.run_id and status.run_id != self.last_run
        if status.state == NodeStatus.READY and new and not self._is_replay():
            self._follow(status.run_id, running=False)
        if status.state == NodeStatus.DONE and status.run_id in (self.run_id, self.last_run):
            self.closed = True

    def _on_feedback(self, message: Any) -> None:
        self.heard_s = time.monotonic()
        if self.run_id:
            self.seq = message.feedback.seq


_TICK_S = 0.1
_KILL_AFTER = 3.0
"""A node silent for this multiple of the allowed time counts as dead."""
_END_OF_RUN_S, _END_HEARD_S = 5.0, 20.0
"""Timeouts for the end of a run: with a silent simulator, and with one still heard."""
_HEARD_S = 1.0


class Restart(enum.StrEnum):
    """What to do when a node ends unexpectedly."""

    NEVER = 'never'
    ON_FAILURE = 'on-failure'


class GraphLostError(Exception):
    """The graph cannot continue. The message is one line."""


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
        self,
        processes: list[NodeProcess],
        say: Callable[[str], None],
        *,
        restart: Restart = Restart.ON_FAILURE,
        limit: int = 3,
        window_s: float = 60.0,
        ready_s: float = 30.0,
        silent_s: float = 10.0,
        **node: Any,
    ) -> None:
        """Start supervision of processes just started.

        Args:
            processes: the processes of the graph.
            say: called with a line per event.
            restart: what to do when a node dies.
            limit: maximum number of restarts of a node within ``window_s``.
            window_s: see ``limit`` [s].
            ready_s: timeout until the graph is complete [s].
            silent_s: silence after which a node is reported [s]; after three times that it is
                killed, if dead nodes are restarted.
            node: goes to :class:`rclpy.node.Node`.
        """
        super().__init__(interface.SUPERVISOR, start_parameter_services=False, **node)
        times = limit if restart is Restart.ON_FAILURE else 0
        self.nodes = [
            WatchedNode(
                process=process, pulse=Pulse(self, process.name),
                limit=RestartLimit(times, window_s),
            )
            for process in processes
        ]
        self._names = [watched.name for watched in self.nodes]
        self._restart, self._limit, self._window_s = restart, limit, window_s
        self._ready_s, self._silent_s, self._say = ready_s, silent_s, say
        self.runs = RunWatch(self, say)
        self.ready = False
        self.ended = Future()
        self._end_by_s: float | None = None
        self._stopped = False
        now_s = time.monotonic()
        for watched in self.nodes:
            watched.begin(now_s)
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
        if self._stopped and self._end_by_s is None:
            self._end_by_s = time.monotonic() + (_END_OF_RUN_S if self.runs.interrupt() else 0.0)
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
                self._handle_death(watched, now_s)
            elif watched.state is not State.STARTING:
                self._check_answering(watched, now_s)
            else:
                watched.pulse.ask(now_s)
        if any(watched.state is State.STARTING for watched in self.nodes):
            self._wait(now_s)

    # Getting ready ---------------------------------------------------------------------------

    def _wait(self, now_s: float) -> None:
        """Check which of the started nodes are ready."""
        gone = {end for watched in self.nodes for end in watched.gone}
        why = missing_nodes(self, self._names, gone)
        for watched in self.nodes:
            if watched.state is not State.STARTING:
                continue
            if watched.name not in why and watched.pulse.answered:
                watched.become(State.READY, now_s)
                if self.ready:
                    self._say(f'{watched.name} is ready again')
        late = [
            watched for watched in self.nodes
            if watched.state is State.STARTING and now_s - watched.started_s > self._ready_s
        ]
        if late:
            words = '; '.join(f'{w.name} {why.get(w.name, "does not answer")}' for w in late)
            limit = f'not ready within {self._ready_s:g} s'
            raise GraphLostError(f'{limit}: {words}; {_logs(late)}')
        if not self.ready and all(watched.state is State.READY for watched in self.nodes):
            self.ready = True
            self._say(f'ready: {", ".join(self._names)}')

    # Death and silence -----------------------------------------------------------------------

    def _handle_death(self, watched: WatchedNode, now_s: float) -> None:
        """Report a dead node, end its run, and restart it if allowed."""
        if watched.state is State.DEAD:
            return
        detail = watched.process.how_it_ended()
        watched.become(State.DEAD, now_s)
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
        watched.gone |= ends_of(self, watched.name)
        watched.process.start()
        watched.restarts += 1
        watched.begin(now_s)

    def _check_answering(self, watched: WatchedNode, now_s: float) -> None:
        """Report nodes that stop answering, and those that answer again."""
        watched.pulse.ask(now_s)
        silence_s = now_s - watched.pulse.heard_s
        if silence_s <= self._silent_s:
            if watched.state is State.SILENT:
                self._say(f'{watched.name} answers again')
                watched.become(State.READY, now_s)
        elif watched.state is not State.SILENT:
            watched.become(State.SILENT, now_s)
            self._say(f'{watched.name} is silent: {self._why_silent(watched)}')
        elif (
            self._restart is Restart.ON_FAILURE
            and silence_s > _KILL_AFTER * self._silent_s
        ):
            self._say(f'{watched.name} is killed: silent for {silence_s:.0f} s')
            watched.process.kill()

    def _why_silent(self, watched: WatchedNode) -> str:
        pid = watched.process.pid
        if is_stopped(pid):
            return f'its process is stopped; resume it with kill -CONT {pid}'
        return f'no answer for {self._silent_s:g} s'

    # The end ---------------------------------------------------------------------------------

    def _see_run_end(self, end_by_s: float, now_s: float) -> None:
        """Finish when the current run has ended and its bag is closed."""
        over = bool(self.runs.last_run) and not self.runs.run_id
        if over and (self.runs.closed or interface.RECORDER not in self._names):
            self.ended.set_result(None)  # the simulator waits until its answer is sent
            return
        # On a busy machine a step may take long; a simulator still heard is still working.
        busy = bool(self.runs.run_id) and now_s - self.runs.heard_s < _HEARD_S
        if now_s >= end_by_s + (_END_HEARD_S - _END_OF_RUN_S if busy else 0.0):
            self.ended.set_result(None)


def _logs(nodes: list[WatchedNode]) -> str:
    return f'see {", ".join(str(watched.process.log) for watched in nodes)}'
