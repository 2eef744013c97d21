"""Equal messages get equal bytes; the peer is rosbags, which writes them anew with zeros."""

import contextlib
import struct

import pytest
from any_messages import messages_of
from bag_edits import GOLDEN
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from taxinet_ros.bag.cdr.alignment import Canonical, Trail, walk_of
from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.bag.reader import read_info, stored_messages

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = [
    'nav_msgs/msg/Odometry', 'diagnostic_msgs/msg/DiagnosticArray', 'sensor_msgs/msg/Image',
    'sensor_msgs/msg/CameraInfo', 'visualization_msgs/msg/Marker', 'geometry_msgs/msg/Polygon',
    'sensor_msgs/msg/PointCloud2', 'rosgraph_msgs/msg/Clock', 'std_msgs/msg/String',
    'sensor_msgs/msg/MultiDOFJointState', 'sensor_msgs/msg/BatteryState',
    'shape_msgs/msg/SolidPrimitive', 'rcl_interfaces/msg/ParameterEvent', 'test_msgs/msg/Fixed',
]
STORE.register({  # a fixed number of structures; no message of ROS has such
    **get_types_from_msg('uint8 a\nfloat64 b\nuint8 c', 'test_msgs/msg/Part'),
    **get_types_from_msg('uint8 first\nPart[3] parts\nuint16 last', 'test_msgs/msg/Fixed'),
})


def dirty(cdr, walk, garbage):
    """The same message with garbage in its gaps."""
    trail, at = Trail(), 4
    for step in walk._steps:
        at = step.walk(cdr, at, trail)
    spoilt = bytearray(cdr)
    for start, end in trail.gaps:
        spoilt[start:end] = (garbage * 2)[: end - start]
    return bytes(spoilt)


@pytest.mark.parametrize('name', TYPES)
@settings(max_examples=30, deadline=None)  # of each type
@given(data=st.data(), garbage=st.binary(min_size=7, max_size=7), tail=st.binary(max_size=3))
def test_given_any_message_with_garbage_in_its_gaps_then_it_is_what_rosbags_writes(
    name, data, garbage, tail
):
    clean = bytes(STORE.serialize_cdr(data.draw(messages_of(STORE, name)), name))
    walk = walk_of(STORE, name)
    spoilt = dirty(clean, walk, garbage)
    again = bytes(STORE.serialize_cdr(STORE.deserialize_cdr(spoilt, name), name))
    assert again == clean, 'what was spoilt means nothing'
    assert walk.without_gaps(spoilt + tail) == clean
    assert walk.without_gaps(clean) is clean, 'nothing is copied for nothing'


@given(garbage=st.binary(min_size=7, max_size=7))
def test_given_equally_long_messages_with_gaps_elsewhere_then_each_is_fixed_in_its_own(garbage):
    name = 'diagnostic_msgs/msg/KeyValue'
    walk = walk_of(STORE, name)
    kinds = [STORE.types[name](key='a', value='bbbbbb'), STORE.types[name](key='aaaa', value='bb')]
    clean = [bytes(STORE.serialize_cdr(kind, name)) for kind in kinds]
    assert len(clean[0]) == len(clean[1])
    for one in [*clean, *clean]:
        assert walk.without_gaps(one) is one, 'known from then on'
        for other in clean:
            assert walk.without_gaps(dirty(other, walk, garbage)) == other
            assert walk.without_gaps(other + b'\1') == other


def test_given_more_layouts_than_are_remembered_then_every_message_is_fixed():
    walk = walk_of(STORE, 'std_msgs/msg/String')
    texts = [bytes(STORE.serialize_cdr(STORE.types['std_msgs/msg/String'](data='a' * size),
                                       'std_msgs/msg/String')) for size in range(40)]
    for one in [*texts, *texts]:
        assert walk.without_gaps(one) is one


@pytest.mark.one_in(3)
@pytest.mark.parametrize('name', TYPES)
@settings(max_examples=30, deadline=None)  # of each type
@given(data=st.data())
def test_given_bytes_that_are_cut_or_changed_then_it_ends_with_an_error_or_bytes(name, data):
    clean = bytearray(STORE.serialize_cdr(data.draw(messages_of(STORE, name)), name))
    at = data.draw(st.integers(4, max(4, len(clean) - 1)))
    clean[at:at + 4] = data.draw(st.binary(max_size=4))
    with contextlib.suppress(ValueError, struct.error):
        assert len(walk_of(STORE, name).without_gaps(bytes(clean))) <= len(clean)


def test_given_a_recorded_run_then_its_messages_are_canonical_and_stay_so():
    bag = GOLDEN / 'taxinet-midday'
    canonical = Canonical(read_info(bag).topics)
    stored = list(stored_messages(bag))
    assert len(stored) == sum(read_info(bag).counts.values()) > 500
    for one in stored:
        assert canonical.message(one.topic.name, one.cdr) is one.cdr


@pytest.mark.parametrize('spoil', [
    lambda cdr: b'', lambda cdr: cdr[:3], lambda cdr: cdr[:-1], lambda cdr: cdr + bytes(4),
    lambda cdr: b'\x00\x00' + cdr[2:], lambda cdr: cdr[:4] + b'\xff' * (len(cdr) - 4),
])
def test_given_bytes_that_are_no_message_then_the_error_names_the_topic(spoil):
    bag = GOLDEN / 'truth-nominal'
    canonical = Canonical(read_info(bag).topics)
    one = next(m for m in stored_messages(bag) if m.topic.name == '/scenario')
    with pytest.raises(BagCorrupt, match=r'/scenario: .* bytes are no message of it'):
        canonical.message('/scenario', spoil(one.cdr))
