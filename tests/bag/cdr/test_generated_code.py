"""Code that is generated for a type: as rosbags generates it, and no more than is used."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore, store

from taxinet_ros.bag.cdr.decode import decode, typestore
from taxinet_ros.bag.topics import TopicInfo, describe_topic, message_definition, types_of

ODOMETRY = 'nav_msgs/msg/Odometry'
TYPES = (
    ODOMETRY, 'sensor_msgs/msg/CameraInfo', 'taxinet_msgs/msg/Scenario', 'tf2_msgs/msg/TFMessage',
    'taxinet_msgs/msg/Verdict', 'visualization_msgs/msg/MarkerArray', 'std_msgs/msg/Empty',
)


def _topic(name: str) -> TopicInfo:
    return describe_topic(name='/a', type_name=name, qos='')


def _odometry(kinds: Any) -> Any:
    def made(name: str, *values: Any) -> Any:
        return kinds[name](*values)

    stamp = made('builtin_interfaces/msg/Time', 3, 5)
    vectors = [made('geometry_msgs/msg/Vector3', *np.arange(3.0) + k) for k in range(2)]
    pose = made('geometry_msgs/msg/Pose', made('geometry_msgs/msg/Point', 1.0, 2.0, 3.0),
                made('geometry_msgs/msg/Quaternion', 0.0, 0.0, 0.6, 0.8))
    return made(
        ODOMETRY, made('std_msgs/msg/Header', stamp, 'map'), 'body',
        made('geometry_msgs/msg/PoseWithCovariance', pose, np.arange(36.0)),
        made('geometry_msgs/msg/TwistWithCovariance', made('geometry_msgs/msg/Twist', *vectors),
             np.arange(36.0) + 1),
    )


@pytest.mark.parametrize('little', [True, False])
def test_given_a_type_when_written_and_read_then_it_is_as_rosbags_has_it(little: bool) -> None:
    ours, theirs = typestore(_topic(ODOMETRY)), get_typestore(Stores.EMPTY)
    theirs.register(get_types_from_msg(message_definition(ODOMETRY), ODOMETRY))
    cdr = ours.serialize_cdr(_odometry(ours.types), ODOMETRY, little_endian=little)
    assert cdr == theirs.serialize_cdr(_odometry(theirs.types), ODOMETRY, little_endian=little)
    read, expected = (one.deserialize_cdr(cdr, ODOMETRY) for one in (ours, theirs))
    assert repr(dataclasses.asdict(read)) == repr(dataclasses.asdict(expected))
    if little:
        assert ours.cdr_to_ros1(cdr, ODOMETRY) == theirs.cdr_to_ros1(cdr, ODOMETRY)


def test_given_a_message_when_decoded_then_no_code_for_other_formats_is_generated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    topic = _topic(ODOMETRY)
    cdr = bytes(typestore(topic).serialize_cdr(_odometry(typestore(topic).types), ODOMETRY))
    for name in [name for name in vars(store) if name.startswith('generate_') and 'ros1' in name]:
        monkeypatch.setattr(store, name, None)
    renamed = topic.definition.replace('string child_frame_id', 'string child')
    assert renamed != topic.definition
    again = dataclasses.replace(topic, definition=renamed)
    assert decode(again, cdr).child == 'body'
    written = typestore(again).serialize_cdr(decode(again, cdr), ODOMETRY)
    assert bytes(written) == cdr


@pytest.mark.parametrize('name', TYPES)
def test_given_a_definition_when_parsed_in_parts_then_it_is_as_rosbags_parses_it(name: str) -> None:
    text = message_definition(name)
    expected = get_types_from_msg(text, name)
    assert list(types_of(text, name).items()) == list(expected.items())
