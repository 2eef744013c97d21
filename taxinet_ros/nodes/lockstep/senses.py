"""What the sensors beside the camera deliver, step by step, to a part that asks for them."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.run.message_values import stamp_of
from taxinet_ros.bag.run.topics import topic_info
from taxinet_ros.core.pacing.step_collector import StepCollector
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.sensing import Schedule, measured_of
from taxinet_ros.core.sensors import Measured
from taxinet_ros.core.topics import SENSORS
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep.participant import Participant

_STEP = 'step'


class Senses:
    """Holds the input of a step until the measurements that arrive with it are there."""

    def __init__(self, node: Participant, answer: Callable[[Any, Measured | None], None]) -> None:
        """Subscribe to the sensors.

        Args:
            node: the node.
            answer: called with each input, in order, and its measurements; None in a run without
                sensors and hold lines.
        """
        self._answer = answer
        self._schedule = Schedule(Scenario(), Scenario().period_ns)
        self._steps = StepCollector({_STEP: 1})
        self._decode = {
            topic.name: decoder(topic_info(topic)) for topic in SENSORS.values()
        }
        self._node = node
        for topic in interface.SENSORS.values():
            if topic is not interface.CAMERA2:
                node.listen(topic, functools.partial(self._sense, topic.name), raw=True)

    def begin(self, scenario: Scenario) -> None:
        """Start a run."""
        self._schedule = Schedule(scenario, scenario.period_ns)
        topic = interface.CAMERA2
        self._node.listen_if(
            scenario.sensor_set.camera is not None, topic,
            functools.partial(self._sense, topic.name), raw=True,
        )
        self.clear()

    def clear(self) -> None:
        """Drop what has come."""
        self._steps = StepCollector({_STEP: 1}, self._schedule.counts)

    def take(self, seq: int, given: Any) -> None:
        """Take the input of a step."""
        self._add(_STEP, seq, given)

    def _sense(self, topic: str, cdr: bytes) -> None:
        message = self._decode[topic](cdr)
        self._add(topic, self._schedule.step_of(topic, stamp_of(message)), message)

    def _add(self, topic: str, seq: int, message: Any) -> None:
        for step, came in self._steps.add(topic, seq, message):
            there = self._schedule.sensors.present
            self._answer(came[_STEP][0], measured_of(self._schedule, step, {
                one.name: came.get(SENSORS[one.name].name, []) for one in there
            }) if there or self._schedule.hold_lines else None)
