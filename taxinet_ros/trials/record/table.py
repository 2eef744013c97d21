"""Table of a campaign as CSV and Parquet, with the columns of :mod:`.columns`."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import filterfalse, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from taxinet_ros.bag.layout import is_bag_name, is_run_name
from taxinet_ros.core.mtl.interval import lower_column, specs_with_interval, upper_column
from taxinet_ros.core.scenario_fields import SCENARIO_FIELDS
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import make_atomically, write_parquet
from taxinet_ros.trials.record.content import (
    CampaignContent,
    RecordedRows,
    StoredRows,
    read_campaign,
    with_defaults,
)
from taxinet_ros.trials.record.facts import STACKS, is_campaign, recorded_stacks
from taxinet_ros.trials.record.row import (
    ATTRIBUTES,
    PLAIN_COLUMNS,
    PREFIXES,
    RHO,
    RunRow,
    column_types,
    rho_column,
    specs_of,
)

if TYPE_CHECKING:  # slow import that should not delay a run
    import pandas as pd
    import pyarrow as pa

CSV_NAME = 'runs.csv'
PARQUET_NAME = 'runs.parquet'

_FORMULA_STARTS = ('=', '+', '-', '@', '\t', '\r')


def table(
    rows: Iterable[RunRow], specs: Sequence[str] = (), known: Sequence[str] | None = None
) -> pd.DataFrame:
    """Table with one row per run, by index.

    Args:
        rows: rows of one campaign.
        specs: names of its formulas, headline first. Each has a column ``rho_<name>``, empty if a
            run was stopped before it was known, and ``rho`` repeats the first;
            ``rho_lower.<name>`` and ``rho_upper.<name>`` are the ends of its interval, equal if it
            is known. Further formulas of the rows follow.
        known: columns that any row has, if these rows are a part of them.

    There is one column ``u_<dimension>`` for each dimension of any row's point, and one column
    ``free_<name>`` or ``sigma_<name>`` for each figure of free runs, or of claimed covariances.
    """
    import pandas as pd

    found = _found(rows)
    here = _names(found)
    known = here if known is None else known
    names = list(dict.fromkeys([*specs, *specs_with_interval(known)]))
    kinds = column_types(names, known)
    frame = {
        name: _series(found, name, kind) for name, kind in kinds.items() if name in here
    }
    for name in names:
        lower, upper = (frame.get(column(name)) for column in (lower_column, upper_column))
        if lower is not None and upper is not None:
            frame[rho_column(name)] = lower.where(lower == upper)
    if names and rho_column(names[0]) in frame:
        frame[RHO] = frame[rho_column(names[0])].copy()
    nothing = [None] * len(frame['index'])
    return pd.DataFrame({
        name: frame[name] if name in frame else pd.Series(nothing, dtype=kind)
        for name, kind in kinds.items()
    })


def _found(rows: Iterable[RunRow]) -> dict[str, list[Any]] | pa.Table:
    columns = rows.columns if isinstance(rows, RecordedRows) else None
    return _values_of_rows(rows) if columns is None else columns


def _names(found: dict[str, list[Any]] | pa.Table) -> list[str]:
    return list(found if isinstance(found, dict) else found.column_names)


def _values_of_rows(rows: Iterable[RunRow]) -> dict[str, list[Any]]:
    """Values by column, without those that :func:`table` computes from others."""
    ordered = sorted(rows, key=lambda row: row.index)
    found = {
        column: [getattr(row, ATTRIBUTES.get(column, column)) for row in ordered]
        for column in PLAIN_COLUMNS
    }
    found['outcome'] = [outcome.value for outcome in found['outcome']]
    for attribute, start in PREFIXES.items():
        mappings = [getattr(row, attribute) for row in ordered]
        for name in dict.fromkeys(name for mapping in mappings for name in mapping):
            found[start + name] = [mapping.get(name) for mapping in mappings]
    for name in dict.fromkeys(name for row in ordered for name in row.robustness):
        intervals = [row.robustness.get(name) for row in ordered]
        found[lower_column(name)] = [each and each.lower for each in intervals]
        found[upper_column(name)] = [each and each.upper for each in intervals]
    return found


def _series(found: dict[str, list[Any]] | pa.Table, name: str, kind: str) -> pd.Series[Any]:
    import pandas as pd

    if isinstance(found, dict):
        return pd.Series(found[name], dtype=kind)
    values, dtype = with_defaults(found, name), pd.api.types.pandas_dtype(kind)
    from_arrow = getattr(dtype, '__from_arrow__', None)  # of nullable types
    return pd.Series(from_arrow(values) if from_arrow else values.to_numpy())


def campaign_table(content: CampaignContent) -> pd.DataFrame:
    """Table of a campaign, with its records of machines, libraries and code in ``attrs``."""
    frame = table(content.rows, tuple(content.facts.get('specs', {})))
    frame.attrs[STACKS] = recorded_stacks(content.facts)
    return frame


def write_tables(
    rows: Iterable[RunRow], folder: Path, facts: Mapping[str, Any]
) -> None:
    """Write ``runs.csv`` and ``runs.parquet`` atomically; of stored rows in parts, to save memory.

    The Parquet file contains the campaign's records of machine, libraries and code in
    ``attrs['stacks']``; the column ``stack`` refers to them.

    Args:
        rows: rows of one campaign.
        folder: existing folder of the campaign.
        facts: its facts.
    """
    def parts() -> Iterable[Iterable[RunRow]]:
        return rows.parts() if isinstance(rows, StoredRows) and rows else [rows]

    known = list(dict.fromkeys(name for part in parts() for name in _names(_found(part))))

    def frames(file: TextIO) -> Iterator[pd.DataFrame]:
        for number, part in enumerate(parts()):
            frame = table(part, tuple(facts.get('specs', {})), known)
            file.write(csv_text(frame, header=number == 0))
            frame.attrs[STACKS] = recorded_stacks(facts)  # then, as each column has a copy of them
            yield frame

    def write(draft: Path) -> None:  # both at once, as a part is made in some time
        with draft.open('w', encoding='utf-8', newline='') as file:
            write_parquet(folder / PARQUET_NAME, frames(file))

    make_atomically(folder / CSV_NAME, write)


def csv_text(frame: pd.DataFrame, *, header: bool = True) -> str:
    """Text of ``runs.csv`` of a table, safe against formula injection in spreadsheets."""
    return frame.apply(
        lambda column: column.map(_spreadsheet_safe) if column.dtype == 'string' else column
    ).to_csv(index=False, header=header)


def read_table(path: Path) -> pd.DataFrame:
    """The table of a campaign, from its record, or a ``.parquet`` file of such a table.

    Raises:
        UsageError: there is none, or it is damaged or inconsistent.
    """
    if path.suffix != '.parquet':
        if is_campaign(path):
            return campaign_table(read_campaign(path))
        path = path / PARQUET_NAME
    if not path.is_file():
        raise UsageError(f'{path}: no such table; is {path.parent} a campaign?')
    frame = read_any_table(path)
    _check_rows(path, frame)
    return frame


def read_any_table(path: Path) -> pd.DataFrame:
    """Read a table of runs with the types of :func:`table`.

    Raises:
        UsageError: it is damaged.
    """
    import pyarrow.parquet

    try:
        data = pyarrow.BufferReader(path.read_bytes())
        columns = pyarrow.parquet.read_table(data, page_checksum_verification=True)
        columns.validate(full=True)  # such as invalid UTF-8
        _check_names(columns.schema)
        frame = columns.to_pandas()
        # Older pyarrow, as numpy 1.26 asks for, leaves what pandas has laid down beside it.
        frame.attrs = json.loads((columns.schema.metadata or {}).get(b'PANDAS_ATTRS', '{}'))
    except Exception as error:  # third-party reader on untrusted bytes
        raise _damaged(path, error) from error
    names = [str(name) for name in frame.columns]
    if len(set(names)) < len(names):
        raise UsageError(f'{path}: damaged (a column occurs twice)')
    kinds = column_types(specs_of(frame.columns), names)
    # Older tables may lack newer columns.
    try:
        frame = frame.astype({name: kind for name, kind in kinds.items() if name in frame.columns})
    except (ValueError, TypeError, OverflowError) as error:
        raise _damaged(path, error) from error
    _add_what_was_so(frame)
    return frame


def _check_names(schema: pa.Schema) -> None:
    """Check the names of columns, which no page checksum covers, against those of pandas."""
    listed = (schema.pandas_metadata or {}).get('columns', [])
    names = [each['field_name'] for each in listed]
    other = [name for each in listed if (name := each['name']) is not None]
    if listed and (names != schema.names or not {*map(str, other)} <= {*names}):
        raise ValueError('the names of its columns contradict each other')


def _add_what_was_so(frame: pd.DataFrame) -> None:
    """Add columns for newer scenario keys with their former constant value, if there is a scene."""
    if SCENARIO_FIELDS[0].key not in frame.columns:
        return
    for before, field in pairwise(SCENARIO_FIELDS):
        if field.absent is None or field.key in frame.columns or before.key not in frame.columns:
            continue
        value = field.to_human(field.absent)
        nothing = '' if field.column_type == 'string' else None
        drawn = frame[SCENARIO_FIELDS[0].key].notna()
        frame.insert(
            list(frame.columns).index(before.key) + 1, field.key,
            [value if there else nothing for there in drawn],
        )
        # pandas' stubs list the names of types, and this is any string.
        frame[field.key] = frame[field.key].astype(field.column_type)  # type: ignore[call-overload]


def _check_rows(path: Path, frame: pd.DataFrame) -> None:
    """Check that every row is consistent, as in :meth:`.row.RunRow.check`."""
    if not {'run_id', 'index', 'outcome'} <= set(frame.columns):
        return
    known = {field.key: ['', *field.words] for field in SCENARIO_FIELDS if field.words}
    known['outcome'] = [*Outcome]
    for name, words in known.items():
        if name in frame.columns:
            _refuse(path, ~frame[name].fillna('').isin(words), f'an unknown word for {name}')
    fits = {'run_id': is_run_name, 'bag': is_bag_name}
    for name in fits.keys() & set(frame.columns):
        texts = frame[name].fillna('').astype(str)
        unfit = texts.isin([*filterfalse(fits[name], texts)]) & (texts != '')
        _refuse(path, unfit, f'its {name} is not a plain name')
    for name in ('run_id', 'index'):
        _refuse(path, frame[name].duplicated(), f'its {name} occurs twice')
    _refuse(path, frame['index'] < 0, 'its index is negative')
    for name in frame.select_dtypes('float64').columns:
        if not str(name).startswith(RHO):
            _refuse(path, frame[name].abs() == math.inf, f'{name} is not finite')
    specs = specs_of(frame.columns)
    if specs:
        _check_robustness(path, frame, specs)
    if RHO in frame.columns:
        _check_headline(path, frame, specs[:1])


def _check_robustness(path: Path, frame: pd.DataFrame, specs: Sequence[str]) -> None:
    """Check outcomes: PASS, the first formula above zero; FAIL, at least one not; else none.

    Formulas after the first may have been added later, so that they did not determine outcomes.
    """
    passed, failed = (frame['outcome'] == word for word in (Outcome.PASS, Outcome.FAIL))
    above, below = passed | True, passed & False
    for name in specs:
        exact = frame[rho_column(name)]
        lower = frame.get(lower_column(name), exact).fillna(exact)
        upper = frame.get(upper_column(name), exact).fillna(exact)
        _refuse(path, ~(passed | failed) & upper.notna(), 'a robustness without a verdict')
        if name in specs[:1]:
            above &= lower > 0
        below |= upper <= 0
    _refuse(path, passed & ~above, 'PASS, but a robustness is not above 0')
    _refuse(path, failed & ~below, 'FAIL, but no robustness is 0 or less')


def _check_headline(path: Path, frame: pd.DataFrame, headline: Sequence[str]) -> None:
    """Check that ``rho`` repeats the headline's robustness, as far as that is in the table."""
    passed, failed = (frame['outcome'] == word for word in (Outcome.PASS, Outcome.FAIL))
    rho = frame[RHO]
    _refuse(path, ~(passed | failed) & rho.notna(), 'a robustness without a verdict')
    _refuse(path, passed & (rho <= 0), 'PASS, but rho is not above 0')
    for name in headline:
        other = frame.get(rho_column(name), rho)
        same = (rho == other) | (rho.isna() & other.isna())
        _refuse(path, ~same, f'{RHO} is not {rho_column(name)}')
    if not headline:
        _refuse(path, failed & (rho > 0), 'FAIL, but rho is above 0')


def _refuse(path: Path, wrong: Any, what: str) -> None:
    """Refuse a table because of its first row for which ``wrong`` is true or unknown."""
    for row in wrong.to_numpy(dtype=bool, na_value=True).nonzero()[0][:1]:
        raise UsageError(f'{path}: row {row + 1}: {what}; was the table damaged or edited?')


def _damaged(path: Path, error: Exception) -> UsageError:
    return UsageError(f'{path}: damaged ({next(iter(str(error).splitlines()), "")})')


def _spreadsheet_safe(word: Any) -> Any:
    """Escape a word that a spreadsheet would take for a formula (OWASP, CSV Injection)."""
    return f"'{word}" if isinstance(word, str) and word.startswith(_FORMULA_STARTS) else word
