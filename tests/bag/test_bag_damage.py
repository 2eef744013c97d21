"""Killed writers, full disks, cut and flipped files: typed errors, and nothing sound is lost."""

from __future__ import annotations

import errno
import os
import pickle
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bag_samples
import numpy as np
import pytest
import zstandard
from bag_samples import ROOT, Sample, drain, samples, topics, write_bag
from mcap.records import Channel, Chunk, Header, Message, Schema

from taxinet_ros.bag.errors import (
    BagCorrupt,
    BagEmpty,
    BagError,
    BagForeign,
    BagTruncated,
    BagWriteError,
)
from taxinet_ros.bag.output import Output
from taxinet_ros.bag.reader import read_attachment, read_info, read_messages
from taxinet_ros.bag.recover import recover
from taxinet_ros.bag.scan import scan
from taxinet_ros.bag.storage import MAGIC, encode
from taxinet_ros.core.errors import UsageError

STEPS = 3
PER_STEP = 6

CHILD = """
import os, pickle, sys
from pathlib import Path
from taxinet_ros.bag.writer import BagWriter
topics, step = pickle.loads(Path(sys.argv[2]).read_bytes())
bag = BagWriter(Path(sys.argv[1]), topics, metadata={}, attachments={}, min_free_bytes=0)
"""

RECORD_FOR_EVER = CHILD + """
for k in range(10_000):
    for topic, _, cdr in step:
        bag.write(topic, cdr, k)
    bag.flush()
    os.write(1, b'.')
"""

RECORD_UNTIL_FULL = CHILD + """
import resource, signal
from taxinet_ros.bag.errors import BagWriteError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (700_000, resource.RLIM_INFINITY))
flushed, errors = 0, []
while len(errors) < 5:
    try:
        for topic, _, cdr in step:
            bag.write(topic, cdr, flushed)
        bag.flush()
        flushed += 1
    except BagWriteError as error:
        errors.append(error)
        # There is room again, but the bag has a gap.
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
try:
    bag.close()
except BagWriteError as error:
    errors.append(error)
bag.abandon()
print(flushed, len(errors), len({str(e) for e in errors}), errors[0].errno, errors[0].path.name)
"""


FULL_FRAME = (200, 360)
NO_FRAME = (0, 0)


