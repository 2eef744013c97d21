"""What is read off the bytes of a step's message is what ROS reads off them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from taxinet_msgs.msg import NodeStatus, TaxiCommand

from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.core.mtl import Reading, Verdict
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.types import AircraftState, TrackingError
from taxinet_ros.core.types import TaxiCommand as Command
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.convert import (
    camera_info_message,
    command_message,
    error_message,
    odometry_message,
    robustness_message,
)
from taxinet_ros.nodes.reading import reader_of

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
MESSAGES = [
    (interface.ODOMETRY, odometry_message(STATE, STAMP_NS)),
    (interface.TRUTH, error_message(ERROR, 'run', 17, STAMP_NS)),
    (interface.COMMAND, command_message(
        Command(steering_rad=0.5, speed_mps=5.0), 'run', 17, STAMP_NS)),
    (interface.ROBUSTNESS, robustness_message(
        SHIPPED['phi_eventually'], READING, 'run', 17, STAMP_NS)),
    (interface.CAMERA_INFO, camera_info_message()),
]


def assert_same(read: Any, message: Any) -> None:
    """Every field, and every field of a field, is equal."""
    if not hasattr(message, 'get_fields_and_field_types'):
        assert np.array_equal(read, message)
        return
    for name in message.get_fields_and_field_types():
        assert_same(getattr(read, name), getattr(message, name))


@pytest.mark.parametrize(
    ('topic', 'message'), MESSAGES, ids=[topic.name for topic, _ in MESSAGES]
)
def test_given_a_message_of_a_step_when_read_then_it_has_every_field_of_it(topic, message):
    assert_same(reader_of(topic)(bytes(serialize_message(message))), message)


@given(st.binary(max_size=30))
def test_given_bytes_that_are_no_message_then_one_typed_error_names_the_topic(noise):
    with pytest.raises(BagCorrupt, match=interface.COMMAND.name):
        reader_of(interface.COMMAND)(noise)


def test_given_a_topic_that_is_not_of_every_step_then_its_messages_stay_as_they_are():
    status = NodeStatus(node='perception')
    assert reader_of(interface.NODE_STATUS)(status) is status


def test_given_a_message_that_is_kept_when_written_again_then_nothing_of_before_is_left():
    kept = error_message(TrackingError(cte_m=9.0, he_rad=1.0, valid=False), 'old', 3, 5)
    assert error_message(ERROR, 'run', 17, STAMP_NS, kept) == error_message(
        ERROR, 'run', 17, STAMP_NS)
    command = Command(steering_rad=0.5, speed_mps=5.0)
    old = command_message(Command(steering_rad=-1.0, speed_mps=0.0), 'old', 3, 5, TaxiCommand())
    assert command_message(command, 'run', 17, STAMP_NS, old) == command_message(
        command, 'run', 17, STAMP_NS)
    spec, other = SHIPPED['phi_eventually'], SHIPPED['phi_always']
    worse = Reading(
        lower=-9.0, upper=-8.0, verdict=Verdict.VIOLATED, final=True, valid=False, samples=9,
        rejected=2, trusted=False,
    )
    said = robustness_message(other, worse, 'old', 3, 5, 'base_link')
    assert robustness_message(spec, READING, 'run', 17, STAMP_NS, into=said) == robustness_message(
        spec, READING, 'run', 17, STAMP_NS)
    moved = odometry_message(AircraftState(
        x_m=0.0, y_m=1.0, z_m=2.0, roll_rad=1.0, pitch_rad=1.0, yaw_rad=1.0, speed_mps=0.0,
        yaw_rate_radps=0.0), 5)
    assert odometry_message(STATE, STAMP_NS, moved) == odometry_message(STATE, STAMP_NS)
