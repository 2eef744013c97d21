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
from taxinet_ros.nodes.lockstep.endpoints import UNKNOWN, HeardSpeakers, first_stranger, heard_by
from taxinet_ros.nodes.messages.convert import blame_text, header, one_line
from taxinet_ros.nodes.messages.step import is_read_raw, step_reader

_READY_POLL_S = 0.005
_SILENT_LOOKS = 20


class Participant(Node):
    """A node that prepares for each scenario and then answers messages.

    A subclass overrides :meth:`prepare`, and :meth:`clear` if it stores messages. An exception in a
    callback becomes an ERROR status that names the node, so that the run ends at once with a reason
    instead of a timeout. The publishers of the node's inputs are pinned at its READY. A publisher
    that joins later, but before the first step, may be a restarted node of the run: the node waits
    until each is present once, and becomes ready again. One that joins after that is reported as an
    error.

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
        self._speakers: list[tuple[Topic, Publisher]] = []
        self._listeners: list[HeardSpeakers] = []
        self._charged = self._begun = False
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
        publisher = self.create_publisher(topic.type, topic.name, topic.end_qos)
        self._speakers.append((topic, publisher))
        return publisher

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
            callback, raw = self._reading(topic, callback), True
        self._listeners.append(HeardSpeakers(
            self, topic, self._guarded(callback, topic.each_step), raw=raw,
            on_match=self.spoken_into, qos=interface.NEWEST if newest else topic.end_qos,
        ))

    def destroy_node(self) -> None:
        """See :class:`rclpy.node.Node`."""
        for heard in self._listeners:
            heard.close()
        super().destroy_node()

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
            listens=self._declared() if ready else [],
            implementation=self.implementation,
            fingerprint=self.fingerprint,
        ))

    def _declared(self) -> list[str]:
        """Topics it declares; the simulator knows who must hear of a free run's timing."""
        return [
            heard.topic.name for heard in self._listeners if heard.topic is not interface.TIMING
        ]

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
        values['waits for'] = ', '.join(sorted(self.waits_for()))
        unsettled = ', '.join(self._unsettled())
        if not unsettled:  # no more; READY follows at the next check
            return Health(message=f'run {self.run_id}: starting', values=values)
        line = f'run {self.run_id}: endpoints not matched on {unsettled}'
        return Health(level=DiagnosticStatus.WARN, message=line, values=values)

    def may_leave(self) -> bool:
        """Whether no node waits for this one after a shutdown request; called every 0.05 s.

        True without a run or a simulator, or after one second without messages.
        """
        self.silent_looks += 1
        return self.without_simulator() or (self.silent_looks > _SILENT_LOOKS and all(
            # DDS resends lost messages as long as this node exists.
            publisher.wait_for_all_acked(Duration()) for _, publisher in self._speakers
        ))

    def without_simulator(self) -> bool:
        """Whether there is no run, or no simulator that could end it."""
        heard = next(heard for heard in self._listeners if heard.topic is interface.SCENARIO)
        return not self.run_id or not heard.subscription.get_publisher_count()

    def waits_for(self) -> set[str]:
        """Nodes of the run not matched yet, see :class:`.node_main.Waiting`."""
        if self._scenario is None or self._poll.is_canceled():
            return set()
        present = self._scenario.participants
        found: set[str] = set()
        for topic, publisher in self._speakers:
            names = topic.listeners(present)
            if not heard_by(self, publisher, names):
                ends = self.get_subscriptions_info_by_topic(publisher.topic_name)
                found |= names - {end.node_name for end in ends} or names
        for heard in self._listeners:
            if not heard.settled(present):
                found |= heard.absent(present) or heard.wanted(present)
        return found - {self.get_name()}

    def close(self) -> None:
        """Finish pending work; called once before the node is destroyed."""

    def charge(self, error: InfraError) -> None:
        """End the run because of another node's error."""
        Participant.report(self, NodeStatus.ERROR, detail=blame_text(error))

    def spoken_into(self) -> bool:
        """Whether an input has a publisher that was not present at READY.

        Reports it to the simulator once.
        """
        if not self._charged and (stranger := first_stranger(self._listeners)) is not None:
            if not self._begun:
                self._wait_again()
                return False
            self._charged = True
            self.charge(stranger.error(-1))
        return self._charged

    def _wait_again(self) -> None:
        """Withdraw READY."""
        for heard in self._listeners:
            heard.release()
        self.report(NodeStatus.PROGRESS, detail='waits until each publisher is present once')
        self._poll.reset()

    def _take(self, scenario: Scenario) -> None:
        before = self._scenario
        waits = before is not None and not self._begun and before.run_id == scenario.run_id
        if waits and before != scenario:
            raise InfraError(
                InfraKind.INTRUDER, UNKNOWN, -1, 'somebody sent another scenario for this run'
            )
        if self.get_name() not in scenario.participants:
            return
        for heard in self._listeners:
            heard.release()
        self._charged = self._begun = False
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
        present = self._scenario.participants
        if next(self._unsettled(), None) is not None:
            return
        for heard in self._listeners:
            heard.pin(present)
        self.clear()
        self._begun = False
        self._poll.cancel()
        self.report(NodeStatus.READY, detail=self.origin)

    def _unsettled(self) -> Iterator[str]:
        """Topics with unmatched or foreign endpoints in this run."""
        assert self._scenario is not None
        present = self._scenario.participants
        for topic, publisher in self._speakers:
            if not heard_by(self, publisher, topic.listeners(present)):
                yield topic.name
        for heard in self._listeners:
            if not heard.settled(present):
                yield heard.topic.name

    @staticmethod
    def _reading(topic: Topic, callback: Callable[[Any], None]) -> Callable[[bytes], None]:
        read = step_reader(topic)
        return lambda cdr: callback(read(cdr))

    def _guarded(
        self, callback: Callable[[Any], None], begins: bool = False
    ) -> Callable[[Any], None]:
        @functools.wraps(callback)
        def guarded(message: Any) -> None:
            if message is not None:  # None for a timer
                self.silent_looks = 0
            if begins:
                self._begun = True
            watched = self._diagnostics.watched and message is not None
            begun_s = time.perf_counter() if watched else 0.0
            try:
                callback(message)
                if watched:
                    self._work.took(time.perf_counter() - begun_s)
            except Exception as error:
                # A bad message may come from a foreign node, which is then to blame.
                if self.spoken_into():
                    return
                if isinstance(error, InfraError):
                    self.charge(error)
                    return
                reason = one_line(error)
                self.get_logger().error(f'run {self.run_id}: {reason}')
                self.report(NodeStatus.ERROR, detail=reason)

        return guarded
