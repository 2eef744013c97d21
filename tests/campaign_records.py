"""Campaigns on disk without a bench: written from rows, changed, and counted while they run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.trials.record.content import (
    BEGUN,
    END,
    REQUIREMENT,
    ROW,
    read_campaign,
    run_key,
)
from taxinet_ros.trials.record.facts import FACTS, is_campaign
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import CSV_NAME, PARQUET_NAME, write_tables


def write_campaign(
    folder: Path, rows: Iterable[RunRow] = (), facts: Mapping[str, Any] | None = None, *,
    begun: Iterable[int] = (), added: Mapping[str, str] | None = None, ended: bool = True,
) -> Path:
    """A campaign in place of the one there; ``begun`` are runs without a result."""
    facts, rows = facts or {}, list(rows)
    indices = [*begun, *(row.index for row in rows)]
    (folder / RECORD_NAME).unlink(missing_ok=True)
    with Record(folder / RECORD_NAME) as record:
        record.put_all([
            (FACTS, '', facts),
            *((BEGUN, run_key(index), 1) for index in indices),
            *((ROW, run_key(row.index), _recorded(row, added or {})) for row in rows),
            *((REQUIREMENT, name, {'formula': formula, 'intervals': {
                run_key(row.index): row.robustness[name] for row in rows if name in row.robustness
            }}) for name, formula in (added or {}).items()),
            *([(END, '', len(rows))] if ended else []),
        ])
    if ended:
        write_tables(rows, folder, facts)
    return folder


def _recorded(row: RunRow, added: Mapping[str, str]) -> dict[str, Any]:
    values = row.to_json()
    own = {name: ends for name, ends in row.robustness.items() if name not in added}
    return {**values, **({'robustness': own} if own else {})}


def change_row(folder: Path, index: int, /, **changes: Any) -> None:
    """Change values of a row, as if they had been recorded so; the tables stay."""
    with Record(folder / RECORD_NAME) as record:
        values = record.entries[ROW][run_key(index)]
        record.put(ROW, run_key(index), {**values, **changes})


def under_way(folder: Path) -> None:
    """Make a campaign that has ended one that has not: without an end, and without tables."""
    with Record(folder / RECORD_NAME) as record:
        record.remove(END)
    for name in (CSV_NAME, PARQUET_NAME):
        (folder / name).unlink(missing_ok=True)


def results(folder: Path) -> int:
    """Number of results of a campaign, which may be running or not yet begun."""
    try:
        return len(read_campaign(folder).rows) if is_campaign(folder) else 0
    except UsageError:
        return 0  # just being created
