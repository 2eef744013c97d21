"""Files that are no bags of ours, or declare what cannot be: one typed error of one line."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from bag_faults import chunk, declarations, file_with
from bag_samples import drain
from mcap.records import Channel, Chunk, Header, Message, Schema

from taxinet_ros.bag.cdr.decode import decode, definition_hash
from taxinet_ros.bag.description import read_description
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.reader import read_messages, stored_messages
from taxinet_ros.bag.run.tables import units_of
from taxinet_ros.bag.storage.records import MAGIC, encode
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.files.plain_values import MAX_CHARS, dump_yaml, load_yaml

pytestmark = pytest.mark.nightly


@pytest.mark.parametrize(('content', 'kind', 'reason'), [
    (b'', BagEmpty, 'has no bytes'),
    (b'SQLite format 3\0', BagForeign, 'not an MCAP file'),
    (MAGIC[:5], BagTruncated, 'the end of the file is missing'),
    (MAGIC + encode(Header('ros1', 'x')), BagForeign, "profile 'ros1'"),
])
def test_given_no_ros2_mcap_when_read_then_the_error_says_what_it_is(
    damaged: Callable[[bytes], Path], content: bytes, kind: type[BagError], reason: str
) -> None:
    with pytest.raises(kind, match=reason):
        list(read_messages(damaged(content)))


@pytest.mark.parametrize(('data', 'declared', 'compression', 'crc', 'reason'), [
    (zstandard.compress(bytes(2**20)), 100, 'zstd', 1, 'crc validation failed in Chunk'),
    (b'nonsense', 100, 'zstd', 1, 'not a valid record: ZstdError'),
    (b'nonsense', 100, 'lz4', 1, 'not a valid record: RuntimeError'),
    (b'nonsense', 100, 'rar', 1, "unknown compression 'rar'"),
    (b'nonsense', 8, '', 1, 'crc validation failed in Chunk'),
    (b'nonsense', 100, '', 0, 'declares 100 bytes but holds 8'),
    *((zstandard.compress(bytes(2**20)), size, 'zstd', 1, f'declares {size} bytes, more than')
      for size in (600 * 2**20, 2**63)),
])
def test_given_a_chunk_that_contradicts_itself_when_read_then_corrupt(
    damaged: Callable[[bytes], Path], data: bytes, declared: int, compression: str, crc: int,
    reason: str,
) -> None:
    with pytest.raises(BagCorrupt, match=reason):
        list(read_messages(damaged(file_with(chunk(data, declared, compression, crc)))))


@pytest.mark.parametrize('length', [2**28 + 1, 2**40, 2**64 - 1])
def test_given_a_record_that_declares_too_much_when_read_then_it_is_not_read(
    tmp_path: Path, length: int
) -> None:
    path = tmp_path / 'run_0.mcap'
    head = MAGIC + encode(Header('ros2', 'x')) + b'\x09' + length.to_bytes(8, 'little')
    with path.open('wb') as stream:
        stream.write(head)
        stream.truncate(2**28 + 200)
    why = f'declares {length}' if length < 2**40 else f'{length} bytes does not fit'
    with pytest.raises(BagError, match=why):
        list(read_messages(path))


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


def test_given_messages_of_another_encoding_when_read_then_only_decoding_is_refused(
    damaged: Callable[[bytes], Path],
) -> None:
    schema = Schema(id=1, name='a/msg/B', encoding='jsonschema', data=b'{}')
    channel = Channel(id=1, topic='/j', message_encoding='json', metadata={}, schema_id=1)
    message = Message(1, 5, b'{}', 5, 0)
    path = damaged(
        MAGIC + b''.join(map(encode, [Header('ros2', 'x'), schema, channel, message]))
    )
    (stored,), error = drain(stored_messages(path))
    assert isinstance(error, BagTruncated)
    with pytest.raises(BagForeign, match="topic /j: messages are 'json', not cdr"):
        decode(stored.topic, stored.cdr)


SEPARATOR = '\n' + '=' * 80 + '\nMSG: '
NESTED = SEPARATOR.join(
    ['L1 a\nL1 b', *(f'x/L{n}\nL{n + 1} a\nL{n + 1} b' for n in range(1, 16)), 'x/L16\nuint8 a']
)


@pytest.mark.parametrize(('type_name', 'definition'), [
    *(('x/msg/T', text) for text in (
        NESTED, 'Self a', f'E[1000000000] a{SEPARATOR}x/E\n', 'string[100000000] a',
        '\n'.join(f'uint8 a{n}' for n in range(20_000)), '', 'this is { not a definition',
        'Unknown inner', 'uint8 x\n' + '#' * 2**20, 'uint8 __init__\nuint8 x"]',
    )),
    ('evil/msg/X\nimport os', 'uint8 x'),
])
def test_given_a_hostile_definition_when_used_then_refused(
    type_name: str, definition: str
) -> None:
    topic = TopicInfo(name='/t', type=type_name, qos='', definition=definition, type_hash='')
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
