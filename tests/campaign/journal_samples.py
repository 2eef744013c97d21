"""Journals and campaign.json as others would write them, with checksums that fit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.campaign.record.facts import FACTS_NAME, read_facts, write_facts
from taxinet_ros.campaign.record.table import CSV_NAME, PARQUET_NAME
from taxinet_ros.files.journal import Journal, read_journal


def write_events(path: Path, events: Iterable[Mapping[str, Any]]) -> None:
    """A journal that says this, in place of what is there."""
    path.unlink(missing_ok=True)
    journal = Journal(path)
    for event in events:
        journal.append(event)
    journal.close()


def rewrite(path: Path, change: Callable[[list[dict[str, Any]]], object]) -> None:
    """The same journal with its events changed in place."""
    events = read_journal(path)
    change(events)
    write_events(path, events)


def under_way(folder: Path) -> None:
    """Make a campaign that has ended one that has not: no tables, and nobody knows its end."""
    facts = read_facts(folder)
    assert facts is not None
    for name in (FACTS_NAME, CSV_NAME, PARQUET_NAME):
        (folder / name).unlink()
    write_facts(folder, facts.values)
