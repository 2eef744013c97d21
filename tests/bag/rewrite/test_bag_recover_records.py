"""Damage to each kind of record on purpose: every undamaged message is saved, none is invented."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_faults import chunks_of, messages_by_chunk
from bag_samples import samples, topics
from mcap.opcode import Opcode

from taxinet_ros.bag.cdr.decode import definition_hash
from taxinet_ros.bag.reader import read_info, stored_messages
from taxinet_ros.bag.rewrite.recovery import recover
from taxinet_ros.bag.storage.records import HEAD, MAGIC
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.bag.writer import BagWriter

pytestmark = pytest.mark.nightly

GOLDEN = Path(__file__).parents[3] / 'bags' / 'golden' / 'truth-nominal'
BLOCK = 4096
STEPS, SHAPE = 4, (64, 64)
COMMENTS = '# in metres, positive to the left\n' * 270
"""As in the definition of sensor_msgs/msg/CameraInfo, so that a block fits into the record."""
FINISHED_ONLY = {
    Opcode.DATA_END, Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET, Opcode.FOOTER,
}
KINDS = {
    Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK, Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT, Opcode.METADATA,
} | FINISHED_ONLY

Place = tuple[int, int, int]
"""Opcode of a record, its first byte, and the byte behind it."""


def described() -> list[TopicInfo]:
    return [replace(one, definition=COMMENTS + one.definition) for one in topics()]


@pytest.fixture(scope='module')
def recorded(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A finished bag whose records outside the chunks are larger than a block."""
    with BagWriter(
        tmp_path_factory.mktemp('recorded') / 'run', described(), metadata={'words': COMMENTS},
        attachments={'scenario.scenic': COMMENTS.encode()}, min_free_bytes=0,
    ) as bag:
        last = 0
        for topic, stamp_ns, cdr in samples(STEPS, shape=SHAPE):
            if stamp_ns != last:
                bag.flush()
            last = stamp_ns
            bag.write(topic, cdr, stamp_ns)
        bag.add_metadata('outcome', {'outcome': COMMENTS})
        return bag.close().mcap.read_bytes()


def records_of(data: bytes) -> Iterator[Place]:
    start = len(MAGIC)
    while start + HEAD.size <= len(data) - len(MAGIC):
        opcode, length = HEAD.unpack_from(data, start)
        end = start + HEAD.size + length
        yield opcode, start, end
        start = end


def unfinished(data: bytes) -> bytes:
    return data[:chunks_of(data)[-1][1]]


def check_recovery(recorded: bytes, data: bytes, start: int, stop: int, path: Path) -> None:
    """Recover the damaged ``data``: undamaged messages are there, with their topics as recorded."""
    path.mkdir(exist_ok=True)
    file = path / 'damaged.mcap'
    file.write_bytes(data)
    known = {topic.name: topic for topic in described()}
    names = list(known)  # channels are numbered from 1 in this order
    every = Counter(samples(STEPS, shape=SHAPE))
    expected = Counter(
        (names[channel - 1], stamp, cdr)
        for first, end, messages in messages_by_chunk(recorded) if stop <= first or start >= end
        for channel, stamp, cdr in messages
    )
    # What is found in a chunk whose header alone is damaged is a gain.
    outcome = recover(file, path / f'{start}-{stop}-{len(data)}-{sum(data[start:stop])}')
    saved = list(stored_messages(outcome.bag.folder))
    found = Counter((one.topic.name, one.stamp_ns, one.cdr) for one in saved)
    assert not expected - found, (start, outcome.damage)
    assert not found - every, (start, outcome.damage)
    assert {one.topic.name: one.topic for one in saved} == {
        name: known[name] for name in {one.topic.name for one in saved}
    }, (start, outcome.damage)
    assert {topic.name for topic in read_info(outcome.bag.folder).topics} <= set(known)
    assert outcome.damage, start


def test_given_the_bag_of_these_tests_then_a_block_fits_into_each_large_kind_of_record(recorded):
    assert {opcode for opcode, _, _ in records_of(recorded)} == KINDS
    large = {opcode for opcode, start, end in records_of(recorded) if end - start > 2 * BLOCK}
    assert large == {Opcode.SCHEMA, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.CHUNK}
    assert len(chunks_of(recorded)) > STEPS


