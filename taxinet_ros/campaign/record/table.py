"""Table of a campaign as CSV and Parquet, made from its rows.

Every column has the same type in every table, even if all its values are missing, so tables of
several campaigns can be concatenated.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from itertools import filterfalse, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.bag.layout import is_bag_name, is_run_name
from taxinet_ros.campaign.record.facts import (
    FACTS_NAME,
    LEDGER_NAME,
    STACKS,
    read_facts,
    recorded_stacks,
    seal_facts,
)
from taxinet_ros.campaign.record.row import ON_DISK, RunRow
from taxinet_ros.core.scenario_fields import SCENARIO_FIELDS
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError, warn_once
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.sealed_table import is_sealed_table, write_table

if TYPE_CHECKING:  # slow import that should not delay a run
    import pandas as pd

CSV_NAME = 'runs.csv'
PARQUET_NAME = 'runs.parquet'

WALL_CLOCK_COLUMNS = ('wall_s', 'real_time_factor')
"""The last columns; all others are equal if the campaign is repeated."""

_FORMULA_STARTS = ('=', '+', '-', '@', '\t', '\r')

_POINT = 'u_'
_FREE = 'free_'
_RHO, _LOWER, _UPPER = 'rho_', 'rho_lower.', 'rho_upper.'

_BEFORE_POINT = {
    'run_id': 'string', 'index': 'int64', 'program': 'string', 'seed': 'int64',
    'sampler': 'string', 'refused': 'Int64', 'weight': 'float64', 'drawn': 'boolean',
}
_BEFORE_RHO = {
    'perception': 'string', 'perception_fingerprint': 'string', 'timing': 'string',
    **{field.key: field.column_type for field in SCENARIO_FIELDS},
    'outcome': 'string', 'kind': 'string', 'who': 'string', 'detail': 'string', 'rho': 'float64',
}
_AFTER_RHO = {
    'stopped_early': 'boolean', 'stopped_s': 'float64',
    'left_runway': 'boolean', 'max_cross_track_m': 'float64', 'settle_time_s': 'float64',
    'cte_error_mean_m': 'float64', 'cte_error_mean_abs_m': 'float64',
    'cte_error_max_abs_m': 'float64', 'he_error_mean_deg': 'float64',
    'he_error_mean_abs_deg': 'float64', 'he_error_max_abs_deg': 'float64',
    'unusable_estimates': 'Int64', 'steps': 'int64', 'sim_s': 'float64',
    'retries': 'int64', 'bag': 'string', 'stack': 'string', 'wall_s': 'float64',
    'real_time_factor': 'float64',
}

_ATTRIBUTES = {column: name for name, column in ON_DISK.items()}
"""Names of row attributes that are shorter than their column."""


def table(rows: Iterable[RunRow], specs: Sequence[str] = ()) -> pd.DataFrame:
    """Table with one row per run, by index.

    Args:
        rows: rows of one campaign.
        specs: names of its formulas, headline first. Each has a column ``rho_<name>``, empty if a
            run was stopped before it was known, and ``rho`` repeats the first;
            ``rho_lower.<name>`` and ``rho_upper.<name>`` are the ends of its interval, equal if it
            is known. Further formulas of the rows follow.

    There is one column ``u_<dimension>`` for each dimension of any row's point, and one column
    ``free_<name>`` for each figure of free runs.
    """
    import pandas as pd

    ordered = sorted(rows, key=lambda row: row.index)
    judged_by = (name for row in ordered for name in row.robustness)
    names = list(dict.fromkeys([*specs, *judged_by]))
    dimensions = list(dict.fromkeys(name for row in ordered for name in row.point))
    figures = list(dict.fromkeys(name for row in ordered for name in row.free))
    kinds = _kinds(names, dimensions, figures)
    lines = [_line(row, names, dimensions, figures) for row in ordered]
    columns: dict[str, pd.Series[Any]] = {
        name: pd.Series([line[name] for line in lines], dtype=kind)
        for name, kind in kinds.items()
    }
    return pd.DataFrame(columns)


def write_tables(rows: Iterable[RunRow], folder: Path, specs: Sequence[str] = ()) -> None:
    """Write ``runs.csv`` and ``runs.parquet`` atomically, and seal ``campaign.json`` if it exists.

    The Parquet file contains the campaign's records of machine, libraries and code in
    ``attrs['stacks']``; the column ``stack`` refers to them.

    Args:
        rows: rows of one campaign.
        folder: existing folder of the campaign.
        specs: names of its formulas, as for :func:`table`.
    """
    frame = table(rows, specs)
    facts = read_facts(folder)
    frame.attrs[STACKS] = recorded_stacks(facts.values) if facts else {}
    csv, parquet = folder / CSV_NAME, folder / PARQUET_NAME
    write_atomically(csv, csv_text(frame))
    write_table(parquet, frame)
    if facts is not None:
        seal_facts(folder, facts, [csv, parquet])


def csv_text(frame: pd.DataFrame) -> str:
    """Text of ``runs.csv`` of a table, safe against formula injection in spreadsheets."""
    return frame.apply(
        lambda column: column.map(_spreadsheet_safe) if column.dtype == 'string' else column
    ).to_csv(index=False)


def read_table(folder: Path) -> pd.DataFrame:
    """Read the table of the campaign in ``folder``, with the types of :func:`table`.

    Args:
        folder: folder of the campaign, or a ``.parquet`` file of such a table.

    Raises:
        UsageError: there is none, it is damaged or inconsistent, or it belongs to another campaign
            than the ``campaign.json`` in its folder.
    """
    path = folder if folder.suffix == '.parquet' else folder / PARQUET_NAME
    if not path.is_file():
        raise UsageError(f'{path}: no such table; is {folder} a campaign?')
    specs = check_tables(path.parent, path)
    frame = read_any_table(path)  # once more checked, by the checksum in it
    _check_rows(path, frame, specs)
    return frame


def check_tables(folder: Path, wanted: Path | None = None) -> list[str]:
    """Check a campaign's tables against the checksums in ``campaign.json``.

    Args:
        folder: folder of the campaign.
        wanted: the table to be read; without a checksum, there or in itself, there is a warning.

    Returns:
        Names of the formulas that determined the outcomes, as far as known.

    Raises:
        UsageError: a table differs from its checksum.
        OSError: the wanted one cannot be read.
    """
    facts = read_facts(folder)
    mend = f'write it anew with --resume; see taxinet doctor {folder}'
    vouched = False
    for path in (folder / CSV_NAME, folder / PARQUET_NAME):
        if facts is not None and path.is_file():
            vouched |= facts.check_file(path, mend) and path == wanted
    if wanted is not None and not vouched and not is_sealed_table(wanted, wanted.read_bytes()):
        where = 'is not there' if facts is None else 'has no checksums of them'
        warn_once(f'{folder}: its tables are unverified, since {FACTS_NAME} {where}')
    ledger = folder / LEDGER_NAME
    ended = facts.journals.get(LEDGER_NAME) if facts else None
    if vouched and ended and ledger.is_file() and ledger.read_bytes().count(b'\n') > ended.lines:
        warn_once(
            f'{folder}: its tables are older than its ledger; is the campaign running? If not, '
            '--resume it'
        )
    own = facts.values.get('specs') if facts else None
    return list(own) if isinstance(own, dict) else []


def read_any_table(path: Path) -> pd.DataFrame:
    """Read a table of runs, with or without checksum, with the types of :func:`table`.

    Raises:
        UsageError: it is damaged, or differs from the checksum in it.
    """
    import pyarrow.parquet

    try:
        data = path.read_bytes()
        is_sealed_table(path, data)
        columns = pyarrow.parquet.read_table(pyarrow.BufferReader(data))
        columns.validate(full=True)  # such as invalid UTF-8
        frame = columns.to_pandas()
    except UsageError:
        raise
    except Exception as error:  # third-party reader on untrusted bytes
        raise _damaged(path, error) from error
    names = [str(name) for name in frame.columns]
    if len(set(names)) < len(names):
        raise UsageError(f'{path}: damaged (a column occurs twice)')
    dimensions = [name.removeprefix(_POINT) for name in names if name.startswith(_POINT)]
    figures = [name.removeprefix(_FREE) for name in names if name.startswith(_FREE)]
    kinds = _kinds(_specs_of(frame), dimensions, figures)
    # Older tables may lack newer columns.
    try:
        frame = frame.astype({name: kind for name, kind in kinds.items() if name in frame.columns})
    except (ValueError, TypeError, OverflowError) as error:
        raise _damaged(path, error) from error
    _add_what_was_so(frame)
    return frame


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
        frame[field.key] = frame[field.key].astype(field.column_type)  # type: ignore[call-overload]


def _specs_of(frame: pd.DataFrame) -> list[str]:
    # Formula names have no dot, which distinguishes them from interval ends.
    return [
        str(name).removeprefix(_RHO) for name in frame.columns
        if re.fullmatch(rf'{_RHO}[^.]*', str(name))
    ]


def _check_rows(path: Path, frame: pd.DataFrame, own: Sequence[str]) -> None:
    """Check that every row is consistent, as in :meth:`.row.RunRow.check`.

    Args:
        path: path of the table, for messages.
        frame: the table; missing columns are not checked.
        own: names of the formulas that determined the outcomes, if known.
    """
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
        if not str(name).startswith('rho'):
            _refuse(path, frame[name].abs() == math.inf, f'{name} is not finite')
    specs = _specs_of(frame)
    if specs:
        _check_robustness(path, frame, [name for name in own if name in specs], specs)
    if 'rho' in frame.columns:
        _check_headline(path, frame, [*own, *specs][:1])


def _check_robustness(
    path: Path, frame: pd.DataFrame, own: Sequence[str], specs: Sequence[str]
) -> None:
    """Check outcomes: PASS, all formulas above zero; FAIL, at least one not; else no robustness.

    If the formulas that determined the outcomes are not known, the first one of the table is among
    them; others may have been added later.
    """
    passed, failed = (frame['outcome'] == word for word in (Outcome.PASS, Outcome.FAIL))
    above, below = passed | True, passed & False
    for name in specs:
        exact = frame[f'{_RHO}{name}']
        lower = frame.get(f'{_LOWER}{name}', exact).fillna(exact)
        upper = frame.get(f'{_UPPER}{name}', exact).fillna(exact)
        _refuse(path, ~(passed | failed) & upper.notna(), 'a robustness without a verdict')
        if name in (own or specs[:1]):
            above &= lower > 0
        if name in (own or specs):
            below |= upper <= 0
    _refuse(path, passed & ~above, 'PASS, but a robustness is not above 0')
    _refuse(path, failed & ~below, 'FAIL, but no robustness is 0 or less')


def _check_headline(path: Path, frame: pd.DataFrame, headline: Sequence[str]) -> None:
    """Check that ``rho`` repeats the headline's robustness, as far as that is in the table."""
    passed, failed = (frame['outcome'] == word for word in (Outcome.PASS, Outcome.FAIL))
    rho = frame['rho']
    _refuse(path, ~(passed | failed) & rho.notna(), 'a robustness without a verdict')
    _refuse(path, passed & (rho <= 0), 'PASS, but rho is not above 0')
    for name in headline:
        other = frame.get(f'{_RHO}{name}', rho)
        same = (rho == other) | (rho.isna() & other.isna())
        _refuse(path, ~same, f'rho is not {_RHO}{name}')
    if not headline:
        _refuse(path, failed & (rho > 0), 'FAIL, but rho is above 0')


