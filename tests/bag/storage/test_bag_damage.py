"""Cut, flipped and wrong files: typed errors, and all that is undamaged is found."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from bag_faults import (
    STEPS,
    chunk,
    chunks_of,
    declarations,
    file_with,
    messages_by_chunk,
    read_all,
    salvaged,
)
from bag_samples import samples, write_bag
from mcap.records import Header, Message

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.reader import read_info, read_messages
from taxinet_ros.bag.rewrite.recovery import recover
from taxinet_ros.bag.storage.records import encode
from taxinet_ros.bag.storage.scan import scan

pytestmark = pytest.mark.nightly


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


BLOCK = 4096
FLIPS, BLOCKS = 1000, 300


@pytest.fixture(scope='module')
def recorded(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A finished file of some tens of blocks and chunks."""
    folder = tmp_path_factory.mktemp('recorded') / 'run'
    return write_bag(folder, samples(40, shape=(24, 24))).read_bytes()


def unfinished(data: bytes) -> bytes:
    """The file as a killed recorder leaves it: without end of data, summary and footer."""
    return data[:chunks_of(data)[-1][1]]


@pytest.mark.parametrize('ending', [bytes, unfinished])
def test_f3_given_single_flipped_bits_then_all_undamaged_messages_are_saved(
    recorded: bytes, damaged: Callable[[bytes], Path], ending: Callable[[bytes], bytes]
) -> None:
    whole, rng = ending(recorded), np.random.default_rng(1)
    shares = []
    for _ in range(FLIPS // 2):
        data = bytearray(whole)
        place = int(rng.integers(len(data)))
        data[place] ^= 1 << int(rng.integers(8))
        shares.append(saved(damaged, recorded, bytes(data), place, place + 1))
    kept, there = np.sum(shares, axis=0)
    assert there > 100 * FLIPS
    assert kept / there >= 0.999


@pytest.mark.parametrize('ending', [bytes, unfinished])
def test_f3_given_zeroed_blocks_then_all_undamaged_messages_are_saved(
    recorded: bytes, damaged: Callable[[bytes], Path], ending: Callable[[bytes], bytes]
) -> None:
    whole, rng = ending(recorded), np.random.default_rng(2)
    shares = []
    for _ in range(BLOCKS // 2):
        data = bytearray(whole)
        start = BLOCK * int(rng.integers(len(data) // BLOCK))
        data[start:start + BLOCK] = bytes(BLOCK)
        shares.append(saved(damaged, recorded, bytes(data), start, start + BLOCK))
    kept, there = np.sum(shares, axis=0)
    assert there > 100 * BLOCKS
    assert kept / there >= 0.999


def test_f3_given_many_flipped_bits_then_the_chunks_between_are_saved(
    recorded: bytes, damaged: Callable[[bytes], Path]
) -> None:
    rng = np.random.default_rng(3)
    kept = there = 0
    for _ in range(100):
        data = bytearray(recorded)
        places = rng.integers(len(data), size=12)
        for place in places:
            data[place] ^= 1 << int(rng.integers(8))
        found, damage = salvaged(damaged(bytes(data)))
        assert damage
        assert not Counter(found) - all_messages(recorded)
        intact = Counter(
            message for start, end, messages in messages_by_chunk(recorded)
            if not any(start <= place < end for place in places) for message in messages
        )
        kept += (intact & Counter(found)).total()
        there += intact.total()
    assert kept / there >= 0.99


@pytest.mark.parametrize('field', [0, 1, 8, 25, 37, 41, 45])
def test_f3_given_a_chunk_whose_head_is_damaged_then_what_it_holds_is_saved(
    recorded: bytes, damaged: Callable[[bytes], Path], field: int
) -> None:
    start, _ = chunks_of(recorded)[16]
    for whole in (recorded, unfinished(recorded)):
        data = bytearray(whole)
        data[start + field] ^= 0x04
        found, (first, *_) = salvaged(damaged(bytes(data)))
        assert Counter(found) == all_messages(recorded)
        assert first.offset == start


def test_f3_given_a_profile_one_bit_off_then_the_bag_is_damaged_and_not_foreign(
    recorded: bytes, damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    path = damaged(recorded.replace(b'ros2', b'vos2', 1))
    assert "profile 'vos2' is one bit from 'ros2'" in read_info(path).trouble
    assert recover(path, tmp_path / 'saved').saved == len(samples(40))


def test_f3_given_zeroed_blocks_when_recovered_then_each_line_is_short(
    recorded: bytes, damaged: Callable[[bytes], Path], tmp_path: Path
) -> None:
    data = bytearray(recorded)
    for start in range(2 * BLOCK, len(data) - 4 * BLOCK, 4 * BLOCK):
        data[start:start + BLOCK] = bytes(BLOCK)
    path = damaged(bytes(data))
    outcome = recover(path, tmp_path / 'saved')
    assert outcome.saved > 100
    assert 3 < len(outcome.damage) < 20
    assert max(map(len, outcome.damage)) < len(str(path)) + 100
    assert len(read_info(path).trouble) < 5 * (len(str(path)) + 100)


def test_given_no_mcap_file_when_looked_through_then_it_is_foreign(
    damaged: Callable[[bytes], Path]
) -> None:
    rng = np.random.default_rng(4)
    for data in (b'no bag at all, ' * 5000, rng.bytes(200_000), bytes(100_000)):
        with pytest.raises(BagForeign, match='not an MCAP file'):
            salvaged(damaged(data))


def test_f8_given_a_chunk_of_zeros_or_of_countless_messages_then_it_is_refused_at_once(
    damaged: Callable[[bytes], Path]
) -> None:
    for raw, why in (
        (bytes(1 << 24), 'record of kind 0'),
        (
            declarations() + encode(Message(1, 0, b'', 0, 0)) * 1_100_000,
            'more records than a recording',
        ),
    ):
        record = chunk(zstandard.compress(raw), len(raw), 'zstd', crc=zlib.crc32(raw))
        found, damage = salvaged(damaged(file_with(record)))
        assert found == []
        assert why in str(damage[0])


def saved(
    damaged: Callable[[bytes], Path], recorded: bytes, data: bytes, start: int, stop: int
) -> tuple[int, int]:
    """Undamaged messages that are found, and that there are; what is found was recorded."""
    found, damage = salvaged(damaged(data))
    assert damage
    assert all(len(str(each)) < 300 and '\n' not in str(each) for each in damage)
    assert not Counter(found) - all_messages(recorded)
    intact = Counter(
        message for first, end, messages in messages_by_chunk(recorded)
        if stop <= first or start >= end for message in messages
    )
    return (intact & Counter(found)).total(), intact.total()


def all_messages(recorded: bytes) -> Counter[tuple[int, int, bytes]]:
    """Every message of the file, as often as it is there."""
    return Counter(m for *_, messages in messages_by_chunk(recorded) for m in messages)


@pytest.mark.parametrize('place', [5, 20])
def test_f3_attack_given_a_chunk_that_is_there_twice_then_it_is_saved_once_and_named(
    recorded: bytes, damaged: Callable[[bytes], Path], tmp_path: Path, place: int
) -> None:
    start, end = chunks_of(recorded)[place]
    behind = chunks_of(recorded)[30][1]
    for data in (recorded, unfinished(recorded)):
        path = damaged(data[:behind] + recorded[start:end] + data[behind:])
        outcome = recover(path, tmp_path / f'saved{len(data)}')
        assert outcome.saved == len(samples(40))
        (line,) = [line for line in outcome.damage if 'is repeated' in line]
        assert f'at byte {behind}: the chunk at byte {start} is repeated' in line
    # Amid other damage, too.
    broken = bytearray(recorded[:behind] + recorded[start:end] + recorded[behind:])
    broken[chunks_of(recorded)[10][1] - 6] ^= 0x10
    found, damage = salvaged(damaged(bytes(broken)))
    assert max(Counter(found).values()) == 1
    assert sum('is repeated' in str(error) for error in damage) == 1


def test_f3_attack_given_chunks_without_checksum_then_it_is_said(
    recorded: bytes, damaged: Callable[[bytes], Path]
) -> None:
    assert read_info(damaged(recorded)).unchecked == ''
    data = bytearray(unfinished(recorded))
    for start, _ in chunks_of(recorded)[:3]:
        data[start + 33:start + 37] = bytes(4)
    path = damaged(bytes(data))
    line = f'3 of {len(chunks_of(recorded))} chunks carry no checksum, so that damage in them'
    assert line in read_info(path).unchecked
    (check,) = [one for one in check_bag(path).checks if one.name == 'bytes']
    assert line in check.looked_at
    assert 'under the checksums' not in check.looked_at