def start_child(
    program: str, folder: Path, shape: tuple[int, int] = FULL_FRAME
) -> subprocess.Popen[bytes]:
    """Run a recording program, which gets the topics and the messages of one step."""
    step = folder.with_suffix('.step')
    step.write_bytes(pickle.dumps((topics(), samples(2, shape=shape)[1:1 + PER_STEP])))
    return subprocess.Popen(
        [sys.executable, '-c', program, str(folder), str(step)], stdout=subprocess.PIPE,
        env={**os.environ, 'PYTHONPATH': str(ROOT)},
    )


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A sound file of a few chunks."""
    return write_bag(tmp_path_factory.mktemp('whole') / 'run', samples(STEPS)).read_bytes()


@pytest.fixture
def damaged(tmp_path: Path) -> Callable[[bytes], Path]:
    """Puts bytes into a file."""
    def put(data: bytes) -> Path:
        path = tmp_path / 'run_0.mcap'
        path.write_bytes(data)
        return path
    return put


def read_all(path: Path) -> tuple[list[Sample], BagError | None]:
    """What can be read, and the error that ended it, which is one line and names the file."""
    found, error = drain(read_messages(path))
    assert error is None or ('\n' not in str(error) and str(path) in str(error))
    return [(m.topic, m.stamp_ns, m.cdr) for m in found], error


def test_given_a_recorder_killed_at_random_steps_when_read_then_at_most_one_step_is_lost(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(5)
    for trial in range(20):
        folder = tmp_path / f'run{trial}'
        with start_child(RECORD_FOR_EVER, folder, (FULL_FRAME, NO_FRAME)[trial % 2]) as child:
            assert child.stdout is not None
            flushed = len(child.stdout.read(int(rng.integers(1, 40))))
            child.kill()
            flushed += len(child.stdout.read())
        found, error = read_all(folder)
        assert isinstance(error, BagTruncated)
        assert error.recovered == len(found)
        complete = len(found) // PER_STEP
        assert flushed <= complete <= flushed + 1, trial
        assert [stamp for _, stamp, _ in found] == [n // PER_STEP for n in range(len(found))]
        assert not read_info(folder).complete


def test_given_a_full_disk_when_recording_then_the_first_error_stays_and_the_file_is_sound(
    tmp_path: Path,
) -> None:
    with start_child(RECORD_UNTIL_FULL, tmp_path / 'run') as child:
        output, _ = child.communicate()
    flushed, errors, kinds, number, name = output.decode().split()
    assert (errors, kinds, int(number), name) == ('6', '1', errno.EFBIG, 'run_0.mcap')
    found, error = read_all(tmp_path / 'run')
    assert isinstance(error, BagTruncated)
    assert int(flushed) == 3
    assert len(found) >= int(flushed) * PER_STEP
    size = (tmp_path / 'run' / 'run_0.mcap').stat().st_size
    assert f'at byte {size}: the end' in str(error), 'no half record is left behind'
    assert not (tmp_path / 'run' / 'metadata.yaml').exists()


def test_given_a_file_that_changes_on_the_disk_when_closed_then_it_is_not_declared_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def spoil(output: Output) -> None:
        data = bytearray(output.path.read_bytes())
        data[-100] ^= 1
        output.path.write_bytes(data)

    monkeypatch.setattr(Output, 'sync', spoil)
    with pytest.raises(BagCorrupt, match='summary contradicts its checksum'):
        write_bag(tmp_path / 'run', samples(1))
    assert not (tmp_path / 'run' / 'metadata.yaml').exists()


def test_given_an_unwritable_place_when_opened_then_a_typed_error_names_it(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagWriteError, match=r'file/run: cannot write: \[Errno \d+\]'):
        write_bag(tmp_path / 'file' / 'run', [])
    with pytest.raises(BagWriteError, match=r'nowhere/x: cannot write: \[Errno 2\]') as caught:
        Output(tmp_path / 'nowhere' / 'x')
    copy = pickle.loads(pickle.dumps(caught.value))
    assert (str(copy), copy.errno, copy.path) == (
        str(caught.value), errno.ENOENT, tmp_path / 'nowhere' / 'x'
    )


def test_given_a_file_cut_anywhere_when_read_then_all_before_the_cut_comes(
    whole: bytes, damaged: Callable[[bytes], Path]
) -> None:
    expected = samples(STEPS)
    sizes = sorted({int(n) for n in np.linspace(0, len(whole) - 1, 250)} | {1, 7, 8, 9})
    counts = []
    for size in sizes:
        found, error = read_all(damaged(whole[:size]))
        assert isinstance(error, BagEmpty if size == 0 else BagTruncated), size
        assert found == expected[:len(found)]
        assert error.recovered == len(found)
        counts.append(len(found))
    assert counts == sorted(counts)
    assert counts[-1] == len(expected)
    assert len(set(counts)) > STEPS


def test_given_a_flipped_bit_when_read_then_it_is_noticed_and_no_message_is_wrong(
    whole: bytes, damaged: Callable[[bytes], Path]
) -> None:
    expected = samples(STEPS)
    rng = np.random.default_rng(11)
    kinds = set()
    for place in rng.permutation(len(whole))[:700]:
        data = bytearray(whole)
        data[place] ^= 1 << int(rng.integers(8))
        found, error = read_all(damaged(bytes(data)))
        assert isinstance(error, BagCorrupt | BagTruncated | BagForeign), place
        assert error.recovered == len(found)
        remaining = iter(expected)
        assert all(message in remaining for message in found), place
        assert not _complete(damaged(bytes(data)))
        kinds.add(type(error))
    assert {BagCorrupt, BagTruncated} <= kinds


def _complete(path: Path) -> bool:
    try:
        return read_info(path).complete
    except BagError:
        return False


def test_given_garbage_inserted_when_read_then_only_typed_errors_come(
    whole: bytes, damaged: Callable[[bytes], Path]
) -> None:
    rng = np.random.default_rng(12)
    for _ in range(150):
        data = bytearray(whole)
        start, length = int(rng.integers(len(data))), int(rng.integers(1, 60))
        data[start:start + int(rng.integers(60))] = rng.bytes(length)
        _, error = read_all(damaged(bytes(data)))
        assert isinstance(error, BagError)


@pytest.mark.parametrize(('content', 'kind', 'reason'), [
    (b'', BagEmpty, 'has no bytes'),
    (b'SQLite format 3\0', BagForeign, 'not an MCAP file'),
    (MAGIC[:5], BagTruncated, 'within its first bytes'),
    (MAGIC + encode(Header('ros1', 'x')), BagForeign, "profile 'ros1'"),
])
def test_given_no_ros2_mcap_when_read_then_the_error_says_what_it_is(
    damaged: Callable[[bytes], Path], content: bytes, kind: type[BagError], reason: str
) -> None:
    with pytest.raises(kind, match=reason):
        list(read_messages(damaged(content)))


def test_given_no_bag_when_read_then_the_error_says_what_is_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match='no such bag'):
        list(read_messages(tmp_path / 'nothing'))
    with pytest.raises(BagEmpty, match=r'holds no \.mcap'):
        read_info(tmp_path)
    (tmp_path / 'run_0.db3').touch()
    with pytest.raises(BagForeign, match='ros2 bag convert'):
        read_info(tmp_path)


@pytest.mark.parametrize('declared', [600 * 2**20, 2**63])
def test_given_a_chunk_that_declares_too_much_when_read_then_it_is_not_opened(
    damaged: Callable[[bytes], Path], declared: int
) -> None:
    path = damaged(_file_with(_chunk(zstandard.compress(bytes(2**20)), declared, 'zstd')))
    with pytest.raises(BagCorrupt, match=f'declares {declared} bytes'):
        list(read_messages(path))


@pytest.mark.parametrize(('data', 'declared', 'compression', 'reason'), [
    (zstandard.compress(bytes(2**20)), 100, 'zstd', 'its zstd frame 1048576'),
    (b'nonsense', 100, 'zstd', 'cannot be decompressed'),
    (b'nonsense', 100, 'lz4', 'cannot be decompressed'),
    (b'nonsense', 100, 'rar', "unknown compression 'rar'"),
    (b'nonsense', 100, '', 'holds 8'),
    (b'nonsense', 8, '', 'checksum'),
])
def test_given_a_chunk_that_contradicts_itself_when_read_then_corrupt(
    damaged: Callable[[bytes], Path], data: bytes, declared: int, compression: str, reason: str
) -> None:
    with pytest.raises(BagCorrupt, match=reason):
        list(read_messages(damaged(_file_with(_chunk(data, declared, compression)))))


@pytest.mark.parametrize('compression', ['', 'zstd', 'lz4'])
def test_given_each_compression_when_read_then_messages_come(
    damaged: Callable[[bytes], Path], compression: str
) -> None:
    import lz4.frame

    raw = _declarations() + encode(Message(1, 5, b'abcd', 5, 0))
    packed = {'': bytes, 'zstd': zstandard.compress, 'lz4': lz4.frame.compress}[compression](raw)
    chunk = Chunk(
        compression=compression, data=packed, message_start_time=5, message_end_time=5,
        uncompressed_crc=zlib.crc32(raw), uncompressed_size=len(raw),
    )
    found, error = drain(read_messages(
        damaged(MAGIC + encode(Header('ros2', 'x')) + encode(chunk))
    ))
    assert found == [('/t', 'a/msg/B', 5, b'abcd')]
    assert isinstance(error, BagTruncated)
    assert '1 sound messages before' in str(error)


def test_given_messages_of_another_encoding_when_read_then_refused_only_if_wanted(
    damaged: Callable[[bytes], Path],
) -> None:
    schema = Schema(id=1, name='a/msg/B', encoding='jsonschema', data=b'{}')
    channel = Channel(id=1, topic='/j', message_encoding='json', metadata={}, schema_id=1)
    message = Message(1, 5, b'{}', 5, 0)
    path = damaged(
        MAGIC + b''.join(map(encode, [Header('ros2', 'x'), schema, channel, message]))
    )
    with pytest.raises(BagForeign, match="topic /j: messages are 'json', not cdr"):
        list(read_messages(path))
    with pytest.raises(BagTruncated):
        list(read_messages(path, ['/other']))


def _declarations() -> bytes:
    schema = Schema(id=1, name='a/msg/B', encoding='ros2msg', data=b'uint8 x')
    channel = Channel(id=1, topic='/t', message_encoding='cdr', metadata={}, schema_id=1)
    return encode(schema) + encode(channel)


def _chunk(data: bytes, declared: int, compression: str) -> Chunk:
    return Chunk(
        compression=compression, data=data, message_start_time=0, message_end_time=0,
        uncompressed_crc=1, uncompressed_size=declared,
    )


def _file_with(record: Any) -> bytes:
    return MAGIC + encode(Header('ros2', 'x')) + _declarations() + encode(record)


def _chunks(data: bytes) -> list[tuple[int, int]]:
    """First and last byte of every chunk."""
    places, offset = [], len(MAGIC)
    while data[offset] != 15:
        end = offset + 9 + int.from_bytes(data[offset + 1:offset + 9], 'little')
        if data[offset] == 6:
            places.append((offset, end))
        offset = end
    return places


def test_given_each_chunk_damaged_when_recovered_then_only_its_messages_are_lost(
    whole: bytes, damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    expected = samples(STEPS)
    chunks = _chunks(whole)
    assert len(chunks) == STEPS
    for number, (_, end) in enumerate(chunks):
        data = bytearray(whole)
        data[end - 6] ^= 0x10
        outcome = recover(damaged(bytes(data)), tmp_path / f'saved{number}')
        saved, error = read_all(tmp_path / f'saved{number}')
        assert error is None
        lost = [m for m in expected if m not in saved]
        assert saved == [m for m in expected if m not in lost]
        assert PER_STEP <= len(lost) <= PER_STEP + 1
        assert len(outcome.damage) == 1
        assert read_info(outcome.bag.folder).complete
        assert read_attachment(outcome.bag.folder, 'scenario.scenic')
        assert read_info(outcome.bag.folder).metadata['taxinet'] == bag_samples.METADATA


def test_given_an_unfinished_bag_when_recovered_then_it_is_whole(
    whole: bytes, damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    (_, end) = _chunks(whole)[-1]
    outcome = recover(damaged(whole[:end]), tmp_path / 'saved' / 'run')
    assert read_all(tmp_path / 'saved' / 'run') == (samples(STEPS), None)
    assert outcome.bag.message_counts == read_info(damaged(whole)).counts
    assert 'the end of the file is missing' in outcome.damage[0]


def test_given_a_damaged_topic_at_the_top_when_recovered_then_the_copy_in_the_chunk_counts(
    whole: bytes, damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    data = bytearray(whole)
    data[data.index(b'/taxi_command') + 1] = ord('x')
    with pytest.raises(BagCorrupt, match='told in two ways; 0 sound messages'):
        list(read_messages(damaged(bytes(data))))
    recover(damaged(bytes(data)), tmp_path / 'saved')
    assert read_all(tmp_path / 'saved') == (samples(STEPS), None)


def test_given_nothing_sound_when_recovered_then_refused_and_no_folder_made(
    whole: bytes, damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    with pytest.raises(BagEmpty, match='nothing can be saved'):
        recover(damaged(whole[:20]), tmp_path / 'saved')
    assert not (tmp_path / 'saved').exists()


@pytest.mark.parametrize(('text', 'reason'), [
    ('', 'not a bag description'),
    ('[', 'not a bag description'),
    ('rosbag2_bagfile_information: {message_count: 5}', 'declares 5 messages, the bag holds 19'),
])
def test_given_a_description_that_is_wrong_when_read_then_the_bag_is_not_complete(
    tmp_path: Path, text: str, reason: str
) -> None:
    folder = write_bag(tmp_path / 'run', samples(STEPS)).parent
    (folder / 'metadata.yaml').write_text(text)
    info = read_info(folder)
    assert not info.complete
    assert reason in info.trouble
    assert len(list(read_messages(folder))) == 19


def test_given_a_split_bag_when_read_then_files_come_in_the_order_of_their_numbers(
    tmp_path: Path,
) -> None:
    parts = [write_bag(tmp_path / str(k) / 'run', samples(k + 1)[-3:]) for k in range(11)]
    (tmp_path / 'bag').mkdir()
    for number, part in enumerate(parts):
        part.rename(tmp_path / 'bag' / f'run_{number}.mcap')
    stamps = [m.stamp_ns for m in read_messages(tmp_path / 'bag')]
    assert len(stamps) == 33
    assert stamps == sorted(stamps)


def test_given_a_reader_that_stops_early_when_scanning_then_the_file_is_closed(
    whole: bytes, damaged: Callable[[bytes], Path]
) -> None:
    records = scan(damaged(whole))
    assert isinstance(next(records), Header)
    records.close()
