"""Executable ``taxinet_perception``: run the neural network on camera frames."""

from __future__ import annotations

from taxinet_ros.core.perception.perception import (
    GroundTruth,
    Perception,
    make_perception,
    perception_names,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep.diagnostics import PARAMETER as DIAGNOSTICS
from taxinet_ros.nodes.lockstep.perception import PerceptionNode
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import (
    Parameter,
    Usage,
    declare_all,
    published_topics,
    subscribed_topics,
)

_OPTIONS = (
    Parameter(
        name='weights', default='taxinet',
        takes=f'{", ".join(name for name in perception_names() if name != "truth")}; a '
        '.safetensors or .onnx file; or FILE.py:NAME',
        description='the network: a shipped one or a file; or a function',
    ),
)

USAGE = Usage(
    executable='taxinet_perception',
    does='Publishes an estimated tracking error for every camera frame, computed by a network or '
    'your function.',
    publishes=published_topics(interface.PERCEPTION),
    subscribes=subscribed_topics(interface.PERCEPTION, interface.TRUTH.name),
    parameters=(*_OPTIONS, DIAGNOSTICS),
)


class TaxinetPerception(PerceptionNode):
    """Estimates from the camera image only."""

    def choose(self) -> Perception:
        """The network named by the parameter ``weights``."""
        word = declare_all(self, _OPTIONS)['weights']
        if word == GroundTruth.word:
            raise UsageError(
                f'{USAGE.executable}: parameter weights: {word} uses no camera image; start '
                'ground_truth_perception instead'
            )
        return make_perception(word)


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros taxinet_perception``."""
    run_node(TaxinetPerception, usage=USAGE)


if __name__ == '__main__':
    main()
