"""The bytes of a step's messages are what ROS makes of message objects with the same values.

Messages of a control step are put together in whatever order they arrive.
"""

import sys
from functools import cache

import numpy as np
import pytest
from geometry_msgs.msg import Point, Quaternion
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo
from taxinet_msgs import msg as taxinet
from taxinet_msgs.msg import NodeStatus

from taxinet_ros.bag.cdr.alignment import Canonical
from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.bag.run.message_values import command_of, error_of
from taxinet_ros.bag.run.messages import (
    camera_info_cdr,
    clock_cdr,
    command_cdr,
    error_cdr,
    odometry_cdr,
    progress_cdr,
    robustness_cdr,
)
from taxinet_ros.bag.topics import describe_topic
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.mtl import Reading, Spec, Verdict
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.pacing.stepped_run import check_answer, subnormal
from taxinet_ros.core.types import AircraftState, TaxiCommand, TrackingError, quaternion
from taxinet_ros.errors import InfraError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.messages import convert
from taxinet_ros.nodes.messages.step import Motion, StepMessage, step_reader

FINITE = st.floats(allow_nan=False, allow_infinity=False)
STAMPS = st.integers(0, 2**31 * 10**9 - 1)
NUMBERS = st.integers(0, 2**32 - 1)
WORDS = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=20)
ERRORS = st.builds(TrackingError, cte_m=st.floats(), he_rad=st.floats(), valid=st.booleans())
COMMANDS = st.builds(TaxiCommand, steering_rad=FINITE, speed_mps=FINITE)
ANGLES = st.floats(-3.0, 3.0)
STATES = st.builds(
    AircraftState, x_m=FINITE, y_m=FINITE, z_m=FINITE, roll_rad=ANGLES, pitch_rad=ANGLES,
    yaw_rad=ANGLES, speed_mps=FINITE, yaw_rate_radps=FINITE,
)
SPECS = st.builds(Spec, name=WORDS, formula=st.just(SHIPPED['phi_always'].formula), text=WORDS)
READINGS = st.builds(
    Reading, lower=st.floats(), upper=st.floats(), verdict=st.sampled_from(Verdict),
    final=st.booleans(), valid=st.booleans(), samples=NUMBERS, rejected=NUMBERS,
    trusted=st.booleans(),
)


@cache
def canonical(topic: str) -> Canonical:
    known = next(known for known in interface.TOPICS if known.name == topic)
    return Canonical([describe_topic(name=topic, type_name=known.type_name, qos='')])


def serialised(topic, message) -> bytes:
    """What ROS makes of a message, with zeros where it leaves whatever was there."""
    return canonical(topic.name).message(topic.name, bytes(serialize_message(message)))


@given(STAMPS)
def test_given_a_time_then_clock_and_camera_info_say_it(stamp_ns):
    clock = Clock(clock=convert.time_of(stamp_ns))
    assert clock_cdr(stamp_ns) == serialised(interface.CLOCK, clock)
    info = deserialize_message(camera_info_cdr(0), CameraInfo)
    info.header.stamp = convert.time_of(stamp_ns)
    assert info.header.frame_id == 'camera_optical'
    assert camera_info_cdr(stamp_ns) == serialised(interface.CAMERA_INFO, info)


@given(STATES, STAMPS)
def test_given_a_state_then_odometry_says_pose_in_map_and_speed_in_base_link(state, stamp_ns):
    message = Odometry(header=convert.header(stamp_ns, 'map'), child_frame_id='base_link')
    message.pose.pose.position = Point(x=state.x_m, y=state.y_m, z=state.z_m)
    x, y, z, w = quaternion(state.roll_rad, state.pitch_rad, state.yaw_rad)
    message.pose.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
    message.twist.twist.linear.x = state.speed_mps
    message.twist.twist.angular.z = state.yaw_rate_radps
    cdr = odometry_cdr(state, stamp_ns)
    assert cdr == serialised(interface.ODOMETRY, message)
    motion = Motion(state.x_m, state.y_m, (x, y, z, w), state.speed_mps)
    assert step_reader(interface.ODOMETRY)(cdr) == StepMessage(stamp_ns, motion)


