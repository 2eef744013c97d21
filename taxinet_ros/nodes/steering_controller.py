"""Steering controller node: estimate in, taxi command out."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from taxinet_msgs.msg import Scenario

from taxinet_ros.bag.cdr.image import frame_of_cdr
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.bag.run.messages import command_cdr
from taxinet_ros.core.assurance.switch import Assured, check_controller, make_controller
from taxinet_ros.core.motion.controller import GAIN_RANGES, STEERING, SteeringGains, gains_text
from taxinet_ros.core.sensors import Measured
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep.diagnostics import PARAMETER as DIAGNOSTICS
from taxinet_ros.nodes.lockstep.diagnostics import Health
from taxinet_ros.nodes.lockstep.participant import Participant
from taxinet_ros.nodes.lockstep.senses import Senses
from taxinet_ros.nodes.messages.step import StepMessage
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import Parameter, Usage, declare_all, refuse_unknown
from taxinet_ros.registry import CONTROLLERS, names, origin_words

_OPTIONS = (
    Parameter(
        name='controller', default=STEERING,
        takes=f'{", ".join(names(CONTROLLERS))} or FILE.py:NAME, and +MONITOR+FALLBACK behind it',
        description='the shipped law, or a function, under a monitor if one is named',
    ),
    Parameter(
        name='controller_sha256', default='', takes='64 hexadecimal digits, or empty',
        description='required SHA-256 of that file; empty: any',
    ),
    *(
        Parameter(
            name=name, default=getattr(SteeringGains(), name), limits=(gain.low, gain.high),
            description=f'{gain.description} [{gain.unit}]',
        )
        for name, gain in GAIN_RANGES.items()
    ),
)

USAGE = Usage.of_node(
    interface.STEERING_CONTROLLER,
    does='Publishes a taxi command for every estimate, computed by the shipped law or your '
    'function.',
    parameters=(*_OPTIONS, DIAGNOSTICS),
)


class SteeringController(Participant):
    """Publishes a command for every estimate, computed by the shipped law or a user function.

    The law's gains are parameters with ranges.
    """

    def __init__(self, **node: Any) -> None:
        """Declare the gains; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(interface.STEERING_CONTROLLER, **node)
        given = declare_all(self, _OPTIONS)
        word, sha256 = given['controller'], given['controller_sha256']
        self.gains = SteeringGains(**{name: given[name] for name in GAIN_RANGES})
        refuse_unknown(self)
        usual = asdict(SteeringGains())
        tuned = {name: x for name, x in asdict(self.gains).items() if x != usual[name]}
        check_controller(word, tuned)
        self._controller = make_controller(word, self.gains)
        if sha256 and self._controller.fingerprint != sha256:
            raise UsageError(
                f'controller {word} has changed since the start: its sha256 is '
                f'{self._controller.fingerprint[:12]}…, it was {sha256[:12]}…; put it back'
            )
        self.implementation = gains_text(tuned) if word == STEERING else self._controller.word
        self.fingerprint = self._controller.fingerprint
        self.origin = origin_words(CONTROLLERS, self._controller.word)
        self._commands = self.speak(interface.COMMAND)
        self._frame: tuple[int, NDArray[np.uint8]] | None = None
        self._waiting: StepMessage | None = None
        self._senses = Senses(self, self._command) if self._controller.needs_sensors else None
        if self._controller.needs_image:
            self.listen(interface.ESTIMATE, self._wait)
            self.listen(interface.IMAGE, self._see, raw=True)
        else:
            self.listen(interface.ESTIMATE, self._answer, newest=True)

    def prepare(self, scenario: Scenario) -> None:
        """Reset from the previous run."""
        scene = scenario_of(scenario)
        self._controller.begin(scene)
        if self._senses is not None:
            self._senses.begin(scene)
        self.clear()

    def clear(self) -> None:
        """See :class:`Participant`."""
        self._frame = self._waiting = None
        if self._senses is not None:
            self._senses.clear()

    def health(self) -> Health:
        """See :class:`Participant`; an alarm of the monitor is a warning."""
        health = super().health()
        alarm = self._controller.alarm if isinstance(self._controller, Assured) else None
        if alarm is None or health.level != DiagnosticStatus.OK:
            return health
        line = f'run {self.run_id}: monitor: {alarm}'
        return replace(health, level=DiagnosticStatus.WARN, message=line)

    def _see(self, cdr: bytes) -> None:
        self._frame = frame_of_cdr(cdr)
        self._answer_both()

    def _wait(self, estimate: StepMessage) -> None:
        self._waiting = estimate
        self._answer_both()

    def _answer_both(self) -> None:
        """Answer once frame and estimate of a step are there; either may come first."""
        if self._frame is None or self._waiting is None:
            return
        estimate, (stamp_ns, image) = self._waiting, self._frame
        if estimate.stamp_ns == stamp_ns:
            self._waiting = None
            self._controller.see(image)
            self._answer(estimate)

    def _answer(self, estimate: StepMessage) -> None:
        if self._senses is None:
            self._command(estimate, None)
        else:
            self._senses.take(estimate.seq, estimate)

    def _command(self, estimate: StepMessage, measured: Measured | None) -> None:
        if measured is not None:
            self._controller.sense(measured)
        command = self._controller.command(estimate.value)
        self._commands.publish(
            command_cdr(command, estimate.run_id, estimate.seq, estimate.stamp_ns)
        )


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros steering_controller``."""
    run_node(SteeringController, usage=USAGE)


if __name__ == '__main__':
    main()
