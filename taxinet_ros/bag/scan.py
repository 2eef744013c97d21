"""Reading an MCAP file from the front, as far as it is sound.

Neither index nor footer is needed, so a file whose writer was killed reads like any other, up to
the last flush.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Header, McapRecord, Message, Schema

from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.parse import (
    HEAD,
    MAX_RECORD_BYTES,
    chunk_records,
    open_chunk,
    parse_record,
)
from taxinet_ros.bag.storage import MAGIC
from taxinet_ros.bag.summary import check_summary

OnDamage = Callable[[BagError], None]

_SMALL_BYTES = 1 << 18

_NOT_IN_DATA = frozenset({
    0, Opcode.FOOTER, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.STATISTICS,
    Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET,
})


def scan(path: Path, on_damage: OnDamage | None = None) -> Iterator[McapRecord]:
    """Yield schemas, channels, messages, attachments and metadata in the order of the file.

    Chunks are opened, checked as a whole, and yielded only if sound. A channel always comes before
    its messages, and a schema before its channels.

    Args:
        path: an ``.mcap`` file.
        on_damage: what to do with damage; default is to raise it. Where a function is given, the
            scan goes on behind the damaged record, or ends where the next one cannot be found.

    Raises:
        BagTruncated, BagCorrupt: damage, without ``on_damage``; all before it was yielded.
        BagEmpty: the file has no bytes.
        BagForeign: it is no ROS 2 MCAP file.
        BagError: the operating system cannot read it.
    """
    try:
        with path.open('rb') as stream:
            yield from _Scanner(stream, path, on_damage or _raise).records()
    except OSError as error:
        raise BagError(f'{path}: cannot read: {error.strerror}', path=path) from error


def _raise(error: BagError) -> None:
    raise error


class _Scanner:
    """State of one pass over a file."""

    def __init__(self, stream: BinaryIO, path: Path, report: OnDamage) -> None:
        self._stream = stream
        self._path = path
        self._report = report
        self._size = path.stat().st_size
        self._offset = 0
        self._crc = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._messages = 0
        self._chunks = 0
        self._damaged = False

    def records(self) -> Iterator[McapRecord]:
        """The pass itself."""
        if not self._is_mcap():
            return
        while True:
            offset, crc = self._offset, self._crc
            try:
                opcode, body = self._next()
            except BagError as error:
                self._damage(error, offset)
                return
            if opcode == Opcode.DATA_END:
                self._finish(body, offset, crc)
                return
            try:
                records = self._accept(opcode, body)
            except BagError as error:
                self._damage(error, offset)
                continue
            for record in records:
                self._messages += isinstance(record, Message)
                yield record

    def _is_mcap(self) -> bool:
        """Whether the file begins as an MCAP file does, and goes on behind that."""
        if self._size == 0:
            raise BagEmpty(f'{self._path}: has no bytes', path=self._path)
        magic = self._read(min(len(MAGIC), self._size))
        if not MAGIC.startswith(magic):
            raise BagForeign(f'{self._path}: not an MCAP file', path=self._path)
        if magic != MAGIC:
            self._damage(BagTruncated('file ends within its first bytes'), 0)
        return magic == MAGIC

    def _next(self) -> tuple[int, bytes]:
        """Opcode and body of the next record."""
        left = self._size - self._offset
        if left < HEAD.size:
            raise BagTruncated('the end of the file is missing')
        opcode, length = HEAD.unpack(self._read(HEAD.size))
        if length > left - HEAD.size:
            raise BagTruncated(f'a record of {length} bytes does not fit into the file')
        if length > MAX_RECORD_BYTES:
            raise BagCorrupt(f'a record declares {length} bytes')
        return opcode, self._read(length)

    def _read(self, length: int) -> bytes:
        data = self._stream.read(length)
        if len(data) != length:
            raise BagTruncated('the file became shorter while it was read')
        self._offset += length
        self._crc = zlib.crc32(data, self._crc)
        return data

    def _accept(self, opcode: int, body: bytes) -> Iterable[McapRecord]:
        """The records within one top-level record, checked against all before."""
        if opcode in _NOT_IN_DATA:
            raise BagCorrupt(f'record of kind {opcode} within the data')
        record = parse_record(opcode, body)
        if isinstance(record, Chunk):
            raw = open_chunk(record)
            # Of a chunk that is wrong anywhere nothing is believed. All messages of a large one at
            # once may be many times its size, so it is gone through twice.
            small = len(raw) <= _SMALL_BYTES
            inner = tuple(chunk_records(raw)) if small else chunk_records(raw)
            for one in inner:
                self._check(one)
            self._chunks += 1
            return inner if small else chunk_records(raw)
        if isinstance(record, Message) and self._chunks:
            raise BagCorrupt('message outside the chunks')
        if record is None:
            return ()
        self._check(record)
        return (record,)

    def _check(self, record: McapRecord) -> None:
        if isinstance(record, Header) and record.profile != 'ros2':
            raise BagForeign(
                f'{self._path}: MCAP of profile {record.profile!r}, not ros2', path=self._path
            )
        if isinstance(record, Schema):
            if self._schemas.get(record.id, record) != record:
                self._contradiction(f'schema {record.id} ({record.name})')
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            if record.schema_id not in self._schemas:
                raise BagCorrupt(f'channel {record.topic} names unknown schema {record.schema_id}')
            if self._channels.get(record.id, record) != record:
                self._contradiction(f'channel {record.id} ({record.topic})')
            self._channels[record.id] = record
        elif isinstance(record, Message) and record.channel_id not in self._channels:
            raise BagCorrupt(f'message on unknown channel {record.channel_id}')

    def _contradiction(self, what: str) -> None:
        # If the scan is to go on, the later copy wins: it stands under a chunk's checksum.
        self._damage(BagCorrupt(f'{what} is told in two ways'), self._offset)

    def _finish(self, body: bytes, offset: int, crc: int) -> None:
        """Check the whole against the end of the file."""
        try:
            end = parse_record(Opcode.DATA_END, body)
            start = self._offset
            if self._size - start > MAX_RECORD_BYTES:
                raise BagCorrupt(f'{self._size - start} bytes behind the data')
            statistics, _ = check_summary(self._read(self._size - start), start)
            if isinstance(end, DataEnd) and end.data_section_crc not in (0, crc):
                raise BagCorrupt('the data contradicts its checksum')
            if statistics is not None and statistics.message_count != self._messages:
                raise BagCorrupt(f'{self._messages} messages of {statistics.message_count} found')
        except BagError as error:
            if not self._damaged:  # Known damage explains a checksum that fails.
                self._damage(error, offset)

    def _damage(self, error: BagError, offset: int) -> None:
        if isinstance(error, BagForeign | BagEmpty):
            raise error
        self._damaged = True
        message = f'{self._path}: at byte {offset}: {error}'
        self._report(type(error)(message, path=self._path, offset=offset))
