"""The record of a campaign that survives a power cut: JSON lines, only ever appended.

Before a run its intent is written, after it its result, each flushed to the disk. So a run is on
record as finished, as begun, or not at all, and a campaign resumes by doing what has no result.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.bag.layout import disk_error, sync_folder
from taxinet_ros.campaign.journal import Journal, JournalOwner, damaged_line, read_journal
from taxinet_ros.campaign.plain_kinds import check_kind
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.errors import UsageError


@dataclass(frozen=True, kw_only=True, slots=True)
class LedgerContent:
    """What a ledger says.

    Attributes:
        campaign: what :meth:`Ledger.campaign` wrote; empty if nothing yet.
        rows: the newest result of each index, by index.
        unfinished: indices of runs that were begun and have no result, ascending.
        attempts: how often each run was begun, by index.
        added: formulas that were put to the runs afterwards, by name; the rows have their values.
    """

    campaign: Mapping[str, Any]
    rows: tuple[RunRow, ...]
    unfinished: tuple[int, ...]
    attempts: Mapping[int, int]
    added: Mapping[str, str]


_DAMAGED = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, UsageError)


class Ledger(JournalOwner):
    """An open ledger: one writer at a time; a context manager."""

    def __init__(self, path: Path) -> None:
        """Open ``path`` to append, making it if need be; a torn last line is cut off.

        Raises:
            UsageError: the file cannot be opened, or another campaign is writing to it.
        """
        self._path = path
        try:
            self._journal = Journal(path)
        except BlockingIOError as error:
            raise UsageError(f'ledger {path}: another campaign is writing to it') from error
        except OSError as error:
            raise UsageError(f'ledger {path}: {error.strerror}') from error
        self._journal.sync()
        sync_folder(path.parent)

    def campaign(self, values: Mapping[str, Any]) -> None:
        """Record what the campaign is: program, digest, seed, overrides, perception."""
        self._append({'event': 'campaign', 'campaign': dict(values)})

    def intent(self, index: int, run_id: str, scenario_sha256: str = '') -> None:
        """Record that run ``index`` is about to begin."""
        event = {'event': 'intent', 'index': index, 'run_id': run_id}
        self._append(event | ({'scenario_sha256': scenario_sha256} if scenario_sha256 else {}))

    def result(self, row: RunRow) -> None:
        """Record how a run ended."""
        self._append({'event': 'result', 'row': row.to_json()})

    def requirement(
        self, name: str, formula: str, intervals: Mapping[int, tuple[float, float]]
    ) -> None:
        """Record a formula that was put to the runs afterwards.

        Args:
            name: of the formula.
            formula: fully parenthesised.
            intervals: least and greatest robustness by the run's index, equal where it is known.
        """
        self._append({
            'event': 'requirement', 'name': name, 'formula': formula,
            'intervals': {str(index): ends for index, ends in intervals.items()},
        })

    def _append(self, event: Mapping[str, Any]) -> None:
        try:
            self._journal.append(event)
            self._journal.sync()
        except OSError as error:
            raise disk_error(self._path, error) from error


def read_ledger(path: Path) -> LedgerContent:
    """Read a ledger, also while it is being written; a torn last line counts as not there.

    Raises:
        UsageError: ``path:line: message`` if the file cannot be read or a whole line is damaged.
    """
    try:
        events = read_journal(path)
    except OSError as error:
        raise UsageError(f'ledger {path}: {error.strerror}') from error
    campaign: dict[str, Any] = {}
    rows: dict[int, RunRow] = {}
    begun: Counter[int] = Counter()
    added: dict[str, str] = {}
    for number, event in enumerate(events, start=1):
        try:
            if event['event'] == 'requirement':
                added[event['name']] = event['formula']
                _judge(event, rows)
            else:
                _take(event, campaign, rows, begun)
        except _DAMAGED as error:
            raise damaged_line(path, number, str(error)) from error
    return LedgerContent(
        campaign=campaign,
        rows=tuple(rows[index] for index in sorted(rows)),
        unfinished=tuple(sorted(set(begun) - set(rows))),
        attempts=begun,
        added=added,
    )


def _judge(event: Mapping[str, Any], rows: dict[int, RunRow]) -> None:
    """Give the rows so far what a later requirement says; a run done anew afterwards has none."""
    for index, (lower, upper) in event['intervals'].items():
        row = rows[int(index)]
        rows[row.index] = row.also_judged(event['name'], float(lower), float(upper))


def _take(
    event: Mapping[str, Any], campaign: dict[str, Any], rows: dict[int, RunRow],
    begun: Counter[int],
) -> None:
    if event['event'] == 'campaign':
        campaign.update(event['campaign'])
    elif event['event'] == 'intent':
        check_kind('index', 'int', event['index'])
        begun[event['index']] += 1
    elif event['event'] == 'result':
        row = RunRow.from_json(event['row'])
        rows[row.index] = row
    else:
        raise ValueError(f'unknown event {event["event"]!r}')
