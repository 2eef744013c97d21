"""Read an MCAP file sequentially, and resume after damage.

Neither index nor footer is needed, so a file whose writer was killed can be read up to the last
flush. After damage, the next intact record is located by its structure and checksum; chunks are
also located by the summary's index, if it is valid, and by the first bytes of their compressed
data.
"""

from __future__ import annotations

import hashlib
import mmap
import re
import struct
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, TypeVar

import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Header, McapRecord, Message, Schema

from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.storage.records import (
    HEAD,
    MAGIC,
    MAX_RECORD_BYTES,
    ReadBudget,
    check_message_index,
    chunk_records,
    open_chunk,
    parse_record,
)
from taxinet_ros.bag.storage.summary import Summary, check_summary, sound_summary

OnDamage = Callable[[BagError], None]
_Declaration = TypeVar('_Declaration', Schema, Channel)

PROFILE = 'ros2'

_SMALL_BYTES = 1 << 18

_NOT_IN_DATA = frozenset({
    0, Opcode.FOOTER, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.STATISTICS,
    Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET,
})
_DATA_END_BYTES, _LENGTH_BYTES = 4, 4
_LAST_KNOWN = max(Opcode)

_RECORD_HEAD = re.compile(b'[\x03\x04\x06\x07\x09\x0c\x0f][\x00-\xff]{4}\x00{4}')
"""Start of records in the data section: opcode, and a length below 4 GiB."""

_CHUNK_HEAD = struct.Struct('<BQQQQI')
"""Start of a chunk: opcode, length, first and last stamp, uncompressed size and checksum."""

_SALVAGED = frozenset({
    Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE_INDEX, Opcode.METADATA,
})
_LARGEST_OTHER = 1 << 24
"""Maximum size of these records when searching after damage."""

_PACKED = re.compile(rb'\x28\xb5\x2f\xfd|\x04\x22\x4d\x18')
"""First bytes of a zstd frame or an lz4 frame."""

_PACKING = {0x28: 'zstd', 0x04: 'lz4'}

_VAIN_BYTES = 1 << 30
"""Limit of bytes unpacked without success per file, as protection against malicious files."""


def scan(path: Path, on_damage: OnDamage | None = None) -> Iterator[McapRecord]:
    """Yield schemas, channels, messages, attachments and metadata in the order of the file.

    Chunks are opened, checked as a whole, and yielded only if intact. A channel always precedes its
    messages, and a schema its channels.

    Schemas and channels outside the chunks have no checksum. They are held back until the first
    chunk, and if a copy with a checksum differs, in a chunk or in the summary, that one is yielded.

    Args:
        path: an ``.mcap`` file.
        on_damage: called for damage, after which the scan resumes at the next intact record; None:
            damage is raised.

    Raises:
        BagTruncated, BagCorrupt: damage, without ``on_damage``; all records before it were yielded.
        BagEmpty: the file is empty.
        BagForeign: not a ROS 2 MCAP file.
        BagError: the file cannot be read.
    """
    try:
        with path.open('rb') as stream:
            yield from _Scanner(stream, path, on_damage).records()
    except OSError as error:
        raise BagError(f'{path}: cannot read: {error.strerror}', path=path) from error


def unchecked(path: Path) -> str:
    """One line about messages without a checksum, in which damage cannot be detected; or ''.

    Args:
        path: an ``.mcap`` file; read up to the first invalid record.
    """
    bare = chunks = loose = 0
    try:
        with path.open('rb') as stream:
            size, offset = path.stat().st_size, len(MAGIC)
            while offset + _CHUNK_HEAD.size <= size:
                stream.seek(offset)
                head = stream.read(_CHUNK_HEAD.size)
                opcode, length = HEAD.unpack_from(head)
                if opcode == Opcode.DATA_END:
                    if length == _DATA_END_BYTES and any(head[HEAD.size:HEAD.size + length]):
                        return ''
                    break
                if opcode == Opcode.CHUNK:
                    chunks += 1
                    bare += not _CHUNK_HEAD.unpack(head)[-1]
                loose += opcode == Opcode.MESSAGE
                offset += HEAD.size + length
    except OSError as error:
        raise BagError(f'{path}: cannot read: {error.strerror}', path=path) from error
    if not bare and not loose:
        return ''
    what = f'{bare} of {chunks} chunks carry' if bare else f'{loose} messages outside chunks have'
    return f'{path.name}: {what} no checksum, so that damage in them cannot be detected'


