"""Content of a campaign's record: facts, runs, and which of them have no result yet.

Single rows are made when asked for, and columns are read at once: a row is read with its checks in
some 80 µs, so that 100,000 of them would delay every command that needs a few, or the table only.
"""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.mtl.interval import lower_column, upper_column
from taxinet_ros.core.scenario_fields import BY_KEY, CATALOGUES, is_point
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, Entries, read_record, read_texts
from taxinet_ros.trials.record.facts import BEGUN, FACTS, ROW, SPARE
from taxinet_ros.trials.record.row import (
    ATTRIBUTES,
    DEFAULTS,
    LONGER,
    NEEDED,
    PLAIN_COLUMNS,
    PREFIXES,
    REAL_TIME_FACTOR,
    RunRow,
)

if TYPE_CHECKING:
    import pyarrow as pa


_AT_ONCE = 5000
"""Rows that are read together as columns; limits memory."""

Intervals = Mapping[str, Mapping[str, Sequence[float]]]
"""Ends of the intervals of formulas evaluated afterwards, by name and key of the row."""


class RecordedRows(Sequence[RunRow]):
    """The rows of a campaign, by index."""

    def __init__(self, path: Path, texts: Mapping[str, str], added: Intervals) -> None:
        """Nothing is read yet.

        Args:
            path: path of the record, for messages.
            texts: the rows as JSON (:meth:`RunRow.to_json`), by key.
            added: see :data:`Intervals`; of rows that are not there, they are ignored.
        """
        self._path = path
        self._keys, self._texts = tuple(texts), tuple(texts.values())
        self._added = added
        self._made: dict[int, RunRow] = {}

    def __len__(self) -> int:
        return len(self._texts)

    @property
    def indices(self) -> Iterator[int]:
        """The index of each row, which its key is."""
        return map(int, self._keys)

    @overload
    def __getitem__(self, at: int) -> RunRow: ...

    @overload
    def __getitem__(self, at: slice) -> tuple[RunRow, ...]: ...

    def __getitem__(self, at: int | slice) -> RunRow | tuple[RunRow, ...]:
        """Row or rows at a position.

        Raises:
            UsageError: one is not of this version.
        """
        if isinstance(at, slice):
            return tuple(self[each] for each in range(*at.indices(len(self))))
        at = range(len(self))[at]
        if at not in self._made:
            self._made[at] = self._row(at)
        return self._made[at]

    def _row(self, at: int) -> RunRow:
        try:
            row = RunRow.from_json(json.loads(self._texts[at]))
            for name, intervals in self._added.items():
                if self._keys[at] in intervals:
                    ends = RobustnessInterval(*intervals[self._keys[at]])
                    row = row.also_judged(name, ends)
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            raise UsageError(f'{self._path}: not a row of this version ({error})') from error
        return row

    @cached_property
    def columns(self) -> pa.Table | None:
        """Columns as in :mod:`.columns`, but for known robustness, which intervals contain.

        Where an entry leaves out a value, it is null. None if the rows have something that only
        :class:`RunRow` reads or refuses.
        """
        import pyarrow as pa

        whole = self._read(list(PLAIN_COLUMNS), rest='infer')
        if whole is None:
            return None
        for name, intervals in self._added.items():
            ends = [intervals.get(key, (None, None)) for key in self._keys]
            for column, values in zip(
                (lower_column(name), upper_column(name)), zip(*ends, strict=True), strict=True
            ):
                whole = whole.append_column(column, pa.array(values, pa.float64()))
        return whole.append_column(REAL_TIME_FACTOR, _real_time_factor(whole))

    def some_columns(self, names: Sequence[str]) -> pa.Table | None:
        """Some plain ones of :attr:`columns`, read in a third of the time."""
        return self.columns if 'columns' in self.__dict__ else self._read(names, rest='ignore')

    def _read(self, names: Sequence[str], rest: str) -> pa.Table | None:
        import pyarrow as pa

        try:
            parts = [
                _columns(self._texts[at:at + _AT_ONCE], names, rest)
                for at in range(0, len(self), _AT_ONCE)
            ]
            # One chunk, as Parquet files are equal to the byte then.
            return pa.concat_tables(parts, promote_options='default').combine_chunks()
        except (pa.ArrowException, TypeError, ValueError):
            return None


class RowsByIndex(Mapping[int, RunRow]):
    """Some rows of a campaign by index, made when asked for."""

    def __init__(self, rows: Sequence[RunRow], positions: Mapping[int, int]) -> None:
        """The rows at some positions, by index."""
        self._rows, self._positions = rows, positions

    def __getitem__(self, index: int) -> RunRow:
        return self._rows[self._positions[index]]

    def __iter__(self) -> Iterator[int]:
        return iter(self._positions)

    def __len__(self) -> int:
        return len(self._positions)


