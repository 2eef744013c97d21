"""Table of a campaign as CSV and Parquet, made from its rows.

Every column has the same type in every table, even if all its values are missing, so tables of
several campaigns can be concatenated.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import filterfalse, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.bag.layout import is_bag_name, is_run_name
from taxinet_ros.core.scenario_fields import SCENARIO_FIELDS
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError, warn_once
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.sealed_table import is_sealed_table, write_table
from taxinet_ros.trials.record.content import CampaignContent, read_campaign
from taxinet_ros.trials.record.facts import STACKS, is_campaign, recorded_stacks
from taxinet_ros.trials.record.row import ON_DISK, RunRow

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
    columns: dict[str, pd.Series[Any]] = {
        name: pd.Series(values, dtype=kind)
        for (name, kind), values in zip(
            kinds.items(), _columns(ordered, names, dimensions, figures), strict=True
        )
    }
    return pd.DataFrame(columns)


def campaign_table(content: CampaignContent) -> pd.DataFrame:
    """Table of a campaign, with its records of machines, libraries and code in ``attrs``."""
    frame = table(content.rows, tuple(content.facts.get('specs', {})))
    frame.attrs[STACKS] = recorded_stacks(content.facts)
    return frame


def write_tables(rows: Iterable[RunRow], folder: Path, facts: Mapping[str, Any]) -> None:
    """Write ``runs.csv`` and ``runs.parquet`` atomically.

    The Parquet file contains the campaign's records of machine, libraries and code in
    ``attrs['stacks']``; the column ``stack`` refers to them.

    Args:
        rows: rows of one campaign.
        folder: existing folder of the campaign.
        facts: its facts.
    """
    frame = campaign_table(CampaignContent(facts=facts, rows=tuple(rows)))
    write_atomically(folder / CSV_NAME, csv_text(frame))
    write_table(folder / PARQUET_NAME, frame)


def csv_text(frame: pd.DataFrame) -> str:
    """Text of ``runs.csv`` of a table, safe against formula injection in spreadsheets."""
    return frame.apply(
        lambda column: column.map(_spreadsheet_safe) if column.dtype == 'string' else column
    ).to_csv(index=False)


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
    data = path.read_bytes()
    if not is_sealed_table(path, data):
        warn_once(f'{path}: is unverified, since it has no checksum')
    frame = _frame_of(path, data)
    _check_rows(path, frame)
    return frame


def read_any_table(path: Path) -> pd.DataFrame:
    """Read a table of runs, with or without checksum, with the types of :func:`table`.

    Raises:
        UsageError: it is damaged, or differs from the checksum in it.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise _damaged(path, error) from error
    is_sealed_table(path, data)
    return _frame_of(path, data)


def _frame_of(path: Path, data: bytes) -> pd.DataFrame:
    import pyarrow.parquet

    try:
        columns = pyarrow.parquet.read_table(pyarrow.BufferReader(data))
        columns.validate(full=True)  # such as invalid UTF-8
        frame = columns.to_pandas()
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
        if not str(name).startswith('rho'):
            _refuse(path, frame[name].abs() == math.inf, f'{name} is not finite')
    specs = _specs_of(frame)
    if specs:
        _check_robustness(path, frame, specs)
    if 'rho' in frame.columns:
        _check_headline(path, frame, specs[:1])


def _check_robustness(path: Path, frame: pd.DataFrame, specs: Sequence[str]) -> None:
    """Check outcomes: PASS, the first formula above zero; FAIL, at least one not; else none.

    Formulas after the first may have been added later, so that they did not determine outcomes.
    """
    passed, failed = (frame['outcome'] == word for word in (Outcome.PASS, Outcome.FAIL))
    above, below = passed | True, passed & False
    for name in specs:
        exact = frame[f'{_RHO}{name}']
        lower = frame.get(f'{_LOWER}{name}', exact).fillna(exact)
        upper = frame.get(f'{_UPPER}{name}', exact).fillna(exact)
        _refuse(path, ~(passed | failed) & upper.notna(), 'a robustness without a verdict')
        if name in specs[:1]:
            above &= lower > 0
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


def _columns(
    rows: Sequence[RunRow], specs: Sequence[str], dimensions: Sequence[str],
    figures: Sequence[str],
) -> Iterator[list[Any]]:
    """Values of each column, in the order of :func:`_kinds`."""
    def attributes(names: Iterable[str]) -> Iterator[list[Any]]:
        for name in names:
            values = [getattr(row, _ATTRIBUTES.get(name, name)) for row in rows]
            yield [value.value for value in values] if name == 'outcome' else values

    yield from attributes(_BEFORE_POINT)
    yield from ([row.point.get(name) for row in rows] for name in dimensions)
    *before, _ = _BEFORE_RHO
    yield from attributes(before)
    rho = {
        name: [known.lower if (known := row.robustness.get(name)) and known.exact else None
               for row in rows]
        for name in specs
    }
    yield rho[specs[0]] if specs else [None] * len(rows)
    yield from rho.values()
    for end in (0, 1):
        for name in specs:
            yield [known[end] if (known := row.robustness.get(name)) else None for row in rows]
    yield from ([row.free.get(name) for row in rows] for name in figures)
    yield from attributes(_AFTER_RHO)


def _spreadsheet_safe(word: Any) -> Any:
    """Escape a word that a spreadsheet would take for a formula (OWASP, CSV Injection)."""
    return f"'{word}" if isinstance(word, str) and word.startswith(_FORMULA_STARTS) else word
