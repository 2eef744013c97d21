"""Plays a recorded run to one node, in lockstep, and listens to what that one answers.

The node under test cannot tell it from the graph: the player speaks on all topics that the node
hears, and stands in for everybody that hears the node.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from taxinet_msgs.msg import NodeStatus, Scenario

from taxinet_ros.core.errors import InfraError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.steps import StepCollector

Step = tuple[int, Mapping[str, Sequence[bytes]]]
"""Number of a control step, and its serialised messages by topic of the table."""

_WATCH_PERIOD_S = 0.02
ANSWER_TIMEOUT_S = 30.0


class Player(Node):
    """Publishes step after step, each when the one before is answered.

    Attributes:
        answers: messages of the node under test by control step and topic.
        finished: done when the last step is answered; carries what went wrong.
    """

    def __init__(
        self, scenario: Scenario, steps: Iterator[Step], *, target: str, speaks: Sequence[Topic],
        answer: Topic, per_step: int, executor: Any, **node: Any,
    ) -> None:
        """Join the graph and wait for the node under test.

        Args:
            scenario: whose run it is; ``target`` alone takes part.
            steps: what to play, drawn one at a time.
            target: name of the node under test.
            speaks: topics that are played.
            answer: topic that the node answers every step on.
            per_step: with so many messages.
            executor: the one that spins this node.
            node: goes to :class:`rclpy.node.Node`.
        """
        # Nodes wait for one another by name, and here this one is the simulator.
        super().__init__(interface.SIMULATOR, **node)
        self._scenario, self._steps, self._target = scenario, steps, target
        self._collector = StepCollector({answer.name: per_step})
        self.answers: dict[int, dict[str, list[Any]]] = {}
        self.finished = Future(executor=executor)
        self._seq, self._ready, self._asked = -1, False, False
        self._heard_at = time.monotonic()
        self._speakers = {
            topic.name: self.create_publisher(topic.type, topic.name, topic.qos)
            for topic in (interface.SCENARIO, *speaks)
        }
        self._listeners = [
            self.create_subscription(
                topic.type, topic.name, self._callback(topic, answer), topic.qos
            )
            for topic in interface.TOPICS
            if target in topic.publishers
        ]
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_WATCH_PERIOD_S, self._watch, clock=steady)

    def _callback(self, topic: Topic, answer: Topic) -> Callable[[Any], None]:
        """What is done with a message; the node waits for listeners even to what nobody needs."""
        if topic is answer:
            return functools.partial(self._on_answer, topic.name)
        return self._on_status if topic is interface.NODE_STATUS else lambda message: None

    def _watch(self) -> None:
        if self.finished.done():
            return
        if self._seq < 0 and self._found():
            if not self._asked:
                self._asked = True
                self._speakers[interface.SCENARIO.name].publish(self._scenario)
            elif self._ready:
                self._next()
        if time.monotonic() - self._heard_at > ANSWER_TIMEOUT_S:
            kind = 'not_ready' if self._seq < 0 else 'timeout'
            self._fail(kind, f'silent for {ANSWER_TIMEOUT_S:g} s')

    def _found(self) -> bool:
        """Whether the node under test is at the other end of every topic."""
        return all(
            publisher.get_subscription_count() for publisher in self._speakers.values()
        ) and all(heard.get_publisher_count() for heard in self._listeners)

    def _on_status(self, status: NodeStatus) -> None:
        if status.run_id != self._scenario.run_id or status.node != self._target:
            return
        if status.state == NodeStatus.READY:
            self._ready, self._heard_at = True, time.monotonic()
        elif status.state == NodeStatus.ERROR:
            self._fail('node_error', status.detail)

    def _on_answer(self, topic: str, message: Any) -> None:
        for seq, messages in self._collector.add(topic, message.seq, message):
            self.answers[seq] = messages
            self._heard_at = time.monotonic()
            self._next()

    def _next(self) -> None:
        try:
            step = next(self._steps, None)
        except Exception as error:
            # It belongs to whoever waits for the replay, not to the executor.
            self.finished.set_exception(error)
            return
        if step is None:
            if not self.finished.done():
                self.finished.set_result(None)
            return
        self._seq, messages = step
        for topic, serialised in messages.items():
            for cdr in serialised:
                self._speakers[topic].publish(cdr)

    def _fail(self, kind: str, detail: str) -> None:
        if not self.finished.done():
            self.finished.set_exception(InfraError(kind, self._target, self._seq, detail))
