"""Executable ``ground_truth_perception``: perfect perception instead of the network."""

from __future__ import annotations

from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep.diagnostics import PARAMETER as DIAGNOSTICS
from taxinet_ros.nodes.lockstep.perception import PerceptionNode
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import Usage, published_topics, subscribed_topics

USAGE = Usage(
    executable='ground_truth_perception',
    does='Publishes the true tracking error as its estimate, in place of the network.',
    publishes=published_topics(interface.PERCEPTION),
    subscribes=subscribed_topics(interface.PERCEPTION, interface.IMAGE.name),
    parameters=(DIAGNOSTICS,),
)


class GroundTruthPerception(PerceptionNode):
    """Publishes the true tracking error as its estimate."""

    def choose(self) -> Perception:
        """The ground truth."""
        return make_perception('truth')


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros ground_truth_perception``."""
    run_node(GroundTruthPerception, usage=USAGE)


if __name__ == '__main__':
    main()
