"""The files that users of a ROS installation start from agree with the code.

The RViz configuration shows topics and frames that there are, and hears them, without RViz.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
import yaml
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.topics import TOPICS, TRANSFORMS
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.running.domain import fits

REPOSITORY = Path(__file__).resolve().parent.parent


def test_given_the_parameter_file_when_read_then_it_holds_the_steering_law_s_defaults() -> None:
    nodes = yaml.safe_load((REPOSITORY / 'config' / 'nodes.yaml').read_text())
    assert nodes['/**/steering_controller']['ros__parameters'] == asdict(SteeringGains())


def test_ros6_given_the_file_for_ros2_bag_record_then_of_no_topic_a_message_is_dropped() -> None:
    asked = yaml.safe_load((REPOSITORY / 'config' / 'rosbag2_qos.yaml').read_text())
    assert asked == {
        '/' + topic.name.lstrip('/'): {
            'history': 'keep_all', 'reliability': topic.quality.reliability,
            'durability': topic.quality.durability,
        }
        for topic in (*TOPICS, *TRANSFORMS)
    }


FILE = Path(__file__).resolve().parent.parent / 'config' / 'taxinet.rviz'
SHOWS = {
    'MarkerArray': 'MarkerArray', 'Odometry': 'Odometry', 'Camera': 'Image',
}
"""The message that a display of rviz_default_plugins takes."""


@pytest.fixture(scope='module')
def manager() -> dict[str, Any]:
    return yaml.safe_load(FILE.read_text())['Visualization Manager']


def test_ros21_given_the_configuration_then_each_display_has_a_topic_of_its_type_that_it_can_hear(
    manager
):
    every = (*interface.TOPICS, *interface.TRANSFORMS, *interface.SCENE)
    topics = {'/' + topic.name.lstrip('/'): topic for topic in every}
    shown = {}
    for display in manager['Displays']:
        plugins, _, kind = display['Class'].partition('/')
        assert plugins == 'rviz_default_plugins'
        if 'Topic' not in display:
            assert kind == 'TF'
            continue
        asked, topic = display['Topic'], topics[display['Topic']['Value']]
        assert topic.type.__name__ == SHOWS[kind]
        qos = QoSProfile(
            depth=asked['Depth'],
            reliability=ReliabilityPolicy[asked['Reliability Policy'].upper().replace(' ', '_')],
            durability=DurabilityPolicy[asked['Durability Policy'].upper().replace(' ', '_')],
        )
        assert fits(topic.qos, qos)
        latched = topic.qos.durability == qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        assert latched or topic.qos.durability == DurabilityPolicy.VOLATILE
        shown[topic.name] = kind
    assert set(shown) >= {topic.name for topic in (*interface.SCENE, interface.IMAGE)}


def test_ros21_given_the_configuration_then_its_frames_are_those_of_tf(manager):
    assert manager['Global Options']['Fixed Frame'] == interface.MAP_FRAME
    assert manager['Views']['Current']['Target Frame'] == interface.BASE_FRAME