class _Scanner:
    """State of one pass over a file."""

    def __init__(self, stream: BinaryIO, path: Path, on_damage: OnDamage | None) -> None:
        self._stream = stream
        self._path = path
        self._on_damage = on_damage
        self._size = path.stat().st_size
        self.work = ReadBudget(self._size)
        self._offset = 0
        self._crc = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._sealed: dict[tuple[type, int], Schema | Channel] = {}
        self._held: dict[tuple[type, int], None] = {}
        self._contradicted: set[tuple[type, int]] = set()
        self._messages = 0
        self.chunks = 0
        self._places: dict[bytes, int] = {}
        self._repeats: set[int] = set()
        self._undeclared = 0
        self._damaged = False

    def records(self) -> Iterator[McapRecord]:
        """Yield the records of the file."""
        begun = self._is_mcap()
        if self._on_damage is None:
            yield from self._in_sequence()
            return
        with mmap.mmap(self._stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            summary = sound_summary(data)
            for record in summary.declarations if summary else ():
                self._sealed[type(record), record.id] = record
            damaged_at = (yield from self._in_sequence()) if begun else 0
            if damaged_at is None:
                return
            yield from _Salvage(self, data, summary).records(damaged_at)
        yield from self._released()
        if self._undeclared:
            text = f'{self._undeclared} messages of topics whose definition is lost'
            self.damage(BagCorrupt(text), self._size)
        if not begun and not self.chunks and self._size > len(MAGIC):
            raise BagForeign(f'{self._path}: not an MCAP file', path=self._path)

    def _in_sequence(self) -> Generator[McapRecord, None, int | None]:
        """Yield the records up to the first damage; its offset is returned, None at the end."""
        while True:
            offset, crc = self._offset, self._crc
            try:
                opcode, body = self._next()
                if opcode == Opcode.DATA_END and len(body) == _DATA_END_BYTES:
                    break
                records = self.accept(opcode, body, offset)
            except BagError as error:
                self.damage(error, offset)
                return offset
            yield from self.counted(records)
        yield from self._released()
        self._finish(body, offset, crc)
        return None

    def _is_mcap(self) -> bool:
        """Whether the file starts with MCAP's magic bytes."""
        if self._size == 0:
            raise BagEmpty(f'{self._path}: has no bytes', path=self._path)
        magic = self._read(min(len(MAGIC), self._size))
        if magic == MAGIC:
            return True
        if MAGIC.startswith(magic):
            self.damage(BagTruncated('file ends within its first bytes'), 0)
        elif self._on_damage is None:
            raise BagForeign(f'{self._path}: not an MCAP file', path=self._path)
        else:
            self.damage(BagCorrupt('the first bytes are not those of an MCAP file'), 0)
        return False

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

    def accept(self, opcode: int, body: bytes, offset: int) -> Iterable[McapRecord]:
        """Records in the top-level record at ``offset``, checked against earlier ones."""
        if opcode in _NOT_IN_DATA:
            raise BagCorrupt(f'record of kind {opcode} within the data')
        if opcode == Opcode.MESSAGE_INDEX:
            check_message_index(body)
            return ()
        if opcode > _LAST_KNOWN and _PACKED.search(body[:_CHUNK_HEAD.size + 16]):
            raise BagCorrupt(f'record of kind {opcode}, with what a chunk holds')
        record = parse_record(opcode, body)
        if isinstance(record, Chunk):
            return self.within(record, offset)
        if isinstance(record, Message) and self.chunks:
            raise BagCorrupt('message outside the chunks')
        if record is None:
            return ()
        if isinstance(record, Header):
            self._check_profile(record.profile, body)
        self.check(record)
        if isinstance(record, Schema | Channel):
            self._held[type(record), record.id] = None
            return ()
        return (record,)

    def _check_profile(self, profile: str, body: bytes) -> None:
        if profile == PROFILE:
            return
        # With a damaged length, the profile ends elsewhere than its letters do.
        if body[_LENGTH_BYTES:].startswith(PROFILE.encode()):
            raise BagCorrupt(f'the length of the profile {PROFILE!r} is damaged')
        if _bits_apart(profile, PROFILE) == 1:
            raise BagCorrupt(f'profile {profile!r} is one bit from {PROFILE!r}')
        raise BagForeign(f'{self._path}: MCAP of profile {profile!r}, not ros2', path=self._path)

    def within(self, chunk: Chunk, offset: int) -> Iterable[McapRecord]:
        """Records of a chunk; none if it repeats an earlier one."""
        raw, sealed = open_chunk(chunk, self.work), bool(chunk.uncompressed_crc)
        # A chunk with any error is rejected completely. The messages of a large chunk may take many
        # times its size in memory, so it is parsed twice instead.
        small = len(raw) <= _SMALL_BYTES
        records = chunk_records(raw, self.work)
        inner = tuple(records) if small else records
        count = 0
        for one in inner:
            self.check(one, sealed=sealed)
            count += isinstance(one, Message)
        self.chunks += 1
        # Recorders never write equal messages, stamps and numbers twice; a faulty disk may.
        first = self._places.setdefault(hashlib.sha256(raw).digest(), offset)
        if first != offset and count:
            if offset not in self._repeats:
                self._repeats.add(offset)
                text = f'the chunk at byte {first} is repeated, {count} messages; left out'
                self.damage(BagCorrupt(text), offset)
            return ()
        return inner if small else chunk_records(raw, ReadBudget(len(raw)))

    def counted(self, records: Iterable[McapRecord]) -> Iterator[McapRecord]:
        """Yield accepted records, after the declarations that were held back until here."""
        for record in records:
            if self._held and isinstance(record, Message | Schema | Channel):
                yield from self._released()
            if isinstance(record, Message):
                if record.channel_id not in self._channels:
                    self._undeclared += 1
                    continue
                self._messages += 1
            elif isinstance(record, Schema):
                record = self._schemas[record.id]
            elif isinstance(record, Channel):
                record = self._channels[record.id]
            yield record

    def _released(self) -> Iterator[McapRecord]:
        """Yield the declarations held back, each in the copy that is to be believed."""
        held, self._held = self._held, {}
        for kind, number in held:
            yield self._schemas[number] if kind is Schema else self._channels[number]

    def check(self, record: McapRecord, *, sealed: bool = False) -> None:
        """Check a record against earlier ones, and note what it declares.

        Args:
            record: the record.
            sealed: whether a checksum covers it.
        """
        if isinstance(record, Schema):
            self._declare(self._schemas, record, record.name, sealed=sealed)
        elif isinstance(record, Channel):
            self._declare(self._channels, record, record.topic, sealed=sealed)
        elif isinstance(record, Message) and record.channel_id not in self._channels:
            if self._damaged:  # Only the definition may be lost; keep the rest of the chunk.
                return
            raise BagCorrupt(f'message on unknown channel {record.channel_id}')

    def _declare(
        self, known: dict[int, _Declaration], record: _Declaration, name: str, *, sealed: bool
    ) -> None:
        """Note a schema or channel; if copies differ, one that a checksum covers is believed."""
        place = type(record), record.id
        believed = record
        if sealed:
            self._sealed[place] = record
        elif isinstance(copy := self._sealed.get(place), type(record)):
            believed = copy
        schema = believed.schema_id if isinstance(believed, Channel) else None
        if schema is not None and schema not in self._schemas:
            raise BagCorrupt(f'channel {name} names unknown schema {schema}')
        differs = record != believed or known.get(record.id, believed) != believed
        if differs and place not in self._contradicted:
            self._contradicted.add(place)
            text = f'{type(record).__name__.lower()} {record.id} ({name})'
            self.damage(BagCorrupt(f'{text} has two different definitions'), self._offset)
        known[record.id] = believed

    def _finish(self, body: bytes, offset: int, crc: int) -> None:
        """Check the data against the end of the file."""
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
            if not self._damaged:  # Known damage explains an invalid checksum.
                self.damage(error, offset)

    def damage(self, error: BagError, offset: int) -> None:
        if isinstance(error, BagForeign | BagEmpty):
            raise error
        self._damaged = True
        placed = type(error)(
            f'{self._path}: at byte {offset}: {error}', path=self._path, offset=offset
        )
        if self._on_damage is None:
            raise placed
        self._on_damage(placed)


class _Salvage:
    """Finds intact records after the first damage of a file."""

    def __init__(self, scanner: _Scanner, data: mmap.mmap, summary: Summary | None) -> None:
        self._scanner = scanner
        self._data = data
        self._summary = summary
        self._end = self._summary.start if self._summary else len(data)
        self._vain_bytes = _VAIN_BYTES

    def records(self, offset: int) -> Iterator[McapRecord]:
        """Yield all intact records after the damaged one at ``offset``."""
        for record in self._summary.declarations if self._summary else ():
            with suppress(BagCorrupt):
                self._scanner.check(record, sealed=True)
                yield record
        while offset < self._end:
            sound = self._next_sound(offset + 1)
            yield from self._scanner.counted(self._damaged_chunks(offset, sound))
            while sound < self._end and (found := self._sound(sound)) is not None:
                records, end = found
                yield from self._scanner.counted(records)
                if self._data[sound] == Opcode.DATA_END:
                    return
                sound = end
            if sound >= self._end and self._summary is None:
                self._scanner.damage(BagTruncated('the end of the file is missing'), sound)
            elif sound < self._end:
                self._scanner.damage(BagCorrupt('no intact record'), sound)
            offset = sound

    def _next_sound(self, start: int) -> int:
        """Offset of the next intact record, or the end of the data."""
        for match in _RECORD_HEAD.finditer(self._data, start, self._end):
            if self._sound(match.start()) is not None:
                return match.start()
        return self._end

    def _sound(self, offset: int) -> tuple[Iterable[McapRecord], int] | None:
        """Content and end of the record at ``offset``; None if it is damaged."""
        if offset + HEAD.size > self._end:
            return None
        opcode, length = HEAD.unpack_from(self._data, offset)
        begin = offset + HEAD.size
        end = begin + length
        if end > self._end or not _plausible(self._data, offset, opcode, length):
            return None
        if opcode == Opcode.CHUNK and self._vain_bytes <= 0:
            return None
        try:
            return self._scanner.accept(opcode, self._data[begin:end], offset), end
        except BagForeign:
            raise
        except BagError:
            if opcode == Opcode.CHUNK:
                (size,) = struct.unpack_from('<Q', self._data, begin + 16)
                self._vain_bytes -= min(size, MAX_RECORD_BYTES)
            return None

    def _damaged_chunks(self, start: int, end: int) -> Iterator[McapRecord]:
        """Records of chunks in this range whose header is damaged but whose data are intact."""
        if self._summary:
            known = [c for c in self._summary.chunks if start <= c.chunk_start_offset < end]
            found = ((index.chunk_start_offset, self._indexed(index)) for index in known)
        else:
            frames = _PACKED.finditer(self._data, start, end)
            found = ((frame.start(), self._unindexed(frame, end)) for frame in frames)
        for place, chunk in found:
            # Without a checksum the data cannot be verified.
            if chunk is None or not chunk.uncompressed_crc or self._vain_bytes <= 0:
                continue
            try:
                records = self._scanner.within(chunk, place)
            except BagForeign:
                raise
            except BagError:
                self._vain_bytes -= min(chunk.uncompressed_size, MAX_RECORD_BYTES)
                continue
            yield from records

    def _indexed(self, index: ChunkIndex) -> Chunk | None:
        """Chunk reconstructed from the summary's index."""
        end = index.chunk_start_offset + index.chunk_length
        least = _CHUNK_HEAD.size + index.compressed_size
        if end > self._end or index.compressed_size == 0 or index.chunk_length < least:
            return None
        *_, crc = _CHUNK_HEAD.unpack_from(self._data, index.chunk_start_offset)
        return Chunk(
            compression=index.compression, data=self._data[end - index.compressed_size:end],
            message_start_time=index.message_start_time, message_end_time=index.message_end_time,
            uncompressed_crc=crc, uncompressed_size=index.uncompressed_size,
        )

    def _unindexed(self, frame: re.Match[bytes], end: int) -> Chunk | None:
        """Chunk reconstructed from its compressed frame and the checksum before it."""
        packing = _PACKING[frame.group()[0]]
        start = frame.start()
        head = start - len(packing) - 12 - _CHUNK_HEAD.size
        if head < 0:
            return None
        *_, size, crc = _CHUNK_HEAD.unpack_from(self._data, head)
        data = self._data[start:end]
        if packing == 'zstd':  # Use the frame's size: the chunk's may be damaged.
            try:
                size = zstandard.get_frame_parameters(data).content_size
            except zstandard.ZstdError:
                return None
        return Chunk(
            compression=packing, data=data, message_start_time=0, message_end_time=0,
            uncompressed_crc=crc, uncompressed_size=size,
        )


def _plausible(data: mmap.mmap, offset: int, opcode: int, length: int) -> bool:
    """Whether a record's inner lengths match its length; checked before copying its bytes."""
    begin = offset + HEAD.size
    if opcode == Opcode.CHUNK and length >= 40:
        (name,) = struct.unpack_from('<I', data, begin + 28)
        if name > 4 or length < 40 + name:
            return False
        (size,) = struct.unpack_from('<Q', data, begin + 32 + name)
        return bool(length == 40 + name + size)
    if opcode == Opcode.ATTACHMENT:
        return 28 <= length <= MAX_RECORD_BYTES
    if opcode == Opcode.DATA_END:
        return length == _DATA_END_BYTES
    return opcode in _SALVAGED and 0 < length <= _LARGEST_OTHER


def _bits_apart(one: str, other: str) -> int:
    """Number of bits in which two words differ; all of them if their lengths differ."""
    left, right = one.encode(), other.encode()
    if len(left) != len(right):
        return 8 * max(len(left), len(right))
    return sum((a ^ b).bit_count() for a, b in zip(left, right, strict=True))
