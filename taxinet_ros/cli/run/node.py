"""``taxinet node``: start one node by its name."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from taxinet_ros.errors import ExitCode, UsageError

NODES = (
    'simulator',
    'taxinet_perception',
    'ground_truth_perception',
    'steering_controller',
    'mtl_monitor',
    'runtime_monitor',
    'scenario_sampler',
    'recorder',
    'bag_player',
    'scene_markers',
    'foxglove_server',
)
_OF_EXTRAS = {'live_monitor': 'taxinet_ros.extras.live_monitor.node'}
"""Modules of nodes that take no part in a graph, by name."""


def start_node(name: str, arguments: Sequence[str]) -> None:
    """Run a node's ``main`` with ``arguments``; exits by :class:`SystemExit`.

    Raises:
        UsageError: no such node.
    """
    known = (*NODES, *_OF_EXTRAS)
    if name not in known:
        raise UsageError(f'unknown node {name!r}; known: {", ".join(known)}')
    sys.argv = [name, *arguments]
    importlib.import_module(_OF_EXTRAS.get(name, f'taxinet_ros.nodes.{name}')).main()


def node(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help='simulator, taxinet_perception, …')],
) -> None:
    """Start one node, as `ros2 run taxinet_ros NAME` does.

    Arguments after NAME are passed to the node (--ros-args …).
    """
    try:
        start_node(name, context.args)
    except SystemExit as end:  # as every node ends
        raise typer.Exit(end.code if isinstance(end.code, int) else ExitCode.INFRA) from None
