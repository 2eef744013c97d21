"""Hundreds of mutated files: reading, checking and fixing them ends in a typed error or a result.

A third are mutated as they are, which their checksums catch; the others within a chunk without a
checksum, so that nonsense reaches definitions, descriptions and messages.
"""

from __future__ import annotations

import sys
from collections import Counter, deque
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path

import pytest
from bag_faults import chunk
from fuzz_mutations import ROUNDS, mutants
from fuzz_watch import end_of
from mcap.records import Chunk, Header
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from whole_runs import run_messages, write_run

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.reader import read_info, read_messages
from taxinet_ros.bag.rewrite.recovery import recover
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.storage.records import MAGIC, encode

pytestmark = pytest.mark.nightly


@pytest.fixture(scope='module')
def sound(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A short run without frames."""
    messages = [m for m in run_messages() if m[0] != '/camera/image_raw' and m[1] <= 200_000_000]
    return write_run(tmp_path_factory.mktemp('sound') / 'run', messages).read_bytes()


def opened(data: bytes) -> bytes:
    """What the chunks of a file hold."""
    records = StreamReader(BytesIO(data), emit_chunks=True).records
    chunks = (record for record in records if isinstance(record, Chunk))
    return b''.join(get_chunk_data_stream(chunk)[0].read(1 << 30) for chunk in chunks)


@pytest.fixture
def files(sound: bytes, tmp_path: Path) -> Callable[[int, int], Iterator[Path]]:
    """Makes mutated files, one at a time in the same place."""
    def make(seed: int, count: int) -> Iterator[Path]:
        head, path = MAGIC + encode(Header('ros2', 'x')), tmp_path / 'run_0.mcap'
        loose = mutants([opened(sound)], count // ROUNDS, seed)
        whole = mutants([sound], count // ROUNDS, seed)
        for number, (raw, data) in enumerate(zip(loose, whole, strict=True)):
            if number % 3:
                data = head + encode(chunk(raw, len(raw), '', crc=0))
            if data != sound:
                path.write_bytes(data)
                yield path
    return make


def test_given_mutated_files_when_read_then_none_passes_for_a_whole_one(
    files: Callable[[int, int], Iterator[Path]],
) -> None:
    ends = Counter[str]()
    for path in files(20, 600):
        ends[f'messages {end_of(lambda p=path: deque(read_messages(p), maxlen=0))}'] += 1
        ends[f'info {end_of(lambda p=path: read_info(p))}'] += 1
    assert ends['messages ok'] == 0
    assert min(ends['messages BagCorrupt'], ends['messages BagTruncated'], ends['info ok']) > 60


def test_given_mutated_files_when_used_then_only_typed_errors_come_and_nothing_is_imported(
    sound: bytes, files: Callable[[int, int], Iterator[Path]], tmp_path: Path
) -> None:
    uses: dict[str, Callable[[Path], object]] = {
        'facts': lambda path: open_recording(path).facts,
        'tables': lambda path: open_recording(path).tables(), 'check': check_bag,
    }
    (tmp_path / 'sound.mcap').write_bytes(sound)
    for use in uses.values():
        use(tmp_path / 'sound.mcap')
    modules, ends = set(sys.modules), Counter[str]()
    for number, path in enumerate(files(21, 60)):
        saved = tmp_path / 'saved' / str(number)
        uses['recover'] = lambda path, saved=saved: recover(path, saved)
        for name, use in uses.items():
            ends[f'{name} {end_of(lambda use=use, path=path: use(path))}'] += 1
    assert ends['tables ok'] == 0
    assert min(ends['tables BagCorrupt'], ends['check ok'], ends['recover ok']) > 5
    assert set(sys.modules) == modules
