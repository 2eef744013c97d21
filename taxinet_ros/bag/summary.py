"""The end of an MCAP file: summary and footer, with the checksum that few readers look at."""

from __future__ import annotations

import mmap
import zlib
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics

from taxinet_ros.bag.errors import BagCorrupt, BagError, BagTruncated
from taxinet_ros.bag.parse import (
    HEAD,
    MAX_RECORD_BYTES,
    parse_index,
    parse_record,
    split_records,
)
from taxinet_ros.bag.storage import MAGIC

_FOOTER_BYTES = HEAD.size + 20
_TAIL_BYTES = _FOOTER_BYTES + len(MAGIC)


def read_statistics(path: Path) -> dict[str, int]:
    """Messages by topic name as the summary of the file at ``path`` counts them.

    Raises:
        BagTruncated: the file has no end.
        BagCorrupt: the end contradicts itself.
    """
    try:
        with path.open('rb') as stream:
            size = stream.seek(0, 2)
            stream.seek(max(0, size - _TAIL_BYTES))
            start = _footer(stream.read()).summary_start
            if not 0 < start <= size - _TAIL_BYTES or size - start > MAX_RECORD_BYTES:
                raise BagCorrupt(f'summary at byte {start} of {size}')
            stream.seek(start)
            statistics, names = check_summary(stream.read(), start)
    except OSError as error:
        raise BagError(f'{path}: cannot read: {error.strerror}', path=path) from error
    except BagError as error:
        raise type(error)(f'{path}: {error}', path=path) from error
    if statistics is None:
        raise BagCorrupt(f'{path}: no statistics in the summary', path=path)
    counts = statistics.channel_message_counts
    return {name: counts.get(channel, 0) for channel, name in names.items()}


def check_summary(tail: bytes, start: int) -> tuple[Statistics | None, dict[int, str]]:
    """Check everything behind the data section.

    Args:
        tail: the bytes from the end of the data section to the end of the file.
        start: offset of the first of them in the file.

    Returns:
        The statistics record, if there is one, and topic names by channel number.

    Raises:
        BagTruncated: the end mark is missing.
        BagCorrupt: checksum or offsets are wrong.
    """
    footer = _footer(tail[-_TAIL_BYTES:])
    summary = tail[:-_TAIL_BYTES]
    if footer.summary_start not in (start, 0) or bool(summary) != bool(footer.summary_start):
        raise BagCorrupt(f'footer places the summary at {footer.summary_start}, not at {start}')
    if footer.summary_crc and footer.summary_crc != zlib.crc32(tail[:-len(MAGIC) - 4]):
        raise BagCorrupt('summary contradicts its checksum')
    statistics: Statistics | None = None
    names: dict[int, str] = {}
    for opcode, body in split_records(summary):
        record = parse_record(opcode, body)
        if isinstance(record, Statistics):
            statistics = record
        elif isinstance(record, Channel):
            names[record.id] = record.topic
    return statistics, names


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What the summary of a file says that helps to read around damage.

    Attributes:
        start: offset at which the summary begins, where the data ends.
        declarations: schemas and channels, each schema before its channels.
        chunks: where the chunks are, in the order of the file.
    """

    start: int
    declarations: tuple[Schema | Channel, ...]
    chunks: tuple[ChunkIndex, ...]


def sound_summary(data: mmap.mmap) -> Summary | None:
    """The summary of a file, where one is that proves sound by its own checksum."""
    try:
        start = _footer(data[max(0, len(data) - _TAIL_BYTES):]).summary_start
        if not 0 < start <= len(data) - _TAIL_BYTES or len(data) - start > MAX_RECORD_BYTES:
            return None
        tail = data[start:]
        if not _footer(tail[-_TAIL_BYTES:]).summary_crc:
            return None
        check_summary(tail, start)
        records = [
            parse_record(opcode, body) or parse_index(opcode, body)
            for opcode, body in split_records(tail[:-_TAIL_BYTES])
        ]
    except BagError:
        return None
    chunks = [record for record in records if isinstance(record, ChunkIndex)]
    return Summary(
        start=start,
        declarations=(
            *(record for record in records if isinstance(record, Schema)),
            *(record for record in records if isinstance(record, Channel)),
        ),
        chunks=tuple(sorted(chunks, key=lambda chunk: chunk.chunk_start_offset)),
    )


def _footer(tail: bytes) -> Footer:
    if len(tail) < _TAIL_BYTES or tail[-len(MAGIC):] != MAGIC:
        raise BagTruncated('the end of the file is missing')
    opcode, length = HEAD.unpack_from(tail)
    body = tail[HEAD.size:-len(MAGIC)]
    footer = parse_record(opcode, body) if opcode == Opcode.FOOTER else None
    if length != len(body) or not isinstance(footer, Footer):
        raise BagCorrupt('malformed footer')
    return footer
