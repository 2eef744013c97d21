"""Crash-safe record of a campaign: append-only JSON lines.

The intent is written before a run and the result after it, each flushed to disk. So a run is
recorded as finished, as started, or not at all, and a campaign resumes with the runs that have no
result.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.bag.layout import is_run_name
from taxinet_ros.campaign.record.facts import FACTS_NAME, LEDGER_NAME, read_facts
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.scenario_fields import CATALOGUES
from taxinet_ros.errors import UsageError, warn_once
from taxinet_ros.files.atomic import sync_folder, write_atomically
from taxinet_ros.files.journal import (
    Journal,
    JournalOwner,
    damaged_line,
    journal_line,
    locked,
    lost_end,
    parse_journal,
    read_journal,
)
from taxinet_ros.files.plain_values import check_kind
from taxinet_ros.files.reading import read_file


@dataclass(frozen=True, kw_only=True, slots=True)
class LedgerContent:
    """Content of a ledger.

    Attributes:
        campaign: the values of :meth:`Ledger.campaign`; empty if not yet written.
        rows: the newest result of each index, by index.
        unfinished: indices of runs that were started and have no result, ascending.
        attempts: number of starts of each run, by index.
        added: formulas evaluated afterwards, by name; the rows contain their values.
        finished: whether the campaign ended normally after the last line.
        documents: scenario key and reference of each document that it has in full.
    """

    campaign: Mapping[str, Any]
    rows: tuple[RunRow, ...]
    unfinished: tuple[int, ...]
    attempts: Mapping[int, int]
    added: Mapping[str, str]
    finished: bool = False
    documents: frozenset[tuple[str, str]] = frozenset()


EMPTY_LEDGER = LedgerContent(campaign={}, rows=(), unfinished=(), attempts={}, added={})
"""Content of a ledger without lines."""

_DAMAGED = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, UsageError)


class Ledger(JournalOwner):
    """An open ledger: one writer at a time; a context manager."""

    def __init__(self, path: Path) -> None:
        """Open ``path`` for appending, creating it if needed; a torn last line is cut off.

        Raises:
            UsageError: the file cannot be opened, or another campaign is writing to it.
        """
        try:
            self._journal = Journal(path)
        except BlockingIOError as error:
            raise UsageError(f'ledger {path}: another campaign is writing to it') from error
        except OSError as error:
            raise UsageError(f'ledger {path}: {error.strerror}') from error
        self._journal.sync()
        sync_folder(path.parent)

    def campaign(self, values: Mapping[str, Any]) -> None:
        """Record the facts of the campaign: program, digest, seed, overrides, perception."""
        self._append({'event': 'campaign', 'campaign': dict(values)})

    def document(self, key: str, document: str) -> None:
        """Record a whole document of a scenario; rows have its reference only."""
        self._append({'event': key, key: document})

    def intent(self, index: int, run_id: str, scenario_sha256: str = '') -> None:
        """Record that run ``index`` is about to start."""
        event = {'event': 'intent', 'index': index, 'run_id': run_id}
        self._append(event | ({'scenario_sha256': scenario_sha256} if scenario_sha256 else {}))

    def result(self, row: RunRow) -> None:
        """Record the result of a run.

        Raises:
            ValueError: the row is inconsistent.
        """
        row.check()
        self._append({'event': 'result', 'row': row.to_json()})

    def requirement(
        self, name: str, formula: str, intervals: Mapping[int, RobustnessInterval]
    ) -> None:
        """Record a formula that was evaluated afterwards.

        Args:
            name: name of the formula.
            formula: fully parenthesised.
            intervals: lower and upper robustness bounds by run index, equal if it is known.
        """
        self._append({
            'event': 'requirement', 'name': name, 'formula': formula,
            'intervals': {str(index): ends for index, ends in intervals.items()},
        })

    def _append(self, event: Mapping[str, Any]) -> None:
        self._journal.append(event)
        self._journal.sync()


def read_ledger(path: Path, *, resumed: bool = False) -> LedgerContent:
    """Read a ledger, even while it is being written; a torn last line is ignored.

    If ``campaign.json`` exists in its folder, the two must agree.

    Args:
        path: path of the ledger.
        resumed: whether lines may have been lost, as whoever asks makes these runs again.

    Raises:
        UsageError: ``path:line: message`` if the file cannot be read, a line is damaged, missing or
            inconsistent, or ``campaign.json`` is damaged or another campaign's.
    """
    facts = read_facts(path.parent)  # before the ledger, which may grow meanwhile
    ended = facts.journals.get(path.name) if facts and not resumed else None
    try:
        events = read_journal(path, ended)
    except OSError as error:
        raise UsageError(f'ledger {path}: {error.strerror}') from error
    content = ledger_content(path, events, finished=ended is not None and len(events) == ended[0])
    if facts is None and events:
        warn_once(
            f'{path}: unverified, since no {FACTS_NAME} beside it records its number of lines'
        )
    elif facts is not None and content.campaign:
        _check_same(path, facts.values, events)
    return content


def ledger_content(
    path: Path, events: Iterable[Mapping[str, Any]], *, finished: bool = False
) -> LedgerContent:
    """Build the content of a ledger from its events.

    Args:
        path: path of the ledger, for messages.
        events: parsed lines in order.
        finished: whether nothing was written since the campaign ended.

    Raises:
        UsageError: ``path:line: message`` if a line is inconsistent.
    """
    found = _Events()
    for number, event in enumerate(events, start=1):
        try:
            found.take(event)
        except _DAMAGED as error:
            raise damaged_line(path, number, str(error)) from error
    rows, begun = found.rows, found.begun
    return LedgerContent(
        campaign=found.campaign,
        rows=tuple(rows[index] for index in sorted(rows)),
        unfinished=tuple(sorted(set(begun) - set(rows))),
        attempts=begun,
        added=found.added,
        documents=frozenset(found.documents),
        finished=finished,
    )


def repair_ledger(folder: Path) -> str:
    """Prepare the damaged record of a campaign for a resume, which makes lost runs again.

    A damaged file is kept as a copy. The ledger keeps its intact lines, each result once; others
    refuse it until the campaign has ended, as ``campaign.json`` keeps the number of its lines.

    Returns:
        A line on what was damaged, or ''.

    Raises:
        UsageError: another process has the ledger open.
        OSError: a file cannot be read or written.
    """
    path, facts_path = folder / LEDGER_NAME, folder / FACTS_NAME
    with locked(path):
        content, why, facts = parse_journal(read_file(path)), [], None
        try:
            facts = read_facts(folder)
        except UsageError:
            why.append(_set_aside(facts_path))
            facts_path.unlink()
        ended = facts.journals.get(path.name) if facts else None
        short = lost_end(content, ended) if ended else ''
        if content.troubles or short:
            events: list[Mapping[str, Any]] = []
            results: set[str] = set()
            for line in content.lines:
                if line.event is None or line.checksum in results:
                    continue
                events.append(line.event)
                if line.event['event'] == 'result':
                    results.add(line.checksum)
            if facts is not None and facts.values not in _campaigns(events):
                events.insert(0, {'event': 'campaign', 'campaign': facts.values})
            why.append(_set_aside(path))
            write_atomically(path, b''.join(map(journal_line, events)))
    return (
        f'{folder}: damaged: {", ".join(why)}; runs without a result are made again; add '
        'requirements of taxinet monitor --add that are lost again'
    ) * bool(why)


def _campaigns(events: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Facts of the campaign, oldest first."""
    return [event['campaign'] for event in events if event['event'] == 'campaign']


