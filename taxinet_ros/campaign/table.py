"""The table of a campaign, as CSV for people and as Parquet for programs; made from its rows.

Every column has the same type in every table, even where all its values are missing, so tables of
several campaigns can be put together.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from taxinet_ros.bag.layout import disk_error, sync_folder
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.errors import UsageError

if TYPE_CHECKING:  # A run need not wait for it before it begins.
    import pandas as pd

CSV_NAME = 'runs.csv'
PARQUET_NAME = 'runs.parquet'

WALL_CLOCK_COLUMNS = ('wall_s', 'real_time_factor')
"""The last columns: all others are equal if the campaign is run again."""

_FORMULA_STARTS = ('=', '+', '-', '@', '\t', '\r')

_POINT = 'u_'
_RHO, _LOWER, _UPPER = 'rho_', 'rho_lower.', 'rho_upper.'

_BEFORE_POINT = {
    'run_id': 'string', 'index': 'int64', 'program': 'string', 'seed': 'int64',
    'sampler': 'string', 'refused': 'Int64', 'weight': 'float64', 'drawn': 'boolean',
}
_BEFORE_RHO = {
    'perception': 'string', 'perception_fingerprint': 'string',
    'cross_track_m': 'float64', 'distance_m': 'float64', 'heading_deg': 'float64',
    'clouds': 'string', 'rain_percent': 'float64', 'time_of_day_h': 'float64', 'date': 'string',
    'shadows': 'boolean', 'crossing': 'boolean', 'aircraft': 'string', 'duration_s': 'float64',
    'outcome': 'string', 'kind': 'string', 'who': 'string', 'detail': 'string', 'rho': 'float64',
}
_AFTER_RHO = {
    'stopped_early': 'boolean', 'stopped_s': 'float64',
    'left_runway': 'boolean', 'max_cross_track_m': 'float64', 'settle_time_s': 'float64',
    'cte_error_mean_m': 'float64', 'cte_error_mean_abs_m': 'float64',
    'cte_error_max_abs_m': 'float64', 'he_error_mean_deg': 'float64',
    'he_error_mean_abs_deg': 'float64', 'he_error_max_abs_deg': 'float64',
    'unusable_estimates': 'Int64', 'steps': 'int64', 'sim_s': 'float64',
    'retries': 'int64', 'bag': 'string', 'wall_s': 'float64', 'real_time_factor': 'float64',
}

_ATTRIBUTES = {
    'cross_track_m': 'cross_track', 'distance_m': 'distance', 'heading_deg': 'heading',
    'rain_percent': 'rain', 'time_of_day_h': 'time_of_day', 'duration_s': 'duration',
}
"""A row names these as people set them, without their units."""


def table(rows: Iterable[RunRow], specs: Sequence[str] = ()) -> pd.DataFrame:
    """One line per run, by index.

    Args:
        rows: of one campaign.
        specs: names of its formulas, headline first. Each has a column ``rho_<name>``, empty where
            a run was stopped before it was known, and ``rho`` repeats the first;
            ``rho_lower.<name>`` and ``rho_upper.<name>`` are the ends of its interval, equal where
            it is known. Formulas that only the rows know follow.

    A run's point has one column ``u_<dimension>`` for each dimension that any row has.
    """
    import pandas as pd

    ordered = sorted(rows, key=lambda row: row.index)
    judged_by = (name for row in ordered for name in (*row.rho_upper, *row.rho))
    names = list(dict.fromkeys([*specs, *judged_by]))
    dimensions = list(dict.fromkeys(name for row in ordered for name in row.point))
    kinds = _kinds(names, dimensions)
    lines = [_line(row, names, dimensions) for row in ordered]
    columns: dict[str, pd.Series[Any]] = {
        name: pd.Series([line[name] for line in lines], dtype=kind)
        for name, kind in kinds.items()
    }
    return pd.DataFrame(columns)


def write_tables(rows: Iterable[RunRow], folder: Path, specs: Sequence[str] = ()) -> None:
    """Write ``runs.csv`` and ``runs.parquet``; each is whole at any moment, the old or the new.

    Args:
        rows: of one campaign.
        folder: the campaign's, which exists.
        specs: names of its formulas, as for :func:`table`.
    """
    frame = table(rows, specs)
    words = frame.apply(
        lambda column: column.map(_no_formula) if column.dtype == 'string' else column
    )
    _replace(folder / CSV_NAME, lambda file: words.to_csv(file, index=False))
    _replace(folder / PARQUET_NAME, lambda file: frame.to_parquet(file, index=False))


def read_table(folder: Path) -> pd.DataFrame:
    """The table of the campaign in ``folder``, with the types it was written with.

    Args:
        folder: the campaign's, or a ``.parquet`` file of such a table.

    Raises:
        UsageError: there is none, or it is damaged.
    """
    import pyarrow.parquet

    path = folder if folder.suffix == '.parquet' else folder / PARQUET_NAME
    try:
        columns = pyarrow.parquet.read_table(path)
        columns.validate(full=True)  # texts that are none, for one
        frame = columns.to_pandas()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise UsageError(f'{path}: no such table; is {folder} a campaign?') from error
    except Exception as error:  # a foreign reader on untrusted bytes: every failure is the file's
        raise _damaged(path, error) from error
    names = [str(name) for name in frame.columns]
    if len(set(names)) < len(names):
        raise UsageError(f'{path}: damaged (a column is there twice)')
    # No formula's name has a dot, so none is mistaken for the end of an interval.
    specs = [name.removeprefix(_RHO) for name in names if re.fullmatch(rf'{_RHO}[^.]*', name)]
    dimensions = [name.removeprefix(_POINT) for name in names if name.startswith(_POINT)]
    kinds = _kinds(specs, dimensions)
    # A table from before a column was thought of is still a table.
    try:
        return frame.astype({name: kind for name, kind in kinds.items() if name in frame.columns})
    except (ValueError, TypeError, OverflowError) as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> UsageError:
    return UsageError(f'{path}: damaged ({next(iter(str(error).splitlines()), "")})')


def _kinds(specs: Sequence[str], dimensions: Iterable[str]) -> dict[str, str]:
    return {
        **_BEFORE_POINT, **{f'{_POINT}{name}': 'float64' for name in dimensions},
        **_BEFORE_RHO,
        **{f'{start}{name}': 'float64' for start in (_RHO, _LOWER, _UPPER) for name in specs},
        **_AFTER_RHO,
    }


def _line(row: RunRow, specs: Sequence[str], dimensions: Sequence[str]) -> dict[str, Any]:
    values = {
        name: getattr(row, _ATTRIBUTES.get(name, name))
        for name in (*_BEFORE_POINT, *_BEFORE_RHO, *_AFTER_RHO)
    }
    values['outcome'] = row.outcome.value
    point = {f'{_POINT}{name}': row.point.get(name) for name in dimensions}
    rho: dict[str, float | None] = {'rho': row.rho.get(specs[0]) if specs else None}
    for name in specs:
        low, high = row.interval(name) or (None, None)
        rho |= {f'{_RHO}{name}': row.rho.get(name), f'{_LOWER}{name}': low, f'{_UPPER}{name}': high}
    return {**values, **point, **rho}


def _no_formula(word: Any) -> Any:
    """A word that no spreadsheet takes for a formula (OWASP, CSV Injection)."""
    return f"'{word}" if isinstance(word, str) and word.startswith(_FORMULA_STARTS) else word


def _replace(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file beside ``path`` and put it in its place once it is safe on the disk."""
    temporary = path.with_name(f'{path.name}.tmp')
    try:
        with temporary.open('wb') as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise disk_error(path, error) from error
