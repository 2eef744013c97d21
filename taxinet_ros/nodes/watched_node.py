"""One node of a supervised graph: what is known of it, and how often it may be started anew."""

from __future__ import annotations

import collections
import enum
import time
from dataclasses import dataclass, field

import psutil
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.task import Future

from taxinet_ros.nodes.node_process import NodeProcess
from taxinet_ros.nodes.presence import End

_ASK_PERIOD_S = 1.0
_MOST_QUESTIONS = 60


class State(enum.StrEnum):
    """How a node stands, outside of a run too."""

    STARTING = 'starting'
    READY = 'ready'
    SILENT = 'silent'
    DEAD = 'dead'


class RestartLimit:
    """So many new starts within so long a time, and no more."""

    def __init__(self, times: int, window_s: float) -> None:
        """Allow ``times`` starts, 0 for none, within any ``window_s`` [s]."""
        self.times, self.window_s = times, window_s
        self._starts: collections.deque[float] = collections.deque()

    def spend(self, now_s: float) -> int:
        """Ask for one more start at a time of the monotonic clock [s].

        Returns:
            Which of the allowed ones it is, from 1; 0 if there is none left.
        """
        while self._starts and now_s - self._starts[0] > self.window_s:
            self._starts.popleft()
        if len(self._starts) >= self.times:
            return 0
        self._starts.append(now_s)
        return len(self._starts)


class Pulse:
    """Whether a node answers: a node that hangs or is stopped does not say so, run or no run.

    Asks for no parameter at all, once a second, which the node's executor has to answer.

    Attributes:
        heard_s: when it last answered, by the monotonic clock [s].
        answered: whether it ever has since its process was started.
    """

    def __init__(self, node: Node, name: str) -> None:
        """Ask from ``node`` about the node ``name``."""
        self._client = node.create_client(GetParameters, f'{name}/get_parameters')
        self._questions: collections.deque[Future] = collections.deque()
        self.heard_s = self._asked_s = 0.0
        self.answered = False

    def begin(self, now_s: float) -> None:
        """Its process starts now: nothing that was asked before will be answered."""
        while self._questions:
            self._forget()
        self.answered = False
        self.heard_s = now_s

    def ask(self, now_s: float) -> None:
        """Ask, where it is time to."""
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
    """A node, its process, and what was seen of it.

    Attributes:
        process: the node's process.
        pulse: whether it answers.
        limit: how often it may be started anew.
        state: how it stands.
        since_s: when it came into its state, by the monotonic clock [s].
        started_s: when its process started, likewise.
        restarts: number of new starts so far.
        gone: ends of its dead processes, which linger in the graph for a while.
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
        """Its process was started."""
        self.started_s = now_s
        self.pulse.begin(now_s)
        self.become(State.STARTING, now_s)


def is_stopped(pid: int) -> bool:
    """Whether a process stands still by a signal, or in a debugger."""
    try:
        return psutil.Process(pid).status() in (psutil.STATUS_STOPPED, psutil.STATUS_TRACING_STOP)
    except psutil.Error:
        return False


def memory_mb(pid: int) -> float | None:
    """Memory that a process has for itself and shares, RSS [MB]; None where it cannot be known."""
    try:
        return float(psutil.Process(pid).memory_info().rss / 1e6)
    except psutil.Error:
        return None
