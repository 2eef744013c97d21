"""Files that are no bags of ours, or are made to do harm: one typed error, and little memory."""

from __future__ import annotations

import resource
import signal
import time
import tracemalloc
import zlib
from collections import deque
from collections.abc import Callable
from pathlib import Path

import hostile_bags
import pytest
import zstandard
from bag_faults import chunk, declarations, file_with
from bag_samples import drain
from mcap.records import Channel, Chunk, Header, Message, Schema

from taxinet_ros.bag import limits
from taxinet_ros.bag.cdr.decode import decode, definition_hash
from taxinet_ros.bag.description import read_description
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.limits import limited_reading, read_within_limits
from taxinet_ros.bag.reader import Contents, read_contents, read_info, read_messages
from taxinet_ros.bag.run.tables import units_of
from taxinet_ros.bag.storage import records as parse
from taxinet_ros.bag.storage.records import MAGIC, encode
from taxinet_ros.bag.storage.summary import index_troubles
from taxinet_ros.bag.storage.writer import StorageFile
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import MAX_CHARS, dump_yaml, load_yaml

pytestmark = pytest.mark.nightly


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
    with pytest.raises(BagEmpty, match=r'contains no \.mcap'):
        read_info(tmp_path)
    (tmp_path / 'run_0.db3').touch()
    with pytest.raises(BagForeign, match='ros2 bag convert'):
        read_info(tmp_path)


@pytest.mark.parametrize('declared', [600 * 2**20, 2**63])
def test_given_a_chunk_that_declares_too_much_when_read_then_it_is_not_opened(
    damaged: Callable[[bytes], Path], declared: int
) -> None:
    path = damaged(file_with(chunk(zstandard.compress(bytes(2**20)), declared, 'zstd')))
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
        list(read_messages(damaged(file_with(chunk(data, declared, compression)))))


@pytest.mark.parametrize('compression', ['', 'zstd', 'lz4'])
def test_given_each_compression_when_read_then_messages_come(
    damaged: Callable[[bytes], Path], compression: str
) -> None:
    import lz4.frame

    raw = declarations() + encode(Message(1, 5, b'abcd', 5, 0))
    packed = {'': bytes, 'zstd': zstandard.compress, 'lz4': lz4.frame.compress}[compression](raw)
    opened = Chunk(
        compression=compression, data=packed, message_start_time=5, message_end_time=5,
        uncompressed_crc=zlib.crc32(raw), uncompressed_size=len(raw),
    )
    found, error = drain(read_messages(
        damaged(MAGIC + encode(Header('ros2', 'x')) + encode(opened))
    ))
    assert found == [('/t', 'a/msg/B', 5, b'abcd')]
    assert isinstance(error, BagTruncated)
    assert '1 intact messages before' in str(error)


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


def test_given_a_chunk_of_very_many_messages_when_read_then_few_are_held_at_once(
    damaged: Callable[[bytes], Path],
) -> None:
    count = 60_000
    raw = declarations() + encode(Message(1, 5, b'', 5, 0)) * count
    path = damaged(file_with(chunk(zstandard.compress(raw), len(raw), 'zstd', crc=0)))
    tracemalloc.start()
    try:
        with pytest.raises(BagTruncated) as caught:
            deque(read_messages(path), maxlen=0)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert caught.value.recovered == count
    assert most < 4 * len(raw)


SEPARATOR = '\n' + '=' * 80 + '\nMSG: '
NESTED = SEPARATOR.join(
    ['L1 a\nL1 b', *(f'x/L{n}\nL{n + 1} a\nL{n + 1} b' for n in range(1, 16)), 'x/L16\nuint8 a']
)


@pytest.mark.parametrize('definition', [
    NESTED, 'Self a', f'E[1000000000] a{SEPARATOR}x/E\n', 'string[100000000] a',
    '\n'.join(f'uint8 a{n}' for n in range(20_000)),
])
def test_given_a_definition_that_grows_without_end_when_used_then_refused(definition: str) -> None:
    topic = TopicInfo(name='/t', type='x/msg/T', qos='', definition=definition, type_hash='')
    for use in (definition_hash, lambda topic: decode(topic, b'\0\1\0\0' + bytes(64))):
        with pytest.raises(BagForeign):
            use(topic)
    assert units_of(topic) == {}


BOMB = 'a: &a [x, x]\n' + ''.join(
    f'{chr(98 + n)}: &{chr(98 + n)} [*{chr(97 + n)}, *{chr(97 + n)}]\n' for n in range(24)
)
MERGES = 'a: &a {x: 1}\n' + ''.join(
    f'{chr(98 + n)}: &{chr(98 + n)} {{<<: [*{chr(97 + n)}, *{chr(97 + n)}]}}\n' for n in range(24)
)


