"""Perception node: camera frame (or ground truth) in, estimated tracking error out."""

from __future__ import annotations

import abc
from typing import Any

import numpy as np
from numpy.typing import NDArray
from taxinet_msgs.msg import Scenario

from taxinet_ros.bag.cdr.image import frame_of_cdr
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.bag.run.messages import error_cdr
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.rig.catalogue import WING
from taxinet_ros.core.sensors import Measured
from taxinet_ros.core.types import TrackingError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep.participant import Participant
from taxinet_ros.nodes.lockstep.senses import Senses
from taxinet_ros.nodes.messages.step import StepMessage
from taxinet_ros.nodes.running.parameters import refuse_unknown
from taxinet_ros.registry import PERCEPTIONS, origin_words

_Seen = tuple[NDArray[np.uint8] | None, TrackingError | None]


class PerceptionNode(Participant, abc.ABC):
    """Runs one perception of the core and subscribes only to its inputs."""

    def __init__(self, **node: Any) -> None:
        """Choose the perception; a network never gets the truth, nor truth the image."""
        super().__init__(interface.PERCEPTION, **node)
        self._perception = self.choose()
        self._expected, self._period_ns = WING.shape, CONTROL_PERIOD_NS
        refuse_unknown(self)
        self.implementation = self._perception.word
        self.fingerprint = self._perception.fingerprint
        self.origin = origin_words(PERCEPTIONS, self.implementation)
        self._estimates = self.speak(interface.ESTIMATE)
        self._senses = Senses(self, self._answer) if self._perception.needs_sensors else None
        if self._perception.needs_image:
            self.listen(interface.IMAGE, self._see, raw=True, newest=True)
        else:
            self.listen(interface.TRUTH, self._know, newest=True)

    def prepare(self, scenario: Scenario) -> None:
        """Reset from the previous run."""
        scene = scenario_of(scenario)
        self._perception.begin(scene.rig)
        self._expected, self._period_ns = scene.rig.camera.shape, scene.period_ns
        if self._senses is not None:
            self._senses.begin(scene)

    def clear(self) -> None:
        """See :class:`Participant`."""
        if self._senses is not None:
            self._senses.clear()

    @abc.abstractmethod
    def choose(self) -> Perception:
        """Return the perception to run; may declare parameters for it."""

    def _see(self, cdr: bytes) -> None:
        stamp_ns, pixels = frame_of_cdr(cdr)
        if pixels.shape != self._expected:
            raise ValueError(f'image is {pixels.shape}, expected {self._expected}')
        self._hold((pixels, None), self.run_id, stamp_ns)

    def _know(self, truth: StepMessage) -> None:
        self._hold((None, truth.value), truth.run_id, truth.stamp_ns)

    def _hold(self, seen: _Seen, run_id: str, stamp_ns: int) -> None:
        given = seen, run_id, stamp_ns
        if self._senses is None:
            self._answer(given, None)
        else:
            self._senses.take(stamp_ns // self._period_ns, given)

    def _answer(self, given: tuple[_Seen, str, int], measured: Measured | None) -> None:
        seen, run_id, stamp_ns = given
        if measured is not None:
            self._perception.sense(measured)
        estimate = self._perception.estimate(*seen)
        seq = stamp_ns // self._period_ns
        self._estimates.publish(error_cdr(estimate, run_id, seq, stamp_ns))
