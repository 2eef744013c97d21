"""The files that users of a ROS installation start from agree with the code."""

from __future__ import annotations

import ast
from dataclasses import asdict
from pathlib import Path

import yaml

from taxinet_ros.core.steering import SteeringGains

REPOSITORY = Path(__file__).resolve().parent.parent
LAUNCH = REPOSITORY / 'launch' / 'taxinet.launch.py'


def strings_in(tree: ast.AST) -> set[str]:
    """Every string constant below a syntax node."""
    constants = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    return {value for value in constants if isinstance(value, str)}


def test_given_the_parameter_file_when_read_then_it_holds_the_steering_law_s_defaults() -> None:
    nodes = yaml.safe_load((REPOSITORY / 'config' / 'nodes.yaml').read_text())
    assert nodes['/**/steering_controller']['ros__parameters'] == asdict(SteeringGains())


def test_given_the_launch_file_when_read_then_it_starts_every_node_there_is() -> None:
    beside_a_graph = {'taxinet', 'bag_player', 'scene_markers', 'foxglove_server'}
    nodes = {path.name for path in (REPOSITORY / 'scripts').iterdir()} - beside_a_graph
    assert len(nodes) == 7
    assert nodes <= strings_in(ast.parse(LAUNCH.read_text()))