def values_of(rows: Sequence[RunRow], *names: str) -> Iterator[tuple[Any, ...]]:
    """Some attributes of each row: plain values and the outcome."""
    longer = [LONGER.get(name, name) for name in names]
    columns = rows.some_columns(longer) if isinstance(rows, RecordedRows) else None
    if columns is None:
        yield from (tuple(getattr(row, name) for name in names) for row in rows)
        return
    words = {outcome.value: outcome for outcome in Outcome}
    found = []
    for name in longer:
        values = with_defaults(columns, name).to_pylist()
        found.append(map(words.__getitem__, values) if name == 'outcome' else values)
    yield from zip(*found, strict=True)


def with_defaults(columns: pa.Table, name: str) -> pa.ChunkedArray:
    """A column with what rows have that say nothing of it; null where that is nothing."""
    column = columns[name]
    default = DEFAULTS.get(ATTRIBUTES.get(name, name))
    return column if default is None else column.fill_null(default)


def _real_time_factor(columns: pa.Table) -> pa.ChunkedArray:
    """As :attr:`RunRow.real_time_factor`."""
    import pyarrow.compute as pc

    sim_s, wall_s = (with_defaults(columns, name) for name in ('sim_s', 'wall_s'))
    return pc.if_else(pc.greater(wall_s, 0.0), pc.divide(sim_s, wall_s), math.nan)


def _columns(texts: Sequence[str], names: Sequence[str], rest: str) -> pa.Table:
    """Plain columns of some rows; what else they have is ignored, or inferred, by ``rest``."""
    import pyarrow as pa
    import pyarrow.json

    types = {
        'string': pa.string(), 'float64': pa.float64(), 'int64': pa.int64(), 'Int64': pa.int64(),
        'boolean': pa.bool_(),
    }
    schema = pa.schema([
        (ATTRIBUTES.get(name, name), types[PLAIN_COLUMNS[name]]) for name in names
        if name != REAL_TIME_FACTOR
    ])
    data = '\n'.join(texts).encode()
    read = pyarrow.json.read_json(
        pa.BufferReader(data),
        # One block in one thread: new columns are then in the order of their first appearance.
        read_options=pyarrow.json.ReadOptions(use_threads=False, block_size=len(data) + 1),
        parse_options=pyarrow.json.ParseOptions(
            explicit_schema=schema, unexpected_field_behavior=rest,
        ),
    )
    for name in NEEDED:
        if name in schema.names and read[name].null_count:
            raise ValueError(f'a row has no {name}')
    found = {LONGER.get(name, name): read[name] for name in schema.names}
    for name in read.column_names[len(schema):]:
        found.update(_of_mapping(name, read[name].combine_chunks()))
    return pa.table(found)


def _of_mapping(name: str, values: Any) -> Iterator[tuple[str, Any]]:
    """Columns of an attribute that is a mapping of numbers, of control points or of intervals."""
    import pyarrow as pa
    import pyarrow.compute

    if name not in (*PREFIXES, 'robustness') or not pa.types.is_struct(values.type):
        raise ValueError(f'{name} is {values.type}')
    for part, column in zip(values.type, values.flatten(), strict=True):
        if name == 'signals' and is_point(part.name):
            words = BY_KEY[part.name].column_type == 'string'
            yield part.name, column.cast(pa.string() if words else pa.float64())
            continue
        if name in PREFIXES:
            yield PREFIXES[name] + part.name, column.cast(pa.float64())
            continue
        if pa.compute.list_value_length(column).unique().drop_null().to_pylist() not in ([2], []):
            raise ValueError(f'{name} has no intervals')
        for at, end in enumerate((lower_column, upper_column)):
            yield end(part.name), pa.compute.list_element(column, at).cast(pa.float64())


REQUIREMENT, DOCUMENT, END = 'requirement', 'document', 'end'
"""Kinds of entries: a formula evaluated afterwards, a document that is not shipped, and that the
campaign ended in good order after the last result."""

AS_TEXT = frozenset({BEGUN, ROW})
"""Kinds of which there is one a run, and that are read later (:mod:`.rows`)."""

