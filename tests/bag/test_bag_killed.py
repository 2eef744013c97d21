"""Killed writers, full disks, files that change: what was flushed stays, nothing is declared."""

from __future__ import annotations

import errno
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bag_faults import PER_STEP, read_all
from bag_samples import ROOT, samples, topics, write_bag

from taxinet_ros.bag.errors import BagCorrupt, BagTruncated, BagWriteError
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.storage.writer import Output
from taxinet_ros.bag.writer import BagWriter

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


def test_given_a_recorder_killed_at_random_steps_when_read_then_at_most_one_step_is_lost(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(5)
    for trial in range(4):
        folder = tmp_path / f'run{trial}'
        with start_child(RECORD_FOR_EVER, folder, (FULL_FRAME, NO_FRAME)[trial % 2]) as child:
            assert child.stdout is not None
            flushed = len(child.stdout.read(int(rng.integers(1, 40))))
            child.kill()
            flushed += len(child.stdout.read())
        found, error = read_all(folder)
        assert isinstance(error, BagTruncated)
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


def test_given_a_disk_that_fills_up_when_recording_then_some_of_it_is_kept_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = [10_000_000_000]

    def disk(descriptor: int) -> os.statvfs_result:
        blocks = free[0] // 4096
        return os.statvfs_result((4096, 4096, blocks, blocks, blocks, 1, 1, 1, 0, 255))

    monkeypatch.setattr(os, 'fstatvfs', disk)
    topic, stamp_ns, cdr = samples(1)[0]
    bag = BagWriter(tmp_path / 'r', topics(), metadata={}, attachments={}, min_free_bytes=10**8)
    bag.write(topic, cdr, stamp_ns)
    bag.flush()
    free[0] = 10_000_000
    bag.write(topic, cdr, stamp_ns)
    with pytest.raises(BagWriteError, match='10 MB free, 10 MB of it kept so') as caught:
        bag.flush()
    assert caught.value.errno == errno.ENOSPC
    free[0] = 10_000_000_000
    with pytest.raises(BagWriteError, match='10 MB free'):
        bag.close()
    bag.abandon()
    found, error = read_all(tmp_path / 'r')
    assert (len(found), type(error)) == (1, BagTruncated)
