"""What is read off the bytes of a step's message is what ROS reads off them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from taxinet_msgs.msg import NodeStatus

from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.core.mtl import Reading, Verdict
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.types import AircraftState, TaxiCommand, TrackingError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.reading import reader_of
from taxinet_ros.nodes.step_cdr import (
    camera_info_cdr,
    command_cdr,
    error_cdr,
    odometry_cdr,
    progress_cdr,
    robustness_cdr,
)

STAMP_NS = 1_700_000_000
STATE = AircraftState(
    x_m=400.25, y_m=-3.5, z_m=1.5, roll_rad=0.01, pitch_rad=-0.02, yaw_rad=0.2, speed_mps=5.0,
    yaw_rate_radps=0.1,
)
READING = Reading(
    lower=-1.5, upper=0.75, verdict=Verdict.UNKNOWN, final=False, valid=True, samples=3,
    rejected=1, trusted=True,
)
ERROR = TrackingError(cte_m=1.25, he_rad=-0.125)
COMMAND = TaxiCommand(steering_rad=0.5, speed_mps=5.0)
MESSAGES = [
    (interface.ODOMETRY, odometry_cdr(STATE, STAMP_NS)),
    (interface.TRUTH, error_cdr(ERROR, 'run', 17, STAMP_NS)),
    (interface.COMMAND, command_cdr(COMMAND, 'run', 17, STAMP_NS)),
    (interface.ROBUSTNESS, robustness_cdr(
        SHIPPED['phi_eventually'], READING, 'run', 17, STAMP_NS)),
    (interface.CAMERA_INFO, camera_info_cdr(STAMP_NS)),
    (interface.PROGRESS, progress_cdr('recorder', '', '', 'run', 17, STAMP_NS)),
]


def assert_same(read: Any, message: Any) -> None:
    """Every field, and every field of a field, is equal."""
    if not hasattr(message, 'get_fields_and_field_types'):
        assert np.array_equal(read, message)
        return
    for name in message.get_fields_and_field_types():
        assert_same(getattr(read, name), getattr(message, name))


@pytest.mark.parametrize(
    ('topic', 'cdr'), MESSAGES, ids=[topic.name for topic, _ in MESSAGES]
)
def test_given_a_message_of_a_step_when_read_then_it_has_every_field_of_it(topic, cdr):
    assert_same(reader_of(topic)(cdr), deserialize_message(cdr, topic.type))


@given(st.binary(max_size=30))
def test_given_bytes_that_are_no_message_then_one_typed_error_names_the_topic(noise):
    with pytest.raises(BagCorrupt, match=interface.COMMAND.name):
        reader_of(interface.COMMAND)(noise)


def test_given_a_topic_of_few_messages_then_its_messages_stay_as_they_are():
    status = NodeStatus(node='perception')
    assert reader_of(interface.NODE_STATUS)(status) is status
