"""A bag is played back in the order of time, at a rate and with pauses, by any clock."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.bag.playback import Playback, message_check, open_bag, recorded_quality, window
from taxinet_ros.bag.topics import TopicInfo, offered_qos
from taxinet_ros.core.topics import Quality
from taxinet_ros.errors import UsageError

GOLDEN = Path(__file__).parents[2] / 'bags' / 'golden' / 'truth-nominal'
STEP_NS = 100_000_000
ODOMETRY, SCENARIO = '/ground_truth/odom', '/scenario'


class Clock:
    """A wall clock that stands still."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def playback(clock: Clock, start_s: float = 0.0, rate: float = 1.0, **changes) -> Playback:
    info = open_bag(str(GOLDEN))
    values = {
        'checks': {ODOMETRY: lambda cdr: None, SCENARIO: lambda cdr: None},
        'latched': {SCENARIO}, 'on_unfit': pytest.fail,
    }
    return Playback(
        info, window(info, start_s, 0.0), rate=rate, clock=clock, **{**values, **changes})


def stamps(played: Playback) -> list[int]:
    """Stamps of all that is due."""
    found = []
    while (portion := played.due()) is not None:
        found.append(portion.stamp_ns)
    return found


def test_given_a_rate_then_so_much_is_due_and_no_more():
    clock = Clock()
    played = playback(clock, rate=4.0)
    assert stamps(played) == [0]
    clock.now_s += 0.06
    assert stamps(played) == [STEP_NS, 2 * STEP_NS]
    assert played.late_s == pytest.approx(0.035)
    assert not played.over


def test_given_a_pause_or_a_delay_then_what_follows_is_due_later_by_that():
    clock = Clock()
    played = playback(clock)
    assert stamps(played) == [0]
    played.pause(True)
    clock.now_s += 100.0
    assert (played.paused, stamps(played)) == (True, [])
    played.pause(False)
    assert stamps(played) == []
    played.delay(0.15)
    clock.now_s += 0.2
    assert stamps(played) == []
    clock.now_s += 0.1
    assert stamps(played) == [STEP_NS]


def test_given_an_offset_then_it_begins_there_after_what_was_latched_before_and_again():
    clock = Clock()
    info = open_bag(str(GOLDEN))
    played = playback(clock, info.duration_s - 0.25)
    for _ in range(2):
        first = played.due()
        assert first is not None
        assert first.stamp_ns == info.end_ns - 250_000_000
        assert [message.topic.name for message in first.messages] == [SCENARIO]
        assert stamps(played) == []
        clock.now_s += 1.0
        assert stamps(played) == [info.end_ns - k * STEP_NS for k in (2, 1, 0)]
        assert played.over
        played.begin()


def test_given_messages_that_are_none_then_they_are_left_out_and_said_once():
    said = []

    def refuse(cdr: bytes) -> None:
        raise BagCorrupt('torn')

    clock = Clock()
    played = playback(clock, checks={ODOMETRY: refuse}, on_unfit=said.append)
    portion = played.due()
    assert portion is not None
    assert portion.messages == ()
    clock.now_s += 1.0
    assert len(stamps(played)) == 10
    assert said == ['skipping messages: torn']


def topic(**more: str) -> TopicInfo:
    values = {
        'name': '/t', 'type': 'std_msgs/msg/Header', 'qos': '', 'definition': '', 'type_hash': '',
    }
    return TopicInfo(**{**values, **more})


def test_given_a_type_that_is_not_installed_then_nothing_is_imported_for_it():
    assert message_check(topic(type='antigravity/msg/Header')) is None
    assert 'antigravity' not in sys.modules
    with pytest.raises(UsageError, match='another version'):
        message_check(topic(type_hash='RIHS01_' + '0' * 64))


def test_given_recorded_qualities_of_service_then_they_are_offered_again():
    text = offered_qos(
        history='keep_last', depth=7, reliability='best_effort', durability='transient_local'
    )
    latched = Quality(depth=7, reliability='best_effort', durability='transient_local')
    assert recorded_quality(topic(qos=text)) == latched
    old = recorded_quality(topic(qos='- {history: 1, depth: 7, reliability: 2, durability: 1}'))
    assert old == latched
    strange = recorded_quality(topic(qos='- {depth: 999999999, durability: unknown}'))
    assert strange == Quality(depth=1000)
    assert recorded_quality(topic(qos='')) == Quality(depth=10)
