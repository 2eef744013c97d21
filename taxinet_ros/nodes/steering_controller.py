"""The steering controller node: an estimate in, a taxi command out, by the handwritten law."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from taxinet_ros.bag.recorded_run import words_of_gains
from taxinet_ros.core.steering import GAIN_RANGES, SteeringGains, steer
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.main import run_node
from taxinet_ros.nodes.parameters import declare, refuse_unknown
from taxinet_ros.nodes.participant import Participant
from taxinet_ros.nodes.reading import Said
from taxinet_ros.nodes.step_cdr import command_cdr


class SteeringController(Participant):
    """Answers every estimate with a command. Its gains are parameters with ranges."""

    def __init__(self, **node: Any) -> None:
        """Declare the gains; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(interface.STEERING_CONTROLLER, **node)
        self.gains = SteeringGains(**{
            name: declare(
                self, name, getattr(SteeringGains(), name), f'{gain.description} [{gain.unit}]',
                (gain.low, gain.high),
            )
            for name, gain in GAIN_RANGES.items()
        })
        refuse_unknown(self)
        usual = asdict(SteeringGains())
        tuned = {name: x for name, x in asdict(self.gains).items() if x != usual[name]}
        self.implementation = words_of_gains(tuned)
        self._commands = self.speak(interface.COMMAND)
        self.listen(interface.ESTIMATE, self._answer)

    def _answer(self, estimate: Said) -> None:
        command = steer(estimate.value, self.gains)
        self._commands.publish(
            command_cdr(command, estimate.run_id, estimate.seq, estimate.stamp_ns)
        )


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros steering_controller``."""
    run_node(SteeringController)


if __name__ == '__main__':
    main()
