"""``taxinet node``: start one node where there is no ``ros2 run``."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from taxinet_ros.core.errors import UsageError

NODES = (
    'simulator',
    'taxinet_perception',
    'ground_truth_perception',
    'steering_controller',
    'mtl_monitor',
    'scenario_sampler',
    'recorder',
    'bag_player',
    'scene_markers',
    'foxglove_server',
)


def start_node(name: str, arguments: Sequence[str]) -> None:
    """Run a node's ``main`` with ``arguments``; comes back by :class:`SystemExit`.

    Raises:
        UsageError: no such node.
    """
    if name not in NODES:
        raise UsageError(f'unknown node {name!r}; known: {", ".join(NODES)}')
    sys.argv = [name, *arguments]
    importlib.import_module(f'taxinet_ros.nodes.{name}').main()
