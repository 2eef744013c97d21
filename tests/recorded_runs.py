"""Records of campaigns whose runs were not made."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.trials.record.content import BEGUN, END, ROW, run_key
from taxinet_ros.trials.record.facts import FACTS
from taxinet_ros.trials.record.row import RunRow


def record_runs(folder: Path, facts: Mapping[str, Any], rows: Iterable[RunRow]) -> None:
    """Write the record of a campaign that has ended with these runs."""
    rows = list(rows)
    with Record(folder / RECORD_NAME) as record:
        record.put_all([
            (FACTS, '', {**facts, 'runs': len(rows)}), (END, '', len(rows)),
            *((BEGUN, run_key(row.index), 1) for row in rows),
            *((ROW, run_key(row.index), row.to_json()) for row in rows),
        ])
