"""A table of a report in a page: the first rows as HTML, all rows as data."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any
from urllib.parse import quote

import numpy as np

from taxinet_ros.analysis.report.parts import Cell, Column, Table
from taxinet_ros.analysis.report.values import clean, data_block, plain_number

ROWS_AT_ONCE = 25
"""Rows per page of a long table."""

_EXACT = 2**53
"""Largest range of integers that JavaScript represents exactly."""

_LONG = 40
"""Maximum number of characters of a cell on one line."""

_DIGITS = 6
"""Significant digits of fractions in columns without a number of decimals."""


def view_table(table: Table, viewers: Collection[str]) -> dict[str, Any]:
    """What the template takes of a table.

    Args:
        table: the table.
        viewers: ids of the runs that have a viewer, as :func:`.values.clean` leaves them.

    Returns:
        ``columns``, the title of each and whether it has numbers; ``rows``, the first
        :data:`ROWS_AT_ONCE`, each cell with its text, style (``number``, ``long`` or '') and
        address of a run's viewer, or ''; ``count`` of all; ``state``, the rows shown in words;
        whether it is ``long``; and ``data``, all rows as JSON.

    Raises:
        ValueError: a row and the columns differ in length, or there is no ``run_id_column``.
    """
    rows = [
        [_plain(cell, column) for cell, column in zip(row, table.columns, strict=True)]
        for row in table.rows
    ]
    kept = [place for place, column in enumerate(table.columns) if column.on_page]
    rows = [[row[place] for place in kept] for row in rows]
    table = replace(table, columns=tuple(table.columns[place] for place in kept))
    names = [column.name for column in table.columns]
    run_column = names.index(table.run_id_column) if table.run_id_column is not None else -1
    numeric = [_is_numeric([row[place] for row in rows]) for place in range(len(names))]
    shown = tuple(
        tuple(
            _view(value, column, viewers if place == run_column else (), numeric[place])
            for place, (value, column) in enumerate(zip(row, table.columns, strict=True))
        )
        for row in rows[:ROWS_AT_ONCE]
    )
    long, count = len(rows) > ROWS_AT_ONCE, len(rows)
    part = f'1–{ROWS_AT_ONCE} of ' if long else ''
    columns: list[dict[str, Any]] = [
        {'name': column.name, 'title': column.title, 'decimals': column.decimals,
         'numeric': is_numeric}
        for column, is_numeric in zip(table.columns, numeric, strict=True)
    ]
    return {
        'name': table.name, 'title': table.title, 'caption': table.caption, 'rows': shown,
        'columns': [(column['title'], column['numeric']) for column in columns], 'count': count,
        'long': long, 'state': f'{part}{count:,} {"row" if count == 1 else "rows"}',
        'data': data_block({
            'columns': columns, 'rows': rows, 'runColumn': run_column, 'rowsAtOnce': ROWS_AT_ONCE,
        }),
    }


def run_link(run_id: str) -> str:
    """Address of a run's viewer within the page."""
    return f'#run={quote(clean(run_id), safe="")}'


def _plain(cell: Cell, column: Column) -> Cell:
    """The value for the page, rounded as shown, so that HTML and script give the same digits."""
    value = cell.item() if isinstance(cell, np.generic) else cell
    if isinstance(value, str):
        return clean(value)
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, int):
        return value if abs(value) <= _EXACT else str(value)
    if column.decimals is None and np.isfinite(value):
        value = float(f'{value:.{_DIGITS}g}')
    return plain_number(value, 15 if column.decimals is None else column.decimals)


def _is_numeric(values: list[Cell]) -> bool:
    told = [value for value in values if value is not None]
    return bool(told) and all(
        value in ('∞', '-∞') or (isinstance(value, int | float) and not isinstance(value, bool))
        for value in told
    )


def _view(
    value: Cell, column: Column, viewers: Collection[str], numeric: bool
) -> tuple[str, str, str]:
    text = _words(value, column)
    kind = 'number' if numeric else 'long' if len(text) > _LONG else ''
    return text, kind, run_link(text) if text in viewers else ''


def _words(value: Cell, column: Column) -> str:
    if value is None:
        return '–'
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    if value == '-∞' and column.decimals is not None:
        return '−∞'
    if isinstance(value, str) or column.decimals is None:
        return str(value)
    return f'{value:.{column.decimals}f}'.replace('-', '−')