@pytest.mark.parametrize('text', [
    BOMB, MERGES, '[' * 5000, '!!python/object/apply:os.system [true]', '\0', 'a: 2001-99-99',
    'a: ' + '9' * 5000, 'x' * (MAX_CHARS + 1), '{[]: 1}',
])
def test_given_hostile_yaml_when_read_then_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r'not YAML|characters'):
        load_yaml(text, aliases=False)
    (tmp_path / 'metadata.yaml').write_text(text)
    with pytest.raises(BagCorrupt, match='not a bag description'):
        read_description(tmp_path)


def test_given_plain_yaml_when_written_and_read_then_it_is_the_same() -> None:
    shared = [1, 'two']
    value = {'a': shared, 'b': shared, 'c': 9223372036, 'd': ''}
    assert '&' not in dump_yaml(value)
    assert load_yaml(dump_yaml(value), aliases=False) == value
    assert load_yaml('a: &x [1]\nb: *x') == {'a': [1], 'b': [1]}


def raise_damage(contents: Contents) -> None:
    raise contents.damage[0][1]


@pytest.mark.parametrize('make', [
    hostile_bags.private, hostile_bags.channel_of_many_words, hostile_bags.metadata_of_many_words,
    hostile_bags.statistics_of_many_channels, hostile_bags.same_channel_again,
], ids=lambda make: make.__name__)
def test_f8_given_a_file_that_is_made_to_keep_its_reader_busy_then_it_is_done_in_time(
    damaged: Callable[[bytes], Path], make: Callable[[], bytes], tmp_path: Path
) -> None:
    path = damaged(make())
    assert path.stat().st_size < 30_000
    for read in (
        lambda: deque(read_messages(path), maxlen=0), lambda: index_troubles(path),
        lambda: raise_damage(read_contents(path, lambda topic: 1)),
    ):
        begun = time.process_time()
        with pytest.raises(BagCorrupt, match=r'more records than a recording|of kind \d+ within a'):
            read()
        assert time.process_time() - begun < 20.0


def test_f8_given_more_bytes_unpacked_than_a_recording_holds_then_refused(
    damaged: Callable[[bytes], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parse, 'FREE_BYTES', 1 << 20)
    chunks = [hostile_bags.packed(encode(Message(1, n, bytes(1 << 18), n, 0))) for n in range(9)]
    path = damaged(hostile_bags.whole(hostile_bags.DECLARED + b''.join(chunks), 9))
    found, error = drain(read_messages(path))
    assert 3 <= len(found) < 9
    assert 'unpack to more than a recording' in str(error)


def test_f8_given_a_dense_recording_of_ours_then_no_limit_is_near(tmp_path: Path) -> None:
    """Fifty thousand messages that differ in their stamps only."""
    topic = TopicInfo(name='/t', type='a/msg/B', qos='', definition='uint8 x', type_hash='')
    bag = StorageFile(tmp_path / 'dense.mcap', topics=[topic], library='x')
    for number in range(50_000):
        bag.add_message('/t', b'\0\1\0\0\1', number * 10_000_000, 0)
    bag.finish()
    bag.output.close()
    size = (tmp_path / 'dense.mcap').stat().st_size
    assert size > 50_000 * parse.BYTES_FOR_A_RECORD * 3, 'each takes thrice what it needs to'
    assert len(list(read_messages(tmp_path / 'dense.mcap'))) == 50_000


def test_f8_given_reading_without_end_then_it_ends_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(limits, 'FREE_S', 0.1)
    (tmp_path / 'a.mcap').write_bytes(bytes(1000))

    def swallow() -> None:
        while True:
            try:
                sum(range(1000))
            except Exception as error:  # as readers of definitions do
                raise AssertionError from error

    with pytest.raises(BagCorrupt, match=r'a\.mcap: took more than 0 s of processor time'), \
            limited_reading(tmp_path / 'a.mcap'):
        swallow()
    assert signal.getitimer(signal.ITIMER_VIRTUAL) == (0.0, 0.0)
    before = resource.getrlimit(resource.RLIMIT_AS)
    with pytest.raises(UsageError, match='took too much memory for a recording of 1000 bytes'), \
            read_within_limits(tmp_path):
        bytearray(8 << 30)
    assert resource.getrlimit(resource.RLIMIT_AS) == before
    assert capfd.readouterr() == ('', '')
