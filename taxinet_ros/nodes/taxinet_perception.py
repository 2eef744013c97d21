"""Executable ``taxinet_perception``: the neural network looks at the camera's frames."""

from __future__ import annotations

from taxinet_ros.core.perception import Perception, make_perception
from taxinet_ros.nodes.main import run_node
from taxinet_ros.nodes.parameters import declare
from taxinet_ros.nodes.perception import PerceptionNode


class TaxinetPerception(PerceptionNode):
    """Estimates from the picture alone."""

    def choose(self) -> Perception:
        """The network that the parameter ``weights`` names."""
        text = 'taxinet for the shipped network, a .safetensors or .onnx file, or FILE.py:NAME'
        return make_perception(declare(self, 'weights', 'taxinet', text))


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros taxinet_perception``."""
    run_node(TaxinetPerception)


if __name__ == '__main__':
    main()
