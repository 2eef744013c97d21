"""Cut and flipped files, wrong descriptions: typed errors, and nothing sound is lost."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_faults import STEPS, read_all
from bag_samples import samples, write_bag
from mcap.records import Header

from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.reader import read_info, read_messages
from taxinet_ros.bag.scan import scan


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
