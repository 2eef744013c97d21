"""Nonsense in sound files: mutants of messages and definitions, and values at the edges."""

from __future__ import annotations

import dataclasses
import math
import shutil
import struct
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_samples import Sample, serialise, store
from fuzz_mutations import ROUNDS, mutants
from fuzz_watch import end_of, watched
from hypothesis import given
from hypothesis import strategies as st
from whole_runs import run_messages, run_topics

from taxinet_ros.bag.cdr.alignment import walk_of
from taxinet_ros.bag.cdr.image import frame_of_cdr, image_cdr
from taxinet_ros.bag.check.judge import judge_runs
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.bag.writer import BagWriter

pytestmark = pytest.mark.nightly

MUTANTS = 12
READERS: dict[str, Callable[[Path], object]] = {
    'trace': lambda path: open_recording(path).columns,
    'samples': lambda path: open_recording(path).samples_of(None),
    'judge': judge_runs,
    'run': lambda path: open_recording(path).run,
    'facts': lambda path: open_recording(path).facts,
    'images': lambda path: deque(open_recording(path).frames(render=False), maxlen=0),
}
TRUTH = '/ground_truth/tracking_error'


def few() -> list[Sample]:
    """Three steps of a run, one of them with a frame, and its end."""
    return [
        message for message in run_messages()
        if (message[1] <= 200_000_000 or message[0] in ('/monitor/verdict', '/run_status'))
        and (message[0] != '/camera/image_raw' or message[1] == 0)
    ]


def write(folder: Path, messages: list[Sample], topics: list[TopicInfo]) -> Path:
    with BagWriter(folder, topics, metadata={}, attachments={}, min_free_bytes=0) as bag:
        for topic, stamp_ns, cdr in messages:
            bag.write(topic, cdr, stamp_ns)
        bag.close()
    return folder


def ends_of(path: Path) -> Counter[str]:
    return Counter(f'{name} {end_of(lambda read=read: read(path))}'
                   for name, read in READERS.items())


def test_given_mutants_of_messages_when_read_then_only_typed_errors_of_one_line_come(
    tmp_path: Path
) -> None:
    messages, topics = few(), run_topics()
    assert set(ends_of(write(tmp_path / 'sound', messages, topics))) == {
        f'{name} ok' for name in READERS
    }
    ends = Counter[str]()
    with watched(tmp_path):
        for number in range(MUTANTS * ROUNDS):
            changed, described = list(messages), list(topics)
            place = number * 7 % len(messages)
            topic, stamp_ns, cdr = messages[place]
            changed[place] = topic, stamp_ns, cdr[:4] + next(mutants([cdr[4:]], 1, seed=number))
            if number % 3 == 0:
                kind = topics[number // 3 % len(topics)]
                text = next(mutants([kind.definition.encode()], 1, seed=number, text=True))
                described[topics.index(kind)] = dataclasses.replace(
                    kind, definition=text.decode('utf-8', 'replace')
                )
            ends += ends_of(write(tmp_path / 'run', changed, described))
            shutil.rmtree(tmp_path / 'run')
    assert sum(ends.values()) == MUTANTS * ROUNDS * len(READERS)


@pytest.mark.parametrize(('field', 'value'), [
    ('duration', math.inf), ('duration', math.nan), ('duration', 1e300), ('duration', -1.0),
    ('specs', ['nonsense(']), ('specs', []), ('run_id', '../x'), ('clouds', 'x\ny'),
    ('stop_on', 'never\n'), ('program', '\x1b]0;title\x07'),
])
def test_given_a_scenario_at_the_edges_when_read_then_one_line_or_a_result(
    field: str, value: object, tmp_path: Path
) -> None:
    (_, _, cdr), *rest = few()
    scenario = store().deserialize_cdr(cdr, 'taxinet_msgs/msg/Scenario')
    setattr(scenario, field, value)
    ends = ends_of(write(
        tmp_path / 'run', [('/scenario', 0, serialise(scenario)), *rest], run_topics()
    ))
    assert ends['images ok'] == (field != 'run_id'), 'that of another run'


def test_given_steps_beyond_all_numbers_when_traced_then_one_line(tmp_path: Path) -> None:
    topics = [
        dataclasses.replace(topic, definition=topic.definition.replace('uint32 seq', 'uint64 seq'))
        if topic.name == TRUTH else topic for topic in run_topics()
    ]
    head = struct.pack('<iI', 0, 0) + _text('map') + _text('r')
    answer = struct.pack('<Qdd?7x4d', 2**64 - 1, 0.0, 0.0, True, *[0.0] * 4)
    body = head + bytes(-len(head) % 8) + answer
    path = write(tmp_path / 'run', [(TRUTH, 0, b'\0\1\0\0' + body)], topics)
    assert end_of(lambda: open_recording(path).columns) == 'BagForeign'


def _text(text: str) -> bytes:
    return struct.pack('<I', len(text) + 1) + text.encode() + b'\0'


FRAME = image_cdr(np.arange(36, dtype=np.uint8).reshape(3, 4, 3), 5_000_000_001, 'camera')


@given(st.integers(0, 2**32 - 1))
def test_given_any_bytes_for_a_message_when_walked_then_a_value_error_or_a_result(
    seed: int
) -> None:
    body = next(mutants([FRAME[4:], _ODOMETRY[4:]], 1, seed=seed))
    for read in (frame_of_cdr, _WALK.without_gaps):
        try:
            read(FRAME[:4] + body)
        except (ValueError, struct.error):
            continue


_ODOMETRY = next(cdr for topic, _, cdr in few() if topic == '/ground_truth/odom')
_WALK = walk_of(store(), 'nav_msgs/msg/Odometry')