def _refuse(path: Path, wrong: Any, what: str) -> None:
    """Refuse a table because of its first row for which ``wrong`` is true or unknown."""
    for row in wrong.to_numpy(dtype=bool, na_value=True).nonzero()[0][:1]:
        raise UsageError(f'{path}: row {row + 1}: {what}; was the table damaged or edited?')


def _damaged(path: Path, error: Exception) -> UsageError:
    return UsageError(f'{path}: damaged ({next(iter(str(error).splitlines()), "")})')


def _kinds(
    specs: Sequence[str], dimensions: Iterable[str], figures: Iterable[str]
) -> dict[str, str]:
    return {
        **_BEFORE_POINT, **{f'{_POINT}{name}': 'float64' for name in dimensions},
        **_BEFORE_RHO,
        **{f'{start}{name}': 'float64' for start in (_RHO, _LOWER, _UPPER) for name in specs},
        **{f'{_FREE}{name}': 'float64' for name in figures}, **_AFTER_RHO,
    }


def _line(
    row: RunRow, specs: Sequence[str], dimensions: Sequence[str], figures: Sequence[str]
) -> dict[str, Any]:
    values = {
        name: getattr(row, _ATTRIBUTES.get(name, name))
        for name in (*_BEFORE_POINT, *_BEFORE_RHO, *_AFTER_RHO)
    }
    values['outcome'] = row.outcome.value
    point = {f'{_POINT}{name}': row.point.get(name) for name in dimensions}
    point |= {f'{_FREE}{name}': row.free.get(name) for name in figures}
    rho: dict[str, float | None] = {'rho': row.rho.get(specs[0]) if specs else None}
    for name in specs:
        low, high = row.robustness.get(name) or (None, None)
        rho |= {f'{_RHO}{name}': row.rho.get(name), f'{_LOWER}{name}': low, f'{_UPPER}{name}': high}
    return {**values, **point, **rho}


def _spreadsheet_safe(word: Any) -> Any:
    """Escape a word that a spreadsheet would take for a formula (OWASP, CSV Injection)."""
    return f"'{word}" if isinstance(word, str) and word.startswith(_FORMULA_STARTS) else word
