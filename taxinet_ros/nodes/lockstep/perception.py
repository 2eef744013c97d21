"""Perception node: camera frame (or ground truth) in, estimated tracking error out."""

from __future__ import annotations

import abc
from typing import Any

from taxinet_msgs.msg import Scenario

from taxinet_ros.bag.cdr.image import frame_of_cdr
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.bag.run.messages import error_cdr
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.rig.catalogue import WING
from taxinet_ros.core.types import TrackingError as Estimate
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep.participant import Participant
from taxinet_ros.nodes.messages.step import StepMessage
from taxinet_ros.nodes.running.parameters import refuse_unknown
from taxinet_ros.registry import PERCEPTIONS, origin_words


class PerceptionNode(Participant, abc.ABC):
    """Runs one perception of the core and subscribes only to its inputs."""

    def __init__(self, **node: Any) -> None:
        """Choose the perception; a network never gets the truth, nor truth the image."""
        super().__init__(interface.PERCEPTION, **node)
        self._perception = self.choose()
        self._expected = WING.shape
        refuse_unknown(self)
        self.implementation = self._perception.word
        self.fingerprint = self._perception.fingerprint
        self.origin = origin_words(PERCEPTIONS, self.implementation)
        self._estimates = self.speak(interface.ESTIMATE)
        if self._perception.needs_image:
            self.listen(interface.IMAGE, self._see, raw=True, newest=True)
        else:
            self.listen(interface.TRUTH, self._know, newest=True)

    def prepare(self, scenario: Scenario) -> None:
        """Reset from the previous run."""
        rig = scenario_of(scenario).rig
        self._perception.begin(rig)
        self._expected = rig.camera.shape

    @abc.abstractmethod
    def choose(self) -> Perception:
        """Return the perception to run; may declare parameters for it."""

    def _see(self, cdr: bytes) -> None:
        stamp_ns, pixels = frame_of_cdr(cdr)
        if pixels.shape != self._expected:
            raise ValueError(f'image is {pixels.shape}, expected {self._expected}')
        self._say(self._perception.estimate(pixels, None), self.run_id, stamp_ns)

    def _know(self, truth: StepMessage) -> None:
        estimate = self._perception.estimate(None, truth.value)
        self._say(estimate, truth.run_id, truth.stamp_ns)

    def _say(self, estimate: Estimate, run_id: str, stamp_ns: int) -> None:
        seq = stamp_ns // CONTROL_PERIOD_NS
        self._estimates.publish(error_cdr(estimate, run_id, seq, stamp_ns))
