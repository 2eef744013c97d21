"""The shipped network behind a delay that is another one for every frame."""

from __future__ import annotations

import random
import time

from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.taxinet_perception import USAGE, TaxinetPerception

_LONGEST_S = 0.04


class SlowedPerception(TaxinetPerception):
    """Sees the same, later."""

    def choose(self) -> Perception:
        return _Slowed(super().choose())


class _Slowed(Perception):
    def __init__(self, perception: Perception) -> None:
        self._perception, self._delay = perception, random.Random(7)
        self.word, self.fingerprint = perception.word, perception.fingerprint
        self.needs_image = perception.needs_image

    def estimate(self, image, truth):
        time.sleep(self._delay.uniform(0.0, _LONGEST_S))
        return self._perception.estimate(image, truth)


def main() -> None:
    run_node(SlowedPerception, usage=USAGE)


if __name__ == '__main__':
    main()
