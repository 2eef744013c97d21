"""Executable ``ground_truth_perception``: the network's twin that is always right."""

from __future__ import annotations

from taxinet_ros.core.perception import Perception, make_perception
from taxinet_ros.nodes.main import run_node
from taxinet_ros.nodes.perception import PerceptionNode


class GroundTruthPerception(PerceptionNode):
    """Passes the true tracking error on as its estimate."""

    def choose(self) -> Perception:
        """The truth."""
        return make_perception('truth')


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros ground_truth_perception``."""
    run_node(GroundTruthPerception)


if __name__ == '__main__':
    main()