FEW = 1000
"""Number of rows up to which all are made at once, so that what is wrong is named at once, and of
rows of an open campaign that are in memory at once."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CampaignContent:
    """Content of a campaign's record.

    Attributes:
        facts: see :mod:`.facts`; empty if not yet written.
        rows: the result of each run, by index; many are read as they are asked for.
        attempts: number of starts of each run, by index.
        added: formulas evaluated afterwards, by name; the rows contain their values.
        finished: whether the campaign ended in good order after the last result.
        documents: scenario key and reference of each document that it has in full.
    """

    facts: Mapping[str, Any] = field(default_factory=dict)
    rows: Sequence[RunRow] = ()
    attempts: Mapping[int, int] = field(default_factory=dict)
    added: Mapping[str, str] = field(default_factory=dict)
    finished: bool = False
    documents: frozenset[tuple[str, str]] = frozenset()

    @property
    def unfinished(self) -> tuple[int, ...]:
        """Indices of runs that were started and have no result, ascending."""
        return tuple(sorted(self.attempts.keys() - self.by_index.keys()))

    @property
    def by_index(self) -> Mapping[int, RunRow]:
        """The rows by index."""
        return RowsByIndex(self.rows, {index: at for at, index in enumerate(self._indices)})

    def only(self, wanted: Set[int]) -> Mapping[int, RunRow]:
        """The rows of some indices, by index."""
        return RowsByIndex(self.rows, {
            index: at for at, index in enumerate(self._indices) if index in wanted
        })

    @property
    def _indices(self) -> Iterable[int]:
        rows = self.rows
        return rows.indices if isinstance(rows, RecordedRows) else [row.index for row in rows]

    def values(self, *names: str) -> Iterator[tuple[Any, ...]]:
        """Some attributes of each row, by index, without making the rows if they are many."""
        return values_of(self.rows, *names)

    @property
    def begun(self) -> int:
        """Number of runs that were started or have a result, counted from run 0."""
        return 1 + max((*self.unfinished, *self._indices), default=-1)


def read_campaign(folder: Path) -> CampaignContent:
    """Read the record of a campaign, even while it is being written.

    Raises:
        UsageError: there is none, or it is damaged.
    """
    path = folder / RECORD_NAME
    return campaign_content(path, read_record(path, AS_TEXT))


def campaign_content(path: Path, entries: Entries) -> CampaignContent:
    """Content of the entries of a record.

    Args:
        path: path of the record, for messages.
        entries: the entries, with :data:`AS_TEXT`.

    Raises:
        UsageError: an entry is not one of this version.
    """
    facts = entries.get(FACTS, {}) or entries.get(SPARE, {})
    try:
        documents = frozenset(
            # Finding it makes it known, so that references in rows can be resolved.
            (key, CATALOGUES[key].find(document).reference)
            for key, document in entries.get(DOCUMENT, {}).values()
        )
        added = entries.get(REQUIREMENT, {})
        rows = RecordedRows(path, entries.get(ROW, {}), {
            name: values['intervals'] for name, values in added.items()
        })
        return CampaignContent(
            facts=next(iter(facts.values()), {}), rows=tuple(rows) if len(rows) <= FEW else rows,
            attempts={int(key): int(attempts) for key, attempts in entries.get(BEGUN, {}).items()},
            added={name: values['formula'] for name, values in added.items()},
            finished=END in entries, documents=documents,
        )
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise UsageError(f'{path}: not a record of this version ({error})') from error


def run_key(index: int) -> str:
    """Key of a run's entries; as text, keys are in the order of the indices."""
    return f'{index:09d}'


class StoredRows:
    """The rows of an open campaign in the order of their ends, most of them in its record only.

    Attributes:
        latest: the last thousand or so, as the record may be lost.
    """

    def __init__(self, path: Path, indices: Iterable[int], added: Intervals) -> None:
        """Nothing is read yet.

        Args:
            path: path of the record.
            indices: those of rows that it has.
            added: see :data:`Intervals`.
        """
        self.latest: list[RunRow] = []
        self._path, self._added = path, added
        self._indices = array('q', indices)

    def append(self, row: RunRow) -> None:
        """Add a row, which is in the record before a thousand others are added."""
        self._indices.append(row.index)
        self.latest.append(row)
        if len(self.latest) > 2 * FEW:
            del self.latest[:FEW]

    def parts(self) -> Iterator[Sequence[RunRow]]:
        """The rows in parts, of which one at a time is in memory."""
        older, latest = len(self) - len(self.latest), self.latest[:]
        for at in range(0, older, FEW):
            yield self._read(self._indices[at:min(at + FEW, older)])
        if latest:
            yield latest

    def __iter__(self) -> Iterator[RunRow]:
        for part in self.parts():
            yield from part

    def __len__(self) -> int:
        return len(self._indices)

    def _read(self, indices: Iterable[int]) -> RecordedRows:
        texts = read_texts(self._path, ROW, map(run_key, indices))
        return RecordedRows(self._path, texts, self._added)