def _set_aside(path: Path) -> str:
    """Copy a damaged file; the words on it."""
    number = 1
    while (copy := path.with_name(f'{path.name}.damaged-{number}')).exists():
        number += 1
    shutil.copyfile(path, copy)
    return f'{path.name} (kept as {copy.name})'


class _Events:
    """Accumulates the events of a ledger."""

    def __init__(self) -> None:
        self.campaign: dict[str, Any] = {}
        self.rows: dict[int, RunRow] = {}
        self.begun: Counter[int] = Counter()
        self.added: dict[str, str] = {}
        self.documents: set[tuple[str, str]] = set()
        self._names: dict[str, int] = {}

    def take(self, event: Mapping[str, Any]) -> None:
        """Process one event."""
        match event['event']:
            case 'campaign':
                self.campaign.update(event['campaign'])
            case key if key in CATALOGUES:
                # Finding it makes it known, so that references in rows can be resolved.
                self.documents.add((key, CATALOGUES[key].find(event[key]).reference))
            case 'intent':
                self._intent(event)
            case 'result':
                self._result(RunRow.from_json(event['row']))
            case 'requirement':
                self._judge(event)
            case other:
                raise ValueError(f'unknown event {other!r:.80}')

    def _intent(self, event: Mapping[str, Any]) -> None:
        index = event['index']
        check_kind('index', 'int', index)
        if index < 0 or not is_run_name(event['run_id']):
            raise ValueError(f'run {event["run_id"]!r:.80} with index {index}')
        self.begun[index] += 1

    def _result(self, row: RunRow) -> None:
        before = self.rows.get(row.index)
        if before is not None and before.outcome.judged:
            raise ValueError(f'run {row.index} is {before.outcome} already')
        if self._names.setdefault(row.run_id, row.index) != row.index:
            raise ValueError(f'run {self._names[row.run_id]} is called {row.run_id} already')
        self.rows[row.index] = row

    def _judge(self, event: Mapping[str, Any]) -> None:
        """Add a later requirement's values to the rows so far; runs repeated later have none."""
        self.added[event['name']] = event['formula']
        for index, (lower, upper) in event['intervals'].items():
            row = self.rows.get(int(index))  # None: lost, and made again
            if row is not None:
                self.rows[row.index] = row.also_judged(
                    event['name'], RobustnessInterval(float(lower), float(upper))
                )


def _check_same(path: Path, facts: Mapping[str, Any], events: Sequence[Mapping[str, Any]]) -> None:
    """Check that ``campaign.json`` agrees with the ledger, or with its state before a crash."""
    told = _campaigns(events)
    if facts in told:
        return
    last, none = told[-1], object()
    name = next(key for key in {**last, **facts} if facts.get(key, none) != last.get(key, none))
    raise UsageError(
        f'{path.with_name(FACTS_NAME)}: has another {name} than {path.name} beside it; was it '
        'edited, or copied from another campaign? Restore it'
    )
