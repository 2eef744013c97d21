"""A bag of a run whose messages arrive in any order holds them in the order of the table."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.reader import read_info, stored_messages
from taxinet_ros.bag.run.live_bag import BROKEN_LOOKS, PATIENT_LOOKS, LiveBag, stepped_topics
from taxinet_ros.bag.run.messages import header_values, message_cdr
from taxinet_ros.bag.run.topics import NODE_READY, RUN_ENDED
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.core import topics
from taxinet_ros.core.topics import SIMULATOR
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import InfraError, UsageError

GOLDEN = Path(__file__).parents[3] / 'bags' / 'golden' / 'truth-nominal'
MESSAGES = list(stored_messages(GOLDEN, lambda name: True))
STEP_NS = 100_000_000
STEPPED = {'/' + topic.name.lstrip('/'): topic for topic in stepped_topics(images=True)}


def of(topic: topics.Topic) -> list[tuple[Any, bytes]]:
    """Recorded messages of a topic, decoded and as bytes."""
    name = '/' + topic.name.lstrip('/')
    return [(decoder(one.topic)(one.cdr), one.cdr) for one in MESSAGES if one.topic.name == name]


((SCENARIO, SCENARIO_CDR),) = of(topics.SCENARIO)
STEPS = [one for one in MESSAGES if one.topic.name in STEPPED]
LAST = max(one.stamp_ns for one in STEPS) // STEP_NS


def open_live(folder: Path) -> LiveBag:
    images = any(one.topic.name == '/camera/image_raw' for one in MESSAGES)
    return LiveBag(
        folder, SCENARIO, SCENARIO_CDR, images=images, attachments={}, min_free_bytes=0,
        make_parents=True,
    )


def message(topic: topics.Topic, **values: Any) -> bytes:
    return message_cdr(topic, {'header': header_values(0, ''), 'run_id': GOLDEN.name, **values})


def get_ready(bag: LiveBag) -> list[int]:
    """The READY messages of all nodes; one of a usual simulator is in no bag."""
    reports = [cdr for _, cdr in of(topics.NODE_STATUS)]
    reports.append(message(topics.NODE_STATUS, node=SIMULATOR, state=NODE_READY))
    return [
        step for cdr in (*reports, *reports) for step in bag.take(topics.NODE_STATUS, cdr)
    ]


def feed(bag: LiveBag, messages: list[StoredMessage]) -> list[int]:
    return [step for one in messages for step in bag.take(STEPPED[one.topic.name], one.cdr)]


def content(folder: Path) -> list[tuple[str, int, bytes]]:
    return [
        (one.topic.name, one.stamp_ns, one.cdr) for one in stored_messages(folder, lambda _: True)
    ]


@pytest.mark.parametrize('seed', range(3))
def test_given_messages_in_any_order_then_the_bag_is_the_recorded_one(tmp_path, seed):
    bag = open_live(tmp_path / GOLDEN.name)
    names = random.Random(seed).sample([one.topic.name for one in STEPS], len(STEPS))
    streams = {name: iter([m for m in STEPS if m.topic.name == name]) for name in STEPPED}
    shuffled = [next(streams[name]) for name in names]  # each topic keeps its order
    half = len(shuffled) // 2
    assert feed(bag, shuffled[:half]) == [], 'the head is not there yet'
    written = get_ready(bag) + feed(bag, shuffled[half:])
    assert written == list(range(LAST + 1))
    ((_, status),) = of(topics.RUN_STATUS)
    bag.take(topics.RUN_STATUS, message(topics.RUN_STATUS, state=RUN_ENDED, run_id='another'))
    assert bag.ended is None
    bag.take(topics.RUN_STATUS, status)
    bag.silent_looks = PATIENT_LOOKS
    assert not bag.is_whole(), 'its verdict is missing'
    ((_, verdict),) = of(topics.VERDICT)
    bag.take(topics.VERDICT, verdict)
    assert bag.is_whole()
    bag.close()
    assert content(bag.folder) == content(GOLDEN)
    assert read_info(bag.folder).complete


def test_given_a_judged_run_of_which_a_step_is_lost_then_its_bag_is_an_error(tmp_path):
    bag = open_live(tmp_path / 'run')
    get_ready(bag)
    feed(bag, [one for one in STEPS if one.stamp_ns != 3 * STEP_NS])
    for topic in (topics.VERDICT, topics.RUN_STATUS):
        bag.take(topic, of(topic)[0][1])
    with pytest.raises(RuntimeError, match=f'3 of {LAST + 1} steps were recorded'):
        bag.is_whole()
    bag.abandon()
    assert not read_info(bag.folder).complete


@pytest.mark.parametrize(('outcome', 'looks'), [
    (Outcome.INTERRUPTED, PATIENT_LOOKS), (Outcome.INFRA_ERROR, BROKEN_LOOKS),
])
def test_given_a_run_that_broke_then_what_came_is_there_after_a_while(tmp_path, outcome, looks):
    bag = open_live(tmp_path / 'run')
    get_ready(bag)
    torn = [one for one in STEPS if one.stamp_ns <= 4 * STEP_NS][:-1]
    assert feed(bag, torn) == [0, 1, 2, 3]
    bag.take(topics.RUN_STATUS, message(
        topics.RUN_STATUS, state=RUN_ENDED, outcome=outcome, seq=4, perception='truth'))
    bag.silent_looks = looks - 1
    assert not bag.is_whole()
    bag.silent_looks = looks
    assert bag.is_whole()
    bag.close()
    assert [name for name, *_ in content(bag.folder) if name in STEPPED] == [
        one.topic.name for one in torn
    ]
    assert read_info(bag.folder).complete


def test_given_a_folder_that_is_there_then_it_is_not_touched(tmp_path):
    (tmp_path / 'run').mkdir()
    with pytest.raises(UsageError, match='already exists'):
        open_live(tmp_path / 'run')


def test_given_a_message_between_two_steps_then_its_node_is_named(tmp_path):
    bag = open_live(tmp_path / 'run')
    late = message_cdr(topics.CLOCK, {'clock': {'sec': 1, 'nanosec': 7}})
    with pytest.raises(InfraError, match='/clock stamped 1000000007 ns, which is not a control'):
        bag.take(topics.CLOCK, late)
    bag.abandon()
