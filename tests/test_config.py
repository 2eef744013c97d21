"""The files that users of a ROS installation start from agree with the code."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import yaml

from taxinet_ros.core.steering import SteeringGains

REPOSITORY = Path(__file__).resolve().parent.parent


def test_given_the_parameter_file_when_read_then_it_holds_the_steering_law_s_defaults() -> None:
    nodes = yaml.safe_load((REPOSITORY / 'config' / 'nodes.yaml').read_text())
    assert nodes['/**/steering_controller']['ros__parameters'] == asdict(SteeringGains())
