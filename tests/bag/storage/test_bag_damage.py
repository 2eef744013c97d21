"""Cut, flipped and zeroed files: all before the damage is read, and none passes for whole."""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_faults import STEPS, chunks_of, read_all
from bag_samples import samples, write_bag
from whole_runs import run_messages, write_run

from taxinet_ros.bag.check.judge import judge_runs
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.reader import read_info, read_messages

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
        assert size < 8 or f'; {len(found)} intact messages before' in str(error)
        counts.append(len(found))
    assert counts == sorted(counts)
    assert counts[-1] == len(expected)
    assert len(set(counts)) > STEPS


def test_given_a_flipped_bit_when_read_then_it_is_noticed_and_all_before_it_comes(
    whole: bytes, damaged: Callable[[bytes], Path]
) -> None:
    expected = samples(STEPS)
    rng = np.random.default_rng(11)
    kinds = set()
    for place in rng.permutation(len(whole))[:400]:
        data = bytearray(whole)
        data[place] ^= 1 << int(rng.integers(8))
        path = damaged(bytes(data))
        found, error = read_all(path)
        kinds.add(type(error))
        assert isinstance(error, BagCorrupt | BagTruncated | BagForeign), place
        if place >= chunks_of(whole)[0][0]:  # definitions are compared at the end of the data
            assert found == expected[:len(found)], place
            intact = [end for _, end in chunks_of(whole) if end <= place]
            assert len(found) >= len(intact) * len(expected) // len(chunks_of(whole)) - 1
        assert not _complete(path)
    assert {BagCorrupt, BagTruncated} <= kinds


def _complete(path: Path) -> bool:
    try:
        return read_info(path).complete
    except BagError:
        return False


def test_given_a_flipped_bit_anywhere_when_judged_then_no_verdict_changes_in_silence(
    tmp_path: Path,
) -> None:
    messages = [m for m in run_messages() if m[0] != '/camera/image_raw']
    whole = write_run(tmp_path / 'run', messages).read_bytes()
    (tmp_path / 'x.mcap').write_bytes(whole)
    before, = judge_runs(tmp_path / 'x.mcap')
    assert before.sound
    assert [one.verdict.judged for one in before.verdicts] == [True, True]
    rng = np.random.default_rng(6)
    summary = 0
    for place in map(int, rng.permutation(len(whole))[:250]):
        data = bytearray(whole)
        data[place] ^= 1 << int(rng.integers(8))
        (tmp_path / 'x.mcap').write_bytes(data)
        (run,) = judge_runs(tmp_path / 'x.mcap')
        assert run.trouble, place
        assert not run.sound
        assert not any(one.verdict.judged for one in run.verdicts), place
        summary += place > chunks_of(whole)[-1][1]
    assert 10 < summary < 240


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


def test_given_a_file_that_ends_in_zeros_when_read_then_all_before_them_comes(
    whole: bytes, damaged: Callable[[bytes], Path]
) -> None:
    """As a power cut leaves it."""
    _, end = chunks_of(whole)[1]
    found, error = read_all(damaged(whole[:end] + bytes(4096)))
    assert isinstance(error, BagCorrupt)
    assert f'at byte {end}: record of kind 0' in str(error)
    assert found == samples(STEPS)[:len(found)]
    assert len(found) > 10


def test_given_a_disk_that_fails_amid_a_file_when_read_then_all_before_it_comes(
    whole: bytes, damaged: Callable[[bytes], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    start, _ = chunks_of(whole)[1]
    path = damaged(whole)

    class Disk(io.BytesIO):
        def read(self, size: int | None = -1) -> bytes:
            if self.tell() >= start:
                raise OSError(errno.EIO, 'Input/output error')
            return super().read(size)

        def fileno(self) -> int:
            return descriptor

    descriptor = os.open(path, os.O_RDONLY)
    monkeypatch.setattr(Path, 'open', lambda path, mode: Disk(whole))
    found, error = read_all(path)
    os.close(descriptor)
    assert isinstance(error, BagCorrupt)
    assert f'at byte {start}: [Errno 5] Input/output error; {len(found)} intact' in str(error)
    assert 6 <= len(found) < len(samples(STEPS))
