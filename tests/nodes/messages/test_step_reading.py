"""What is read off the bytes of a step's message is what was said, bit for bit."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from taxinet_msgs.msg import NodeStatus, TrackingError

from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.bag.run.messages import command_cdr, error_cdr, odometry_cdr, progress_cdr
from taxinet_ros.core import types
from taxinet_ros.core.types import AircraftState, TaxiCommand, quaternion
from taxinet_ros.errors import InfraError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep.active_run import check_answer
from taxinet_ros.nodes.messages.step import (
    Motion,
    StepMessage,
    step_reader,
    subnormal,
)

FLOATS = st.floats(allow_nan=False)
STAMPS = st.integers(0, 2**40)
NUMBERS = st.integers(0, 2**32 - 1)
WORDS = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=20)


@pytest.mark.parametrize('topic', [interface.TRUTH, interface.ESTIMATE], ids=lambda one: one.name)
@given(FLOATS, FLOATS, st.booleans(), WORDS, NUMBERS, STAMPS)
def test_given_an_error_when_read_then_it_is_the_one_that_was_said(
    topic, cte_m, he_rad, valid, run_id, seq, stamp_ns
):
    error = types.TrackingError(cte_m=cte_m, he_rad=he_rad, valid=valid)
    said = step_reader(topic)(error_cdr(error, run_id, seq, stamp_ns))
    assert said == StepMessage(stamp_ns, error, run_id, seq)
    assert type(said.value.valid) is bool


@given(FLOATS, FLOATS, WORDS, NUMBERS, STAMPS)
def test_given_a_command_when_read_then_it_is_the_one_that_was_said(
    steering_rad, speed_mps, run_id, seq, stamp_ns
):
    command = TaxiCommand(steering_rad=steering_rad, speed_mps=speed_mps)
    said = step_reader(interface.COMMAND)(command_cdr(command, run_id, seq, stamp_ns))
    assert said == StepMessage(stamp_ns, command, run_id, seq)


@pytest.mark.parametrize('number', [
    5, True, np.int64(5), np.float32(5.0), np.array(5.0), np.array([5.0]), '5',
], ids=lambda one: type(one).__name__)
@pytest.mark.parametrize('topic', [interface.ESTIMATE, interface.COMMAND], ids=lambda one: one.name)
def test_a_number_of_a_wrong_python_type_ends_the_run_and_names_the_cause(topic, number):
    message = topic.type()
    message._check_fields = False  # as in a node that somebody starts without the check
    if topic is interface.ESTIMATE:
        message.valid, message.heading_error = True, number
    else:
        message.speed = number
    answer = step_reader(topic)(serialize_message(message))
    with pytest.raises(InfraError, match='subnormal, an int or array in a float field') as refused:
        check_answer(answer, 'somebody', 0)
    assert (refused.value.kind, refused.value.who) == ('protocol', 'somebody')


@pytest.mark.parametrize('number', [0.0, -0.0, sys.float_info.min, 1e-300, -5.0])
def test_a_small_number_that_is_not_subnormal_is_an_answer(number):
    assert not subnormal(TaxiCommand(steering_rad=number, speed_mps=5.0))
    assert not subnormal(types.TrackingError(cte_m=number, he_rad=0.0))
    assert not subnormal(types.TrackingError(cte_m=5e-324, he_rad=0.0, valid=False))


@given(FLOATS, FLOATS, FLOATS, STAMPS)
def test_given_odometry_when_read_then_there_are_place_and_speed(
    x_m, y_m, speed_mps, stamp_ns
):
    state = AircraftState(
        x_m=x_m, y_m=y_m, z_m=1.5, roll_rad=0.01, pitch_rad=-0.02, yaw_rad=0.2,
        speed_mps=speed_mps, yaw_rate_radps=0.1,
    )
    said = step_reader(interface.ODOMETRY)(odometry_cdr(state, stamp_ns))
    turn = quaternion(0.01, -0.02, 0.2)
    assert said == StepMessage(stamp_ns, Motion(x_m, y_m, turn, speed_mps))


@given(WORDS, WORDS, NUMBERS, STAMPS)
def test_given_progress_when_read_then_it_tells_whose(node, run_id, seq, stamp_ns):
    said = step_reader(interface.PROGRESS)(progress_cdr(node, 'x', 'y', run_id, seq, stamp_ns))
    assert said == StepMessage(stamp_ns, node, run_id, seq)


def test_given_a_message_that_ros_serialised_then_it_is_read_alike_also_when_not_a_number():
    read = step_reader(interface.ESTIMATE)
    for cte, length in ((math.nan, 3), (1.5, 3), (math.inf, 8)):
        message = TrackingError(
            header=Header(stamp=Time(sec=3, nanosec=5), frame_id='map'), run_id='r' * length,
            seq=30, cross_track_error=cte, heading_error=0.25, valid=False,
        )
        said = read(bytes(serialize_message(message)))
        assert (said.stamp_ns, said.run_id, said.seq) == (3_000_000_005, 'r' * length, 30)
        assert said.value.cte_m == cte or (math.isnan(cte) and math.isnan(said.value.cte_m))
        assert (said.value.he_rad, said.value.valid) == (0.25, False)


@given(st.binary(max_size=30))
def test_given_bytes_that_are_no_message_then_one_typed_error_names_the_topic(noise):
    with pytest.raises(BagCorrupt, match=interface.COMMAND.name):
        step_reader(interface.COMMAND)(noise)


def test_given_a_topic_of_few_messages_then_its_messages_stay_as_they_are():
    status = NodeStatus(node='perception')
    assert step_reader(interface.NODE_STATUS)(status) is status
