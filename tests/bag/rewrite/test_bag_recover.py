"""Recovery: all before the damage, and nothing else, in a new whole bag."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bag_samples
import pytest
from bag_faults import PER_STEP, STEPS, chunk, chunks_of, declarations, file_with, read_all
from bag_samples import samples
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from whole_runs import run_messages, write_run

from taxinet_ros.bag.cdr.decode import definition_hash
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty
from taxinet_ros.bag.reader import read_attachment, read_info, read_messages, stored_messages
from taxinet_ros.bag.rewrite.recovery import recover
from taxinet_ros.bag.storage.records import encode
from taxinet_ros.bag.writer import BagWriter


def test_given_each_chunk_damaged_when_recovered_then_all_before_it_is_saved(
    whole: bytes, damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    expected = samples(STEPS)
    chunks = chunks_of(whole)
    assert len(chunks) == STEPS
    for number, (start, end) in enumerate(chunks[1:], 1):
        data = bytearray(whole)
        data[end - 6] ^= 0x10
        outcome = recover(damaged(bytes(data)), tmp_path / f'saved{number}')
        saved, error = read_all(tmp_path / f'saved{number}')
        assert error is None
        assert saved == expected[:len(saved)]
        assert len(saved) - number * PER_STEP in (0, 1)
        assert f'at byte {start}: ' in outcome.damage[0]
        assert len(outcome.damage) == 1
        assert outcome.declared == len(expected)
        assert outcome.saved == len(saved)
        info = read_info(outcome.bag.folder)
        assert info.complete
        assert info.metadata['taxinet'] == bag_samples.METADATA
        assert read_attachment(outcome.bag.folder, 'scenario.scenic')
        assert _with_the_library(outcome.bag.mcap) == [cdr for _, _, cdr in saved]


def _with_the_library(path: Path) -> list[bytes]:
    """Messages by the indexes, as players find them, and by the library's own reading of all."""
    with path.open('rb') as file:
        for _ in StreamReader(file, validate_crcs=True).records:
            pass
        file.seek(0)
        reader = make_reader(file, validate_crcs=True)
        return [message.data for *_, message in reader.iter_messages(log_time_order=False)]