@pytest.mark.parametrize('ending', [bytes, unfinished])
@pytest.mark.parametrize('kind', sorted(KINDS))
def test_f3_given_zeros_in_a_record_of_each_kind_then_all_undamaged_messages_are_recovered(
    recorded: bytes, tmp_path: Path, kind: int, ending: Callable[[bytes], bytes]
) -> None:
    whole = ending(recorded)
    places = [one for one in records_of(whole) if one[0] == kind][:20]
    assert bool(places) == (ending is bytes or kind not in FINISHED_ONLY)
    blocks = set()
    for _, start, end in places:
        first, last = start // BLOCK, (end - 1) // BLOCK
        blocks |= {BLOCK * number for number in {first, (first + last) // 2, last}}
        if end - start > BLOCK + 64:  # a block within the record, which leaves its structure whole
            blocks.add(end - BLOCK - 32)
    for start in sorted(blocks):
        data = bytearray(whole)
        data[start:start + BLOCK] = bytes(len(data[start:start + BLOCK]))
        check_recovery(recorded, bytes(data), start, start + BLOCK, tmp_path)


@pytest.mark.parametrize('ending', [bytes, unfinished])
@pytest.mark.parametrize('kind', sorted(KINDS))
def test_f3_given_flips_in_a_record_of_each_kind_then_all_undamaged_messages_are_recovered(
    recorded: bytes, tmp_path: Path, kind: int, ending: Callable[[bytes], bytes]
) -> None:
    whole, rng = ending(recorded), np.random.default_rng(kind)
    places = [one for one in records_of(whole) if one[0] == kind]
    assert bool(places) == (ending is bytes or kind not in FINISHED_ONLY)
    for _, start, end in places[:8]:
        near = {start, start + 1, start + HEAD.size, start + HEAD.size + 6, end - 1}
        for place in sorted(near | set(map(int, rng.integers(start, end, 3)))):
            data = bytearray(whole)
            data[place] ^= 1 << int(rng.integers(8))
            check_recovery(recorded, bytes(data), place, place + 1, tmp_path)


def test_given_the_only_copy_of_a_definition_damaged_then_the_installed_one_of_its_hash_is_taken(
    recorded: bytes, tmp_path: Path
) -> None:
    data = bytearray(unfinished(recorded))
    data[chunks_of(recorded)[0][1] - 6] ^= 0x10
    odd = data.index(b'float64 cross_track_error')
    data[odd:odd + 7] = b'int8\0\0\0'
    path = tmp_path / 'damaged.mcap'
    path.write_bytes(data)
    outcome = recover(path, tmp_path / 'saved')
    (_, _, lost), *_ = messages_by_chunk(recorded)
    assert outcome.saved == len(samples(STEPS)) - len(lost) > 0
    assert any('/tracking_error' in line and 'installed' in line for line in outcome.damage)
    saved = read_info(tmp_path / 'saved').topics
    assert len(saved) == len(topics())
    assert all(definition_hash(one) == one.type_hash for one in saved)


def test_given_a_topic_in_two_copies_then_its_damaged_name_is_no_topic(
    recorded: bytes, tmp_path: Path
) -> None:
    data = bytearray(recorded)
    data[recorded.index(b'/taxi_command') + 1] = ord('x')
    path = tmp_path / 'damaged.mcap'
    path.write_bytes(data)
    names = [topic.name for topic in read_info(path).topics]
    assert names == [topic.name for topic in topics()]


def test_f3_given_each_block_before_the_chunks_of_a_run_zeroed_then_all_messages_are_recovered(
    tmp_path: Path
) -> None:
    (file,) = GOLDEN.glob('*.mcap')
    whole = file.read_bytes()
    expected = list(stored_messages(file))
    blocks = range(0, chunks_of(whole)[0][0] - BLOCK, BLOCK)
    assert len(blocks) > 8
    for start in blocks:
        data = whole[:start] + bytes(BLOCK) + whole[start + BLOCK:]
        (tmp_path / 'damaged.mcap').write_bytes(data)
        outcome = recover(tmp_path / 'damaged.mcap', tmp_path / f'saved-{start}')
        assert (outcome.saved, outcome.declared) == (len(expected), len(expected))
        assert list(stored_messages(outcome.bag.folder)) == expected
