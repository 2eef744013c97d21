"""Base class of lockstep nodes: take the scenario, become ready, report errors."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from taxinet_msgs.msg import NodeStatus, Scenario

from taxinet_ros.bag.run.messages import progress_cdr
from taxinet_ros.errors import InfraError, InfraKind
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.lockstep.diagnostics import Diagnostics, Health, Pace, too_long
from taxinet_ros.nodes.messages.convert import blame_text, header, one_line
from taxinet_ros.nodes.messages.step import is_read_raw, step_reader
from taxinet_ros.nodes.running.domain import Endpoints, brief_intruder

_READY_POLL_S = 0.005
_SILENT_LOOKS = 20


class Participant(Node):
    """A node that prepares for each scenario and then answers messages.

    A subclass overrides :meth:`prepare`, and :meth:`clear` if it stores messages. An exception in a
    callback becomes an ERROR status that names the node, so that the run ends at once with a reason
    instead of a timeout. The node is ready when each publisher of its inputs is present once and
    matched, and each of its own publishers is matched with its subscribers in the run.

    Attributes:
        run_id: the run the node is prepared for, or ''.
        implementation: name of the implementation; recorded in every bag.
        fingerprint: sha256 of the weights that decide its behaviour, or ''.
        origin: package that provides it (:func:`.registry.origin_words`), or ''.
        silent_looks: number of :meth:`may_leave` calls since the last message.
    """

    def __init__(self, name: str, **node: Any) -> None:
        """Create the node; ``node`` goes to :class:`rclpy.node.Node` (context, namespace, …)."""
        super().__init__(name, **node)
        self.run_id = ''
        self.implementation = ''
        self.fingerprint = ''
        self.origin = ''
        self._scenario: Scenario | None = None
        self.silent_looks = 0
        self._ends = Endpoints(self, self._on_second_publisher)
        self._work, self._trouble, self._taken_s = Pace(), '', 0.0
        self._diagnostics = Diagnostics(self, self.health)
        self._status = self.speak(interface.NODE_STATUS)
        self.listen(interface.SCENARIO, self._take)
        # Becoming ready depends on discovery, so it runs on wall time.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        report_ready = functools.partial(self._guarded(self._report_ready), None)
        self._poll = self.create_timer(_READY_POLL_S, report_ready, clock=steady)
        self._poll.cancel()

    def prepare(self, scenario: Scenario) -> None:
        """Reset from the previous run and prepare for this one."""

    def clear(self) -> None:
        """Drop messages received before READY; publishers of the run send none until then."""

    def speak(self, topic: Topic) -> Publisher:
        """Publish on a topic of the table."""
        return self._ends.speak(topic)

    def listen(
        self, topic: Topic, callback: Callable[[Any], None], *, raw: bool = False,
        newest: bool = False,
    ) -> None:
        """Subscribe to a topic of the table; exceptions in the callback are reported.

        Args:
            topic: the topic.
            callback: called with messages, decoded for topics read raw.
            raw: pass the bytes instead.
            newest: take only the last waiting message; in lockstep at most one waits.
        """
        if is_read_raw(topic) and not raw:
            read, hear, raw = step_reader(topic), callback, True

            def callback(cdr: bytes) -> None:
                hear(read(cdr))

        self._ends.listen(
            topic, self._guarded(callback), raw=raw, qos=interface.NEWEST if newest else None
        )

    def listen_if(
        self, wanted: bool, topic: Topic, callback: Callable[[Any], None], *, raw: bool = False
    ) -> None:
        """Subscribe to a topic for runs that need it; otherwise do without."""
        heard = topic.name in self._ends.listeners
        if wanted and not heard:
            self.listen(topic, callback, raw=raw)
        elif heard and not wanted:
            self._ends.unlisten(topic)

    def report(self, state: int, *, seq: int = 0, stamp_ns: int = 0, detail: str = '') -> None:
        """Report this node's state in the current run to the simulator."""
        ready = state == NodeStatus.READY
        if state == NodeStatus.ERROR:
            self._trouble = detail
        self._status.publish(NodeStatus(
            header=header(stamp_ns, ''),
            run_id=self.run_id,
            node=self.get_name(),
            state=state,
            seq=seq,
            detail=detail,
            # In a free run, who must hear its timing is known without.
            listens=[
                name for name in self._ends.listeners if name != interface.TIMING.name
            ] if ready else [],
            implementation=self.implementation,
            fingerprint=self.fingerprint,
        ))

    def progress(self, seq: int, stamp_ns: int) -> bytes:
        """Serialised status for progress up to control step ``seq``."""
        return progress_cdr(
            self.get_name(), self.implementation, self.fingerprint, self.run_id, seq, stamp_ns
        )

    def figures(self) -> Mapping[str, object]:
        """Further figures of this node for ``/diagnostics``."""
        return {}

    def health(self) -> Health:
        """Health of this node in its run."""
        rate, work = self._work.look('message')
        values = {
            'run': self.run_id, 'implementation': self.implementation,
            'fingerprint': self.fingerprint, 'message rate [1/s]': rate, **work, **self.figures(),
        }
        if self._trouble:
            line = f'run {self.run_id}: {self._trouble}'
            return Health(level=DiagnosticStatus.ERROR, message=line, values=values)
        if self._scenario is None or self._poll.is_canceled():
            return Health(message=f'run {self.run_id}' if self.run_id else 'no run', values=values)
        if not too_long(time.monotonic() - self._taken_s):
            return Health(message=f'run {self.run_id}: starting', values=values)
        unmatched = ', '.join(self._unmatched())
        if not unmatched:  # no more; READY follows at the next check
            return Health(message=f'run {self.run_id}: starting', values=values)
        line = f'run {self.run_id}: endpoints not matched on {unmatched}'
        return Health(level=DiagnosticStatus.WARN, message=line, values=values)

    def may_leave(self) -> bool:
        """Whether no node waits for this one after a shutdown request; called every 0.05 s.

        True without a run or a simulator, or after one second without messages.
        """
        self.silent_looks += 1
        return self.without_simulator() or (self.silent_looks > _SILENT_LOOKS and all(
            # DDS resends lost messages as long as this node exists.
            publisher.wait_for_all_acked(Duration()) for publisher in self._ends.speakers.values()
        ))

    def without_simulator(self) -> bool:
        """Whether there is no run, or no simulator that could end it."""
        scenarios = self._ends.listeners[interface.SCENARIO.name]
        return not self.run_id or not scenarios.get_publisher_count()

    def close(self) -> None:
        """Finish pending work; called once before the node is destroyed."""

    def charge(self, error: InfraError) -> None:
        """End the run because of another node's error."""
        Participant.report(self, NodeStatus.ERROR, detail=blame_text(error))

    def _on_second_publisher(self, topic: Topic) -> None:
        """Report an intruder; the simulator ignores one that comes when no run is under way."""
        if self._scenario is None or not self._poll.is_canceled():
            return
        who, detail = brief_intruder(self, topic, self._scenario.participants)
        self.charge(InfraError(InfraKind.INTRUDER, who, -1, detail))
        self._trouble = ''

    def _take(self, scenario: Scenario) -> None:
        if self.get_name() not in scenario.participants:
            return
        self.run_id = scenario.run_id
        self._scenario = scenario
        self._trouble, self._taken_s = '', time.monotonic()
        self.prepare(scenario)
        self._poll.reset()
        self._report_ready()

    def _report_ready(self, _: None = None) -> None:
        """Report READY as soon as every endpoint is matched with all its peers of this run.

        Both directions count: a reader not yet matched with a writer drops its messages.
        """
        if self._scenario is None or self._poll.is_canceled():
            return
        if next(self._unmatched(), None) is not None:
            return
        self.clear()
        self._poll.cancel()
        self.report(NodeStatus.READY, detail=self.origin)

    def _unmatched(self) -> Iterator[str]:
        """Topics with unmatched or foreign endpoints in this run."""
        assert self._scenario is not None
        present = self._scenario.participants
        return self._ends.unmatched(present, lambda topic: topic.listeners(present))

    def _guarded(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        @functools.wraps(callback)
        def guarded(message: Any) -> None:
            if message is not None:  # None for a timer
                self.silent_looks = 0
            watched = self._diagnostics.watched and message is not None
            begun_s = time.perf_counter() if watched else 0.0
            try:
                callback(message)
                if watched:
                    self._work.took(time.perf_counter() - begun_s)
            except Exception as error:
                if isinstance(error, InfraError):
                    self.charge(error)
                    return
                reason = one_line(error)
                self.get_logger().error(f'run {self.run_id}: {reason}')
                self.report(NodeStatus.ERROR, detail=reason)

        return guarded
