"""Fields that are read of a message, or filled in, are those that rosbags finds in it."""

import math
import struct
from operator import attrgetter

import pytest
from any_messages import TYPES, fields_in, messages_of, topic_of
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.bag.cdr.alignment import MOST_LAYOUTS
from taxinet_ros.bag.cdr.decode import typestore
from taxinet_ros.bag.cdr.fields import FieldReader, MessageTemplate
from taxinet_ros.bag.errors import BagCorrupt

STATUS = topic_of('taxinet_msgs/msg/NodeStatus')


def status(node='perception', run_id='run', seq=7, **other):
    store = typestore(STATUS)
    time, header = store.types['builtin_interfaces/msg/Time'], store.types['std_msgs/msg/Header']
    values = {
        'header': header(stamp=time(sec=1, nanosec=2), frame_id=''), 'run_id': run_id, 'node': node,
        'state': 2, 'seq': seq, 'detail': '', 'listens': [], 'implementation': '',
        'fingerprint': '', **other,
    }
    return bytes(store.serialize_cdr(store.types[STATUS.type](**values), STATUS.type))


def same(values, wanted):
    """Equal, or both not a number."""
    pairs = zip(values, wanted, strict=True)
    return all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs)


@pytest.mark.parametrize('name', TYPES)
@given(data=st.data())
def test_given_messages_in_turns_when_any_fields_are_read_then_each_has_its_own(name, data):
    topic = topic_of(name)
    store = typestore(topic)
    numbers, texts = fields_in(store, name)
    some = data.draw(st.lists(st.sampled_from(numbers), unique=True) | st.just(numbers))
    few = data.draw(st.lists(st.sampled_from(texts), unique=True)) if texts else []
    reader = FieldReader(topic, some, few)
    messages = data.draw(st.lists(messages_of(store, name), min_size=1, max_size=3))
    for message in messages * 2:
        for little_endian in (True, False):
            cdr = bytes(store.serialize_cdr(message, name, little_endian=little_endian))
            wanted = [attrgetter(field)(message) for field in (*some, *few)]
            assert same(reader(cdr), wanted)


def test_given_two_layouts_of_one_length_when_read_in_turns_then_neither_is_taken_for_the_other():
    reader = FieldReader(STATUS, ['seq'], ['run_id', 'node'])
    first = status(node='ab', run_id='a much longer name')
    second = status(node='a much longer name', run_id='ab')
    assert len(first) == len(second)
    for _ in range(3):
        assert reader(first) == [7, 'a much longer name', 'ab']
        assert reader(second) == [7, 'ab', 'a much longer name']


def test_given_more_layouts_than_are_remembered_then_all_are_read():
    reader = FieldReader(STATUS, ['seq'], ['node'])
    for _ in range(2):
        for length in range(3 * MOST_LAYOUTS):
            assert reader(status(node='x' * length, seq=length)) == [length, 'x' * length]


def test_given_garbage_in_the_gaps_then_the_fields_are_the_same():
    clean = status(run_id='odd')
    gap = clean.index(b'perception\0') + len(b'perception\0')
    spoilt = clean[:gap] + b'\7' + clean[gap + 1:]
    reader = FieldReader(STATUS, ['state', 'seq'], ['node'])
    for cdr in (clean, spoilt, clean):
        assert reader(cdr) == [2, 7, 'perception']


def test_given_a_text_that_is_none_then_one_typed_error_names_the_topic():
    reader, sound = FieldReader(STATUS, ['seq'], ['node']), status()
    assert reader(sound) == [7, 'perception']
    for broken in (sound.replace(b'perception', b'percept\xff\xffn'), sound[:20], b''):
        with pytest.raises(BagCorrupt, match='topic /told: not a taxinet_msgs/msg/NodeStatus'):
            reader(broken)
    assert reader(sound) == [7, 'perception']


def test_given_a_field_that_is_not_there_or_of_another_kind_then_it_is_refused():
    with pytest.raises(AttributeError, match='speed'):
        FieldReader(STATUS, ['speed'])(status())
    with pytest.raises(KeyError, match='listens'):
        FieldReader(STATUS, ['listens'])(status())


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
        'cross_track_error': 4.0, 'heading_error': 5.0, 'valid': True, **change,
    }
    return bytes(store.serialize_cdr(store.types[ERROR.type](**values), ERROR.type))


@pytest.mark.parametrize('name', TYPES)
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
