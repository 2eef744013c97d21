"""Rows of a campaign's record: single ones are made when asked for, columns are read at once.

A row is read with its checks in some 80 µs, so that 100,000 of them would delay every command that
needs a few of them, or the table only.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.mtl.interval import lower_column, upper_column
from taxinet_ros.core.scenario_fields import BY_KEY, is_point
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.record.columns import (
    ATTRIBUTES,
    LONGER,
    PLAIN_COLUMNS,
    PREFIXES,
    REAL_TIME_FACTOR,
)
from taxinet_ros.trials.record.row import DEFAULTS, NEEDED, RunRow

if TYPE_CHECKING:  # slow import that should not delay a run
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
    """Columns of some rows; each number is the double nearest to its text, as in Python.

    Args:
        texts: the rows.
        names: plain columns.
        rest: whether to ``ignore`` or ``infer`` what else the rows have.

    Raises:
        ArrowException, ValueError: a row has something else than :meth:`RunRow.to_json` writes.
    """
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
    for field, column in zip(values.type, values.flatten(), strict=True):
        if name == 'signals' and is_point(field.name):
            words = BY_KEY[field.name].column_type == 'string'
            yield field.name, column.cast(pa.string() if words else pa.float64())
            continue
        if name in PREFIXES:
            yield PREFIXES[name] + field.name, column.cast(pa.float64())
            continue
        if pa.compute.list_value_length(column).unique().drop_null().to_pylist() not in ([2], []):
            raise ValueError(f'{name} has no intervals')
        for at, end in enumerate((lower_column, upper_column)):
            yield end(field.name), pa.compute.list_element(column, at).cast(pa.float64())
