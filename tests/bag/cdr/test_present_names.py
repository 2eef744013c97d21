"""The scenario message named its units, and has grown: bags of before and of now read alike."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from bag_samples import ROOT
from whole_runs import SCENE, write_run

from taxinet_ros.bag.cdr.decode import (
    decode,
    definition_hash,
    present_bytes,
    with_present_names,
)
from taxinet_ros.bag.errors import BagForeign
from taxinet_ros.bag.reader import read_info, stored_messages
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import TopicInfo, message_definition, type_hash
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    CAMERA,
    DATAREFS,
    FAULT_FIELDS,
    MESSAGE_FIELDS,
    PLACE,
    PUSHING_FIELDS,
    TRACK,
    TRAFFIC,
    Kind,
)

SCENARIO = 'taxinet_msgs/msg/Scenario'
BEFORE = ROOT / 'bags' / 'golden' / 'truth-nominal'
NEW = (*PUSHING_FIELDS, TRACK, *FAULT_FIELDS, TRAFFIC, CAMERA, DATAREFS)
RENAMED = {
    field.attribute: field.short for field in MESSAGE_FIELDS
    if field.short and field not in NEW
}


def scenario_message(bag: Path) -> StoredMessage:
    return next(stored_messages(bag, lambda name: name.endswith('/scenario')))


def before_units(topic: TopicInfo) -> TopicInfo:
    """The topic as a recorder of before described it."""
    definition = re.sub(
        r'^(float64 )(\w+)', lambda field: field[1] + RENAMED.get(field[2], field[2]),
        topic.definition, flags=re.MULTILINE,
    )
    return described(topic, definition)


def before_wind(topic: TopicInfo) -> TopicInfo:
    """The topic without later keys: what pushes, what fails, the track and the place."""
    new = '|'.join(field.attribute for field in (*NEW, PLACE))
    definition = re.sub(rf'^\w+ ({new}) .*\n', '', topic.definition, flags=re.MULTILINE)
    return described(topic, definition)


def described(topic: TopicInfo, definition: str) -> TopicInfo:
    old = replace(topic, definition=definition)
    return replace(old, type_hash=definition_hash(old))


def test_given_the_renamed_fields_then_they_are_the_numbers_of_a_scenario():
    numbers = [field for field in MESSAGE_FIELDS if field.kind is Kind.NUMBER]
    assert re.findall(r'^float64 (\w+)', message_definition(SCENARIO), re.MULTILINE) == [
        field.attribute for field in numbers
    ]
    assert list(RENAMED) == [
        field.attribute for field in numbers if field not in NEW
    ]


def test_given_a_bag_of_before_when_read_then_its_scene_is_there_under_the_names_of_now():
    message = scenario_message(BEFORE)
    assert re.search(r'^float64 time_of_day\b', message.topic.definition, re.MULTILINE)
    assert message.topic.type_hash == definition_hash(message.topic) != type_hash(SCENARIO)
    scene = decode(message.topic, message.cdr)
    assert not hasattr(scene, 'time_of_day')
    assert scene.time_of_day_s == scenario_of(scene).time_of_day_s
    assert open_recording(BEFORE).scenario == scenario_of(scene)


def test_given_a_bag_of_now_when_read_as_one_of_before_then_every_value_is_the_same(tmp_path):
    write_run(tmp_path / 'run')
    message = scenario_message(tmp_path / 'run')
    old = before_units(message.topic)
    assert definition_hash(message.topic) == message.topic.type_hash == type_hash(SCENARIO)
    assert before_wind(old).type_hash == scenario_message(BEFORE).topic.type_hash
    assert scenario_of(decode(message.topic, message.cdr)) == SCENE
    assert scenario_of(decode(old, message.cdr)) == SCENE
    assert definition_hash(with_present_names(old)) == type_hash(SCENARIO)


def test_given_other_messages_then_no_field_is_renamed(tmp_path):
    write_run(tmp_path / 'run')
    for topic in read_info(tmp_path / 'run').topics:
        assert with_present_names(topic) == topic, 'of now there is nothing to rename'
    other = TopicInfo(
        name='/x', type='other_msgs/msg/Scenario', qos='', definition='float64 rain', type_hash='',
    )
    assert with_present_names(other) is other


def test_given_a_bag_of_before_there_was_wind_when_read_then_there_is_none():
    message = scenario_message(BEFORE)
    assert not re.search('wind', message.topic.definition)
    scene = scenario_of(decode(message.topic, message.cdr))
    for field in NEW:
        assert getattr(scene, field.attribute) == field.absent == getattr(
            Scenario(), field.attribute
        ), field.key


def test_given_a_message_of_before_there_was_wind_then_its_bytes_of_now_say_the_same(tmp_path):
    write_run(tmp_path / 'run')
    message = scenario_message(tmp_path / 'run')
    before = scenario_message(BEFORE)
    for topic in (before.topic, before_wind(message.topic)):
        converted = present_bytes(topic, message.topic.definition)
        said = decode(message.topic, converted(before.cdr))
        assert scenario_of(said) == scenario_of(decode(before.topic, before.cdr))
        assert said.run_id == 'truth-nominal'
        assert said.participants == decode(before.topic, before.cdr).participants


def test_given_other_messages_than_those_of_before_then_their_bytes_are_not_made_up(tmp_path):
    write_run(tmp_path / 'run')
    topic = scenario_message(tmp_path / 'run').topic
    definition = topic.definition
    assert present_bytes(topic, definition) is None, 'of now there is nothing to add'
    assert present_bytes(replace(topic, type='other_msgs/msg/Scenario'), definition) is None
    for missing in ('date', 'distance_m'):
        less = re.sub(rf'^\w+ {missing} .*\n', '', before_wind(topic).definition, flags=re.M)
        assert present_bytes(described(topic, less), definition) is None, missing


def test_given_a_scenario_with_both_names_of_a_field_then_it_is_not_understood():
    both = TopicInfo(
        name='/scenario', type=SCENARIO, qos='', definition='float64 rain\nfloat64 rain_fraction',
        type_hash='',
    )
    with pytest.raises(BagForeign, match='not understood'):
        decode(both, bytes(20))
