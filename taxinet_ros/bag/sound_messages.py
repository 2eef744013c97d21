"""The messages of some topics out of a sound file, several times as fast as by scanning it.

For those who go through thousands of bags. Every checksum and count is held against the data all
the same; where one fails, the scan is there to say which, and what can be saved.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Schema

from taxinet_ros.bag.errors import BagCorrupt, BagError
from taxinet_ros.bag.parse import HEAD, Work, open_chunk, parse_record
from taxinet_ros.bag.reader import StoredMessage, Wanted
from taxinet_ros.bag.storage import MAGIC
from taxinet_ros.bag.summary import check_summary
from taxinet_ros.bag.topics import TopicInfo

_MESSAGE = struct.Struct('<HIQQ')


def sound_messages(path: Path, wanted: Wanted) -> Iterator[StoredMessage]:
    """Yield wanted messages of a file, in its order.

    Args:
        path: an ``.mcap`` file.
        wanted: whether the topic of this name is to be read; asked for every message, so that it
            may depend on those before.

    Yields:
        Messages, of topics without quality of service and type hash. Only once all have come are
        they known to be sound.

    Raises:
        BagCorrupt: the file is not sound through and through, or not of the kind that
            :mod:`.writer` writes.
    """
    try:
        yield from _File(path.read_bytes()).messages(wanted)
    except (OSError, BagError, struct.error, LookupError, UnicodeDecodeError) as error:
        raise BagCorrupt(f'{path}: {error}', path=path) from error


class _File:
    """One pass over a file in memory; whatever is unusual raises."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._schemas: dict[int, Schema] = {}
        self._topics: dict[int, TopicInfo] = {}
        self._count = 0
        self._work = Work(len(data))

    def messages(self, wanted: Wanted) -> Iterator[StoredMessage]:
        data, offset = self._data, len(MAGIC)
        if not data.startswith(MAGIC):
            raise BagCorrupt('not an MCAP file')
        while True:
            opcode, length = HEAD.unpack_from(data, offset)
            body = data[offset + HEAD.size:offset + HEAD.size + length]
            if opcode == Opcode.MESSAGE or len(body) != length:
                raise BagCorrupt('message outside the chunks, or a torn record')
            record = None if opcode == Opcode.MESSAGE_INDEX else parse_record(opcode, body)
            if isinstance(record, Chunk):
                yield from self._chunk_messages(open_chunk(record, self._work), wanted)
            elif isinstance(record, DataEnd):
                self._finish(record, offset, offset + HEAD.size + length)
                return
            elif isinstance(record, Schema | Channel):
                self._note(record)
            offset += HEAD.size + length

    def _chunk_messages(self, raw: bytes, wanted: Wanted) -> Iterator[StoredMessage]:
        start = 0
        while start < len(raw):
            opcode, length = HEAD.unpack_from(raw, start)
            self._work.record(opcode, length)
            start += HEAD.size
            end = start + length
            if opcode == Opcode.MESSAGE:
                channel, _, stamp_ns, _ = _MESSAGE.unpack_from(raw, start)
                topic = self._topics[channel]
                self._count += 1
                if wanted(topic.name):
                    yield StoredMessage(topic, stamp_ns, raw[start + _MESSAGE.size:end])
            else:
                self._note(parse_record(opcode, raw[start:end]))
            start = end
        if start != len(raw):
            raise BagCorrupt('records do not fill their chunk')

    def _note(self, record: object) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            schema = self._schemas[record.schema_id]
            if record.message_encoding != 'cdr' or schema.encoding != 'ros2msg':
                raise BagCorrupt(f'topic {record.topic} is encoded in another way')
            known = self._topics.get(record.id)
            self._topics[record.id] = TopicInfo(
                name=record.topic, type=schema.name, qos='', type_hash='',
                definition=schema.data.decode(),
            )
            if known not in (None, self._topics[record.id]):
                raise BagCorrupt(f'channel {record.id} is told in two ways')

    def _finish(self, end: DataEnd, offset: int, behind: int) -> None:
        statistics, _ = check_summary(self._data[behind:], behind)
        if statistics is None or statistics.message_count != self._count:
            raise BagCorrupt('messages are missing')
        if end.data_section_crc != zlib.crc32(memoryview(self._data)[:offset]):
            raise BagCorrupt('the data contradicts its checksum')