def test_given_an_unfinished_bag_when_recovered_then_it_is_whole(
    whole: bytes, damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    (_, end) = chunks_of(whole)[-1]
    outcome = recover(damaged(whole[:end]), tmp_path / 'saved' / 'run')
    assert read_all(tmp_path / 'saved' / 'run') == (samples(STEPS), None)
    assert outcome.bag.message_counts == read_info(damaged(whole)).counts
    assert 'the end of the file is missing' in outcome.damage[0]


def test_given_a_damaged_definition_at_the_top_when_recovered_then_the_copy_in_the_chunk_counts(
    whole: bytes, damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    data = bytearray(whole)
    data[data.index(b'cross_track_error')] = ord('x')
    with pytest.raises(BagCorrupt, match='the data contradicts its checksum'):
        list(read_messages(damaged(bytes(data))))
    outcome = recover(damaged(bytes(data)), tmp_path / 'saved')
    assert read_all(tmp_path / 'saved') == (samples(STEPS), None)
    assert len(outcome.damage) == 1


def test_given_the_only_copy_of_a_definition_damaged_when_recovered_then_its_topic_is_left_out(
    whole: bytes, damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    info = read_info(damaged(whole))
    (topic,) = [one for one in info.topics if one.name == '/taxi_command']
    odd = replace(topic, definition=topic.definition.replace('speed', 'speex'))
    with BagWriter(
        tmp_path / 'run', [odd, *(one for one in info.topics if one != topic)], metadata={},
        attachments={}, min_free_bytes=0,
    ) as bag:
        for name, stamp_ns, cdr in samples(STEPS):
            bag.write(name, cdr, stamp_ns)
    outcome = recover(tmp_path / 'run', tmp_path / 'saved')
    assert outcome.damage == (
        "left out: topic '/taxi_command': its definition contradicts its type hash",
    )
    saved, error = read_all(tmp_path / 'saved')
    assert (saved, error) == ([m for m in samples(STEPS) if m[0] != '/taxi_command'], None)


def test_given_nothing_sound_when_recovered_then_refused_and_no_folder_made(
    whole: bytes, damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    with pytest.raises(BagEmpty, match='nothing can be recovered'):
        recover(damaged(whole[:20]), tmp_path / 'saved')
    assert not (tmp_path / 'saved').exists()


def test_given_only_the_description_lost_when_recovered_then_bytes_are_the_recorders(
    tmp_path: Path,
) -> None:
    file = write_run(tmp_path / 'run')
    text = (file.parent / 'metadata.yaml').read_bytes()
    (file.parent / 'metadata.yaml').unlink()
    before = file.read_bytes()
    outcome = recover(file.parent, tmp_path / 'new' / 'run')
    assert outcome.damage == ()
    assert outcome.declared == outcome.saved == len(run_messages())
    assert outcome.bag.mcap.read_bytes() == before == file.read_bytes()
    assert (tmp_path / 'new' / 'run' / 'metadata.yaml').read_bytes() == text
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_given_a_bare_bag_when_recovered_then_what_it_did_not_note_is_added(
    damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    odd = Channel(id=2, topic='not a name', message_encoding='cdr', metadata={}, schema_id=1)
    raw = declarations() + encode(odd) + encode(Message(1, 5, b'\0\1\0\0\7', 5, 0))
    outcome = recover(
        damaged(file_with(chunk(raw, len(raw), '', crc=0))), tmp_path / 'saved'
    )
    assert outcome.saved == 1
    assert any('left out' in line and 'not a name' in line for line in outcome.damage)
    info = read_info(tmp_path / 'saved')
    assert info.complete
    (topic,) = info.topics
    assert topic.type_hash == definition_hash(topic)
    assert topic.qos == '[]\n'


def _foreign(path: Path, *, other_type: bool) -> Path:
    """A bag as no recorder of ours writes it: names come twice, published is not logged."""
    with path.open('wb') as file:
        bag = Writer(file)
        bag.start(profile='ros2')
        text = bag.register_schema('std_msgs/msg/String', 'ros2msg', b'string data\n')
        number = bag.register_schema('std_msgs/msg/Int32', 'ros2msg', b'int32 data\n')
        same = bag.register_schema('std_msgs/msg/String', 'ros2msg', b'# a remark\nstring data\n')
        channels = [bag.register_channel('/a', 'cdr', schema) for schema in (text, same, number)]
        for k, channel in enumerate(channels[:2 + other_type]):
            data = struct.pack('<i', 7) if channel == channels[2] else b'\2\0\0\0x\0'
            bag.add_message(channel, 10 * k + 10, b'\0\1\0\0' + data, 3 + k)
        for k in (1, 2):
            bag.add_attachment(k, k + 5, 'n', 'text/markdown', b'%d' % k)
            bag.add_attachment(k, k, 'manifest.json', 'text/plain', b'%d' % k)
            bag.add_metadata('m', {'a': str(k)})
        bag.finish()
    return path


def _beside_messages(path: Path) -> list[object]:
    with path.open('rb') as file:
        reader = make_reader(file)
        own = ('rosbag2', 'taxinet')
        attachments = [one for one in reader.iter_attachments() if b'taxinet_ros' not in one.data]
        return [*attachments, *(m for m in reader.iter_metadata() if m.name not in own)]


def test_given_another_recorders_bag_when_recovered_then_times_and_repeated_names_are_kept(
    tmp_path: Path,
) -> None:
    source = _foreign(tmp_path / 'foreign.mcap', other_type=False)
    outcome = recover(source, tmp_path / 'saved')
    assert outcome.damage == ()
    assert [tuple(m)[1:] for m in stored_messages(outcome.bag.mcap)] == [
        tuple(m)[1:] for m in stored_messages(source)
    ]
    assert [m.published_ns for m in stored_messages(outcome.bag.mcap)] == [3, 4]
    expected = _beside_messages(source)
    assert len(expected) == 6
    assert _beside_messages(outcome.bag.mcap) == expected
    again = recover(tmp_path / 'saved', tmp_path / 'again')
    assert _beside_messages(again.bag.mcap) == expected


def test_given_a_topic_of_two_types_when_recovered_then_what_is_left_out_is_told(
    tmp_path: Path,
) -> None:
    outcome = recover(_foreign(tmp_path / 'foreign.mcap', other_type=True), tmp_path / 'saved')
    assert outcome.damage == (
        "left out: topic '/a': 1 messages of type std_msgs/msg/Int32, as it is declared with "
        'another: std_msgs/msg/String',
    )
    assert (outcome.declared, outcome.saved) == (3, 2)