@given(ERRORS, WORDS, NUMBERS, STAMPS)
def test_given_a_tracking_error_then_ros_makes_the_same_bytes_of_it(error, run_id, seq, stamp_ns):
    message = taxinet.TrackingError(
        header=convert.header(stamp_ns, 'map'), run_id=run_id, seq=seq,
        cross_track_error=error.cte_m, heading_error=error.he_rad, valid=error.valid,
    )
    cdr = error_cdr(error, run_id, seq, stamp_ns)
    assert cdr == serialised(interface.ESTIMATE, message)
    for topic in (interface.TRUTH, interface.ESTIMATE):
        said = step_reader(topic)(cdr)
        # By their words, as NaN equals nothing.
        assert repr(said) == repr(StepMessage(stamp_ns, error, run_id, seq))
    assert not error.usable or error_of(message) == error


@given(COMMANDS, WORDS, NUMBERS, STAMPS)
def test_given_a_command_then_ros_makes_the_same_bytes_of_it(command, run_id, seq, stamp_ns):
    message = taxinet.TaxiCommand(
        header=convert.header(stamp_ns, 'base_link'), run_id=run_id, seq=seq,
        steering_angle=command.steering_rad, speed=command.speed_mps,
    )
    cdr = command_cdr(command, run_id, seq, stamp_ns)
    assert cdr == serialised(interface.COMMAND, message)
    assert step_reader(interface.COMMAND)(cdr) == StepMessage(stamp_ns, command, run_id, seq)
    assert command_of(message) == command


@given(SPECS, READINGS, WORDS, NUMBERS, STAMPS)
def test_given_a_reading_then_ros_makes_the_same_bytes_of_it_as_for_a_verdict(
    spec, reading, run_id, seq, stamp_ns
):
    message = convert.robustness_message(spec, reading, run_id, seq, stamp_ns)
    written = robustness_cdr(spec, reading, run_id, seq, stamp_ns)
    assert written == serialised(interface.ROBUSTNESS, message)


@given(WORDS, WORDS, WORDS, WORDS, NUMBERS, STAMPS)
def test_given_progress_then_ros_makes_the_same_bytes_of_it(
    node, implementation, fingerprint, run_id, seq, stamp_ns
):
    message = taxinet.NodeStatus(
        header=convert.header(stamp_ns, ''), run_id=run_id, node=node, seq=seq,
        state=taxinet.NodeStatus.PROGRESS, implementation=implementation, fingerprint=fingerprint,
    )
    written = progress_cdr(node, implementation, fingerprint, run_id, seq, stamp_ns)
    assert written == serialised(interface.PROGRESS, message)
    said = step_reader(interface.PROGRESS)(written)
    assert said == StepMessage(stamp_ns, node, run_id, seq)


def test_given_runs_in_turns_then_each_message_is_of_its_own_run_and_formula():
    reading = Reading(
        lower=-1.0, upper=1.0, verdict=Verdict.UNKNOWN, final=False, valid=True, samples=1,
        rejected=0,
    )
    for run_id in ('first', 'the second', 'first'):
        for spec in SHIPPED.values():
            cdr = robustness_cdr(spec, reading, run_id, 1, CONTROL_PERIOD_NS)
            read = deserialize_message(cdr, taxinet.Robustness)
            assert (read.run_id, read.spec, read.formula) == (run_id, spec.name, spec.text)


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
        check_answer(
            'somebody', 0, seq=answer.seq, stamp_ns=answer.stamp_ns, value=answer.value
        )
    assert (refused.value.kind, refused.value.who) == ('protocol', 'somebody')


@pytest.mark.parametrize('number', [0.0, -0.0, sys.float_info.min, 1e-300, -5.0])
def test_a_small_number_that_is_not_subnormal_is_an_answer(number):
    assert not subnormal(TaxiCommand(steering_rad=number, speed_mps=5.0))
    assert not subnormal(TrackingError(cte_m=number, he_rad=0.0))
    assert not subnormal(TrackingError(cte_m=5e-324, he_rad=0.0, valid=False))


@given(st.binary(max_size=30))
def test_given_bytes_that_are_no_message_then_one_typed_error_names_the_topic(noise):
    with pytest.raises(BagCorrupt, match=interface.COMMAND.name):
        step_reader(interface.COMMAND)(noise)


def test_given_a_topic_of_few_messages_then_its_messages_stay_as_they_are():
    status = NodeStatus(node='perception')
    assert step_reader(interface.NODE_STATUS)(status) is status
