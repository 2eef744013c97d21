"""Numbers that are filled into a message are those that rosbags finds in it."""

import struct
from operator import attrgetter

import numpy as np
import pytest
from any_messages import TYPES, fields_in, messages_of, topic_of
from hypothesis import given, settings
from hypothesis import strategies as st

from taxinet_ros.bag.cdr.decode import typestore
from taxinet_ros.bag.cdr.fields import MessageTemplate

ERROR = topic_of('taxinet_msgs/msg/TrackingError')


def put(message, path, value):
    *outer, field = path.split('.')
    for name in outer:
        message = getattr(message, name)
    setattr(message, field, value)


def error_cdr(**change):
    store = typestore(ERROR)
    time, header = store.types['builtin_interfaces/msg/Time'], store.types['std_msgs/msg/Header']
    values = {
        'header': header(stamp=time(sec=1, nanosec=2), frame_id='map'), 'run_id': 'run', 'seq': 3,
        'cross_track_error': 4.0, 'heading_error': 5.0, 'valid': True,
        'covariance': np.array([6.0, 0.0, 0.0, 7.0]), **change,
    }
    return bytes(store.serialize_cdr(store.types[ERROR.type](**values), ERROR.type))


@pytest.mark.one_in(3)
@pytest.mark.parametrize('name', TYPES)
@settings(max_examples=30, deadline=None)  # of each type
@given(data=st.data())
def test_given_any_message_when_any_of_its_numbers_are_filled_in_then_it_is_the_one_with_them(
    name, data
):
    topic = topic_of(name)
    store = typestore(topic)
    message, other = data.draw(messages_of(store, name)), data.draw(messages_of(store, name))
    known, _ = fields_in(store, name)
    fields = data.draw(st.lists(st.sampled_from(known), unique=True) | st.just(known))
    template = MessageTemplate(topic, bytes(store.serialize_cdr(message, name)), fields)
    for field in fields:
        put(message, field, attrgetter(field)(other))
    filled = template.filled(*(attrgetter(field)(other) for field in fields))
    assert filled == store.serialize_cdr(message, name)


def test_given_garbage_in_the_gaps_and_behind_then_it_is_not_in_what_is_filled():
    clean = error_cdr()
    spoilt = bytearray(clean) + b'\7'
    before = clean.index(struct.pack('<d', 4.0))
    assert clean[before - 8:before] == struct.pack('<II', 3, 0), 'seq, then a gap'
    spoilt[before - 4:before] = b'\7\7\7\7'
    fields = 'header.stamp.sec', 'header.stamp.nanosec', 'seq', 'valid'
    assert MessageTemplate(ERROR, bytes(spoilt), fields).filled(1, 2, 3, True) == clean


def test_given_elements_of_an_array_then_they_are_filled_in_where_rosbags_finds_them():
    fields = 'valid', *(f'covariance[{number}]' for number in range(4))
    filled = MessageTemplate(ERROR, error_cdr(), fields).filled(True, 1.0, 2.0, 3.0, 4.0)
    assert filled == error_cdr(covariance=np.array([1.0, 2.0, 3.0, 4.0]))


def test_given_a_field_that_is_no_number_then_it_is_refused():
    with pytest.raises(KeyError, match='run_id'):
        MessageTemplate(ERROR, error_cdr(), ['seq', 'run_id'])


def test_given_bytes_that_are_no_message_then_they_are_refused():
    with pytest.raises(ValueError, match='fields end at byte'):
        MessageTemplate(ERROR, error_cdr() + bytes(4), ['seq'])


@pytest.mark.parametrize('values', [(), (-1,), (2**32,), (0.5,)])
def test_given_no_value_or_one_out_of_range_then_it_is_refused(values):
    with pytest.raises(struct.error):
        MessageTemplate(ERROR, error_cdr(), ['seq']).filled(*values)
